"""Geometric primitives, as shapes of objects in photographs: boxes, cylinders, balls and flats.

Somebody who edits a photograph often knows what the network can only guess: that a carton is a box,
or that a coin is flat. Such a primitive has few parameters. learn.primitives.fitting finds those
for which its outline is that of the mask, and its normals are as near as possible to the predicted
ones.
"""

# this module imports nothing: commands need the names for their help
PRIMITIVES = ("box", "cylinder", "ball", "flat")
