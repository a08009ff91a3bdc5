"""A photograph and a wanted material in, the same object in that material out."""
