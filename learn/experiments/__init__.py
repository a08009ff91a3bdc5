"""Experiments that make the figures in docs/results; runner.py says what an experiment is.

layer        how accurate and how fast the rendering layer is: its methods and its engine
training     what losses, shapes and renderings gain in training; normals of trained networks
editing      edits of rendered pictures: refinement and its alternatives, relighting, upsampling
photographs  edits of photographs: their exposure, masks, painted objects, objects in rooms
"""
