"""Carries out a plan with worker processes; a run can be stopped and continued at any moment."""
