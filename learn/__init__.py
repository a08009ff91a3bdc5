"""Everything that uses torch: the differentiable rendering layer, training, editing, evaluation.

No module of this package imports bpy.
"""
