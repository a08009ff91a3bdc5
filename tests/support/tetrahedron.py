"""A tetrahedron as a file, and the fake studio's name for a worker that has ROOT on its path."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FAKE = "tests.support.fake_studio:Studio"
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
