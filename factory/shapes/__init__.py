"""Shapes: procedural families, primitives and mesh files, by numpy, scipy and trimesh only."""
