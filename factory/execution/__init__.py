"""Carries out a plan by worker processes; a run can be stopped and continued at any moment."""
