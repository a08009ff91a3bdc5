"""Lights: environment maps from the Blender wheel, from a user's files, or computed.

Each is scaled to a mean luminance of 1.
"""

from factory.lights.catalogue import load, names
from factory.lights.light import Light

__all__ = ["Light", "load", "names"]
