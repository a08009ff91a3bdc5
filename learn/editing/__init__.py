"""Material editing: from a photograph and a target material to the edited photograph."""

# this module imports nothing: commands need the numbers for their help
DETAIL = 0.5  # share of the residual shading that edits keep (residual_shading), by default
MOST_STOPS = 3.0  # by which an edit is made brighter or darker; a stop is a factor of 2
