"""Contact sheets of shapes, each seen from the front left and named.

factory.shapes.raster draws them without Blender.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from PIL import Image, ImageDraw

from factory.shapes.mesh import Mesh
from factory.shapes.raster import picture
from manifests import captions

AZIMUTH = 0.65  # radians: the front and the left side


def contact_sheet(
    meshes: Iterable[Mesh | str],
    count: int,
    *,
    columns: int | None = None,
    size: int = 160,
    azimuths: Sequence[float] = (AZIMUTH,),
) -> Image.Image:
    """Return a PIL image of `count` meshes, row after row.

    meshes    Mesh, or the one line of an error
    azimuths  radians; several: that many pictures of each mesh, side by side
    """
    columns = columns or max(
        1, min(count, round(10 / len(azimuths)), int(np.ceil(count**0.5 * 1.3)))
    )
    rows, wide = -(-count // columns), size * len(azimuths)
    montage = Image.new("RGB", (columns * wide, max(rows, 1) * (size + captions.LINE)), "white")
    pen = ImageDraw.Draw(montage)
    for k, mesh in enumerate(meshes):
        x, y = k % columns * wide, k // columns * (size + captions.LINE)
        if isinstance(mesh, str):
            captions.write_caption(pen, (x + 3, y + 3), mesh, wide - 6, fill="red")
            continue
        for j, azimuth in enumerate(azimuths):
            pixels = (picture(mesh, azimuth, size=size) * 255 + 0.5).astype(np.uint8)
            montage.paste(Image.fromarray(pixels), (x + j * size, y))
        captions.write_caption(pen, (x + 3, y + size), mesh.name, wide - 6, fill=(90, 90, 90))
    return montage
