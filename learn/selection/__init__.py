"""Selecting an object in a photograph: marks, superpixels, and the mask that follows from them.

marks        clicks, strokes and lines, and the regions that they make
superpixels  the picture in small patches, and random walks between them
points       masks from coordinates, as `learn mask` takes them
display      the display values in which an object is marked
overlay      the photograph with its regions in colour
"""
