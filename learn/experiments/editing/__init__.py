"""Edits of rendered pictures: refinement and its alternatives, relighting, upsampling."""
