"""Experiments that make the figures in docs/results; runner.py says what an experiment is.

layer        how accurate and how fast the rendering layer is: its methods and its engine
training     what training gains by losses, shapes and renderings; normals of what was trained
editing      edits of rendered pictures: refinement, its rivals, relighting, enlarging
photographs  edits of photographs: how they are exposed, painted objects, objects in rooms
"""
