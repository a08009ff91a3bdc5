"""Records in, networks and pictures out: the differentiable layer and what is learnt through it. No
bpy here.
"""
