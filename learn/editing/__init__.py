"""Material editing: from a photograph and a target material to the edited photograph."""

# this module imports nothing: commands need the number for their help
DETAIL = 0.5  # share of the residual shading that edits keep (residual_shading), by default
