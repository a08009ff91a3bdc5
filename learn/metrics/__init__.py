"""How far pictures and intrinsics are from the truth, with confidence intervals."""
