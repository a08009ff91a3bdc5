"""A job in, records out: meshes, lights and materials rendered by Cycles through bpy. No torch
here.
"""
