"""Contact sheets of shapes, each seen from the front left and named.

factory.shapes.raster draws them without Blender.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from PIL import Image, ImageDraw

from factory.shapes.mesh import Mesh
from factory.shapes.raster import picture

AZIMUTH = 0.65  # radians: the front and the left side
FONT, LABEL = 12, 16  # pixels; at the usual size of 10, the colon after a t disappears


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
    montage = Image.new("RGB", (columns * wide, max(rows, 1) * (size + LABEL)), "white")
    pen = ImageDraw.Draw(montage)
    for k, mesh in enumerate(meshes):
        x, y = k % columns * wide, k // columns * (size + LABEL)
        if isinstance(mesh, str):
            pen.text((x + 3, y + 3), mesh[: wide // 7], fill="red", font_size=FONT)
            continue
        for j, azimuth in enumerate(azimuths):
            pixels = (picture(mesh, azimuth, size=size) * 255 + 0.5).astype(np.uint8)
            montage.paste(Image.fromarray(pixels), (x + j * size, y))
        text = mesh.name[-(wide // 7) :]
        pen.text((x + 3, y + size), text, fill=(90, 90, 90), font_size=FONT)
    return montage
