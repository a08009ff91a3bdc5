"""Cycles, as the studio uses it, measured against closed forms."""
