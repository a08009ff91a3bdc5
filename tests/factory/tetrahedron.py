"""A tetrahedron as a file, and where the fake studio is: shared by several tests."""

from pathlib import Path

HERE = Path(__file__).resolve().parent
FAKE = "fake_studio:Studio"
TETRAHEDRON = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
2 0 0
0 2 0
0 0 2
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
