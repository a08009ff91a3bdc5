"""Material editing: a photograph and a target material in, the edited photograph out."""
