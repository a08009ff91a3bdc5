"""The commands of `python -m learn`: one module each, and the options that they share."""
