"""Material editing: from a photograph and a target material to the edited photograph."""
