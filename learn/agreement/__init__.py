"""How far Cycles and the layer are apart on a dataset's records, and why."""
