"""How far pictures and their parts are from the truth, with confidence intervals."""
