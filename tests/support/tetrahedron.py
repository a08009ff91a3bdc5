"""A tetrahedron as a file, what a data set of such files holds, and the fake studio's name for a
worker that has ROOT on its path.
"""

import json
from pathlib import Path

from manifests.store import Store

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


def written(folder, count=6, damaged=()):
    """Write tetrahedra of different heights; return their paths."""
    folder.mkdir(exist_ok=True)
    paths = []
    for k in range(count):
        paths.append(folder / f"mesh{k}.ply")
        text = TETRAHEDRON.replace(b"0 0 2\n", f"0 0 {2 + k}\n".encode())
        paths[-1].write_bytes(b"nothing" if k in damaged else text)
    return paths


def lines(folder, kind="views"):
    """The lines of a data set but for what may vary, by id."""
    return sorted(
        (
            {k: v for k, v in json.loads(line).items() if k != "seconds"}
            for path in Store(folder).record_files(kind)
            for line in path.read_bytes().splitlines()
        ),
        key=lambda line: line["id"],
    )
