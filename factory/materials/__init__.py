"""Materials: measured BRDFs are fitted by labels and by the closure mixtures that render them."""
