"""Measurements behind the figures in docs/results: `python -m learn.experiments NAME`."""
