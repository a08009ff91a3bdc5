"""What a surface does with light: the one definition, in numpy, through which torch tensors pass as
well.
"""
