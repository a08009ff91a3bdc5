"""Shapes: procedural families, primitives and mesh files, all through one door; numpy, scipy and
trimesh only.
"""
