"""Edits of rendered pictures: refinement, its rivals, relighting, enlarging."""
