"""Measurements of Cycles, as the studio uses it, against closed forms."""
