"""Materials: measured BRDFs in, labels and the closure mixtures that render them out."""
