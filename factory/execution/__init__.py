"""A plan carried out by worker processes, resumable at any moment."""
