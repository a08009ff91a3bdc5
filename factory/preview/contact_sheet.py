"""A contact sheet of records: picture, normals, mask, light, the label's rendering, the difference.

Tiles are (size, size, 3) uint8. The label is shaded at every k-th pixel only, which suffices to
look at (factory.preview.shading). The difference is |display − display| × GAIN. It includes noise,
shadows and interreflection, which `learn agree` separates.
"""

import base64
import html
import io
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw

from factory.preview.shading import mirror_sphere, shade
from manifests.captions import write_caption
from manifests.errors import InputError
from manifests.light_files import read_light
from manifests.materials import Material
from manifests.picture_files import read_geometry, read_picture
from manifests.schema import Camera, Dataset, Record
from manifests.store import Store
from manifests.store_paths import inside
from manifests.wording import number_of
from shaders import frames, tone
from shaders.envmap import roll

COLUMNS = ("image", "normals", "mask", "light", "label", "difference x 4")
GAIN = 4.0
SHADED = 56  # pixels per side at which the label is shaded
MARGIN, TEXT = 4, 26
STYLE = (
    "body{background:#181818;color:#ddd;font:14px sans-serif}td{padding:2px 4px}code{color:#9c9}"
)


def row(
    store: Store,
    dataset: Dataset,
    materials: Mapping[str, Material],
    record: Record,
    size: int,
) -> list[np.ndarray]:
    """Return the tiles of one record, in the order of COLUMNS.

    materials  {name: Material} of the data set
    size       of the tiles, pixels
    Raises     InputError for files that are missing, damaged or altered
    """
    require_named(store, dataset, materials, record)
    picture = read_picture(
        inside(store.folder, record.image), record.camera.size, record.image_hash
    )
    geometry = read_geometry(
        inside(store.folder, record.geometry), record.camera.size, record.geometry_hash
    )
    normals, mask, segments = geometry.normals, geometry.mask, geometry.segments
    light = light_of_record(store, dataset, record)
    elevation, roll = np.radians([record.camera.elevation_deg, record.camera.roll_deg])
    exposure = tone.auto_exposure(picture, mask)
    step = max(1, round(max(mask.shape) / SHADED))
    seen = (slice(step // 2, None, step),) * 2
    label = render_by_labels(
        record,
        normals[seen],
        segments[seen],
        view(record)[seen],
        materials,
        light,
        elevation,
        roll,
    )
    ours = tone.display(label, exposure)
    theirs = tone.display(picture[seen], exposure) * mask[seen][..., None]
    sphere = mirror_sphere(light, size, elevation, roll)
    light_exposure = tone.auto_exposure(light, np.ones(light.shape[:2], bool), 98)
    return [
        tile(tone.display(picture, exposure), size),
        tile(np.where(mask[..., None], 127.5 + 127.5 * normals, 0), size),
        tile(np.repeat(segments[..., None] * (255.0 / max(segments.max(), 1)), 3, axis=-1), size),
        tile(tone.display(sphere, light_exposure), size),
        tile(ours, size),
        tile(np.clip(np.abs(ours - theirs) * GAIN, 0, 255), size),
    ]


def require_named(
    store: Store, dataset: Dataset, materials: Mapping[str, Material], record: Record
) -> None:
    """Raise InputError if the data set lacks the light or a material that a record names."""
    missing = [
        ("materials.json", f"material '{name}'")
        for name in record.materials
        if name not in materials
    ]
    if record.light not in dataset.lights:
        missing.append(("dataset.json", f"light '{record.light}'"))
    for file, what in missing:
        raise InputError(
            store.folder / file,
            f"the {what}, which record {record.id} names",
            "none",
            "verify lists all faults of the folder",
        )


def render_by_labels(
    record: Record,
    normals: np.ndarray,
    segments: np.ndarray,
    views: np.ndarray,
    materials: Mapping[str, Material],
    light: np.ndarray,
    elevation: float,
    roll: float = 0.0,
) -> np.ndarray:
    """Return the radiance (…, 3) that the labels give to pixels, 0 outside the object.

    normals, views  (…, 3), segments (…): of the pixels
    light           (64, 128, 3) as the camera sees it
    elevation, roll of the camera, radians
    """
    out = np.zeros(normals.shape)
    for number, name in enumerate(record.materials, 1):
        here = segments == number
        if here.any():
            v = None if record.camera.fov_deg is None else views[here]
            out[here] = shade(normals[here], materials[name].m, light, elevation, v, roll)
    return out


def view(record: Record) -> np.ndarray:
    """Return the unit vectors (height, width, 3) from surface to camera."""
    height, width = record.camera.size
    fov = None if record.camera.fov_deg is None else np.radians(record.camera.fov_deg)
    return frames.view_vectors(height, width, fov=fov)


def light_of_record(store: Store, dataset: Dataset, record: Record) -> np.ndarray:
    """Return the light (64, 128, 3) as the camera of a record sees it."""
    entry = dataset.lights[record.light]
    return roll(
        read_light(inside(store.folder, entry.file), entry.file_hash), record.rotation_texels
    )


def tile(display: np.ndarray, size: int) -> np.ndarray:
    """Return display values (height, width, 3) in [0, 255], scaled to fit a square of `size`."""
    height, width = display.shape[:2]
    image = Image.fromarray(np.clip(np.rint(display), 0, 255).astype(np.uint8))
    scale = size / max(height, width)
    image = image.resize(
        (max(1, round(width * scale)), max(1, round(height * scale))),
        Image.Resampling.NEAREST if scale > 1 else Image.Resampling.BOX,
    )
    square = Image.new("RGB", (size, size))
    square.paste(image, ((size - image.width) // 2, (size - image.height) // 2))
    return np.asarray(square)


def caption(record: Record) -> str:
    """Return one line that describes a record."""
    materials = ", ".join(dict.fromkeys(record.materials))
    where = f"{record.light} +{record.rotation_texels}, view {record.viewpoint}"
    if posed := pose(record.camera):
        where += f" ({posed})"
    kept = ""
    if (accuracy := record.accuracy) is not None:
        kept = f" ({accuracy.estimator}, error {accuracy.estimated:.3g} of {accuracy.requested:g})"
    samples = number_of(record.samples, "sample")
    return (
        f"{record.shape}, {materials}; light {where}; "
        f"{record.tier}, map {record.light_resolution}, {samples}{kept}; "
        f"{record.split}"
    )


def pose(camera: Camera) -> str:
    """Return the elevation, roll and field of view that differ from the usual camera's."""
    usual, parts = Camera(), []
    if camera.elevation_deg != usual.elevation_deg:
        parts.append(f"elevation {camera.elevation_deg:.0f}°")
    if camera.roll_deg:
        parts.append(f"roll {camera.roll_deg:.0f}°")
    if camera.fov_deg is not None:
        parts.append(f"{camera.fov_deg:.0f}° wide")
    return ", ".join(parts)


def draw(rows: Sequence[Sequence[np.ndarray]], captions: Sequence[str], size: int) -> Image.Image:
    """Return one picture of all rows with their captions."""
    width = len(COLUMNS) * (size + MARGIN) + MARGIN
    height = TEXT + len(rows) * (size + MARGIN + TEXT) + MARGIN
    image = Image.new("RGB", (width, height), (24, 24, 24))
    draw = ImageDraw.Draw(image)
    for k, name in enumerate(COLUMNS):
        place = (MARGIN + k * (size + MARGIN), 7)
        write_caption(draw, place, name, size, fill=(255, 220, 120))
    for r, (tiles, text) in enumerate(zip(rows, captions, strict=True)):
        top = TEXT + r * (size + MARGIN + TEXT)
        for k, each in enumerate(tiles):
            image.paste(Image.fromarray(each), (MARGIN + k * (size + MARGIN), top))
        place = (MARGIN, top + size + 6)
        write_caption(draw, place, text, width - 2 * MARGIN, fill=(210, 210, 210))
    return image


def page(
    title: str,
    rows: Sequence[Sequence[np.ndarray]],
    captions: Sequence[str],
    ids: Sequence[str],
) -> str:
    """Return an HTML page of all rows, which needs no other file."""
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>",
        f"<style>{STYLE}</style>",
        (
            f"<h1>{html.escape(title)}</h1><p>The label is rendered from normals, light and"
            " material alone, without shadow or interreflection."
        ),
        "<table><tr>" + "".join(f"<th>{name}</th>" for name in COLUMNS) + "</tr>",
    ]
    for tiles, text, id_ in zip(rows, captions, ids, strict=True):
        parts.append(
            f"<tr><td colspan={len(COLUMNS)}>{html.escape(text)} <code>{id_}</code></td></tr>"
        )
        parts.append(
            "<tr>"
            + "".join(
                f"<td><img src='data:image/png;base64,{_png(each)}' alt=''></td>" for each in tiles
            )
            + "</tr>"
        )
    return "\n".join([*parts, "</table></html>\n"])


def _png(pixels: np.ndarray) -> str:
    """Return pixels as a PNG file in base64."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return base64.b64encode(buffer.getvalue()).decode()
