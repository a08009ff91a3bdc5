"""Blender and Cycles: shapes, materials and light go in; radiance and geometry come out.

No other package imports bpy. Importing a module of this package imports bpy; importing the package
itself does not.
"""
