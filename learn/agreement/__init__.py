"""Agreement: how closely the layer reproduces Cycles' pictures of a dataset, and the causes."""
