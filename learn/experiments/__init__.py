"""Experiments that make the figures in docs/results; runner.py says what an experiment is."""
