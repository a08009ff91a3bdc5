"""Direct light without shadows at points of a picture, by the closed forms of its materials."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factory.render.estimators.renderer import DirectPicture
from factory.render.geometry import Surface
from manifests.schema import Camera
from shaders import frames
from shaders.mixture import Mixture

if TYPE_CHECKING:
    from shaders.direct_light import DirectLight

# samples of a narrow lobe per pixel, divided among its points if these are USUAL at most; with more
# points, each has as many as with USUAL, and so it is with fewer in large frames. Mirror-like
# materials need more samples, because normals turn by more than the width of their lobes within a
# pixel
LOBE_SAMPLES = {"glossy": 192, "mirror-like": 256}
# {points per pixel: (points across the pixel in a grid, grids that are shifted against each other)}
GRIDS = {
    1024: (16, 4),
    512: (16, 2),
    256: (8, 4),
    128: (8, 2),
    64: (4, 4),
    32: (4, 2),
    16: (2, 4),
    4: (1, 4),
}
# points per pixel by default, and at least for mirror-like materials in small frames, where fewer
# miss facets that mirror lamps
USUAL = 64
LEAST = 16  # points per pixel otherwise, if as many fit
LARGE = 1 << 15  # pixels of a frame in which LEAST are more of an object than USUAL in one of 64²
MOST_POINTS = 1 << 23  # that are looked at; those on the object take 100 bytes each
MOST_PLACES = 1 << 26  # of a frame's grids, where some pixels are looked at; each takes a byte
AT_ONCE = 1 << 19  # points of a frame whose light is computed at once
# {number of grids: their places (rightwards, upwards) in steps of a grid}: no two are in a row, a
# column or a diagonal, since most edges of objects are upright or level
SHIFTS = {
    1: ((0.0, 0.0),),
    2: ((-0.25, -0.25), (0.25, 0.25)),
    4: ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125)),
}
R2 = 0.7548776662466927, 0.5698402909980532
# cells across a pixel, in each of which light near the horizon is summed once for similar normals:
# those whose x and y are equal when they are rounded to SIMILAR steps per unit
CELLS, SIMILAR = 1, 8
FACET_STEPS = 1024  # of x and of y, by which facets of one pixel are distinguished
MIRROR_LIKE = 0.03  # α below which a lobe counts as mirror-like
MOST_DIRECT = 32  # maps of direct light in memory, of 1 to 2 MB each


class DirectLights:
    """Closed forms of mixtures under lights; those that were used last are kept."""

    def __init__(self) -> None:
        # by mixture, light and camera, least recently used first
        self._known: OrderedDict[tuple, DirectLight] = OrderedDict()

    def clear(self) -> None:
        """Forget all closed forms."""
        self._known.clear()

    def of(self, mixture: Mixture, seen: np.ndarray, lens: Camera) -> DirectLight:
        """Return the direct light of a mixture; seen: the light map as the camera sees it."""
        key = (mixture.key, seen.tobytes(), lens.elevation_deg, lens.roll_deg)
        if key not in self._known:
            from shaders.direct_light import DirectLight  # and numba, which takes half a second

            rotation = frames.camera_from_light(
                np.radians(lens.elevation_deg), np.radians(lens.roll_deg)
            )
            self._known[key] = DirectLight(mixture, seen, rotation)
        self._known.move_to_end(key)
        if len(self._known) > MOST_DIRECT:
            self._known.popitem(last=False)
        return self._known[key]


class Points(NamedTuple):
    """Where direct light is computed in each pixel.

    across   points of a grid along each side of a pixel
    shifts   places of the grids (rightwards, upwards), in steps of a grid
    samples  of narrow lobes at each point
    """

    across: int
    shifts: tuple[tuple[float, float], ...]
    samples: int

    @property
    def per_pixel(self) -> int:
        return self.across**2 * len(self.shifts)


def points_of(
    direct: Sequence[DirectLight], lens: Camera, requested: int, where: np.ndarray | None = None
) -> Points | None:
    """Return the points of pixels; None if even four per square pixel are more than MOST_POINTS.

    requested  points per pixel
    where      (height, width) bool, the pixels that have so many; None: all
    """
    kind = "mirror-like" if min(each.narrowest for each in direct) < MIRROR_LIKE else "glossy"
    pixels = lens.size[0] * lens.size[1]
    is_large = pixels >= LARGE
    least = USUAL if kind == "mirror-like" and not is_large else LEAST
    looked_at, most_places = pixels, MOST_POINTS
    if where is not None:
        looked_at, most_places = int(where.sum()), MOST_PLACES
    if lens.pixel == "centre":
        return Points(1, SHIFTS[1], LOBE_SAMPLES[kind]) if pixels <= MOST_POINTS else None
    for count, (across, grids) in GRIDS.items():
        few = count <= max(requested, least)
        if few and count * looked_at <= MOST_POINTS and count * pixels <= most_places:
            as_many = kind == "mirror-like" and is_large and count >= LEAST
            sharing = USUAL if as_many else min(count, USUAL)
            return Points(across, SHIFTS[grids], -(-LOBE_SAMPLES[kind] // sharing))
    return None


def turn_points(points: Points, turn: int) -> Points:
    """Return as many points at other places of their pixels: those of each turn are their own.

    Grids are shifted by multiples of the fractions that fill a square most evenly (R2: Roberts,
    The Unreasonable Effectiveness of Quasirandom Sequences, 2018).
    """
    shifts = tuple(
        (
            (rightwards + 0.5 + turn * R2[0]) % 1 - 0.5,
            (upwards + 0.5 + turn * R2[1]) % 1 - 0.5,
        )
        for rightwards, upwards in points.shifts
    )
    return points._replace(shifts=shifts)


def picture_of(
    direct: Sequence[DirectLight],
    grids: Sequence[Surface],
    lens: Camera,
    points: Points,
    where: np.ndarray | None = None,
) -> DirectPicture:
    """Return the picture (height, width) whose pixels are means over their points.

    direct  of the segments' materials, in the order of their ids
    grids   the surface at the points of each grid, `points.across` of them per side of a pixel
    where   (height, width) bool, the pixels that are computed; the others are black. None: all
    """
    height, width = lens.size
    radiance = np.zeros((len(grids), height, width, 3))
    covered = np.zeros((height, width))
    ends = [np.cumsum(grid.mask.sum(1)) for grid in grids]
    rows = max(1, AT_ONCE // (width * points.per_pixel))
    for top in range(0, height, rows):
        band = slice(top * points.across, (top + rows) * points.across)
        _add_band(
            direct,
            [_part(grid, band, end) for grid, end in zip(grids, ends, strict=True)],
            points,
            None if where is None else where[top : top + rows],
            radiance[:, top : top + rows],
            covered[top : top + rows],
        )
    radiance /= points.across**2
    mean = radiance.mean(0)
    between = ((radiance - mean) ** 2).sum(0) / max(len(grids) * (len(grids) - 1), 1)
    return DirectPicture(
        mean.astype(np.float32),
        (covered / points.per_pixel).astype(np.float32),
        between.astype(np.float32),
        any(each.narrow for each in direct),
    )


def _part(grid: Surface, band: slice, ends: np.ndarray) -> Surface:
    """Return a band of rows of a surface; ends: the points up to the end of each row."""
    mask = grid.mask[band]
    first = ends[band.start - 1] if band.start else 0
    inside = slice(first, first + int(mask.sum()))
    return Surface(mask, *(values[inside] for values in grid[1:]))


def _inside(surface: Surface, where: np.ndarray) -> Surface:
    """Return the part of a surface that lies in `where` (height, width)."""
    kept = where[surface.mask]
    return Surface(surface.mask & where, *(values[kept] for values in surface[1:]))


def _add_band(
    direct: Sequence[DirectLight],
    grids: Sequence[Surface],
    points: Points,
    where: np.ndarray | None,
    radiance: np.ndarray,
    covered: np.ndarray,
) -> None:
    """Add the sums over each grid's points to radiance (grids, height, width, 3), and their counts.

    where    (height, width) bool, the pixels that are computed; None: all
    covered  (height, width), to which the counts of all grids are added
    """
    height, width = covered.shape
    if where is not None:
        across = points.across
        fine = where.repeat(across, 0).repeat(across, 1)
        grids = [_inside(grid, fine) for grid in grids]
    places = [np.nonzero(grid.mask) for grid in grids]
    pixels, cells = (
        np.concatenate([_places(rows, columns, width, each, points) for rows, columns in places])
        for each in (1, CELLS)
    )
    order = np.argsort(cells, kind="stable")  # neighbours are looked up one after the other
    grid = np.repeat(np.arange(len(grids)), [len(rows) for rows, _ in places])[order]
    pixels, cells = pixels[order], cells[order]
    normals, facets, segments = (
        np.concatenate([getattr(each, name) for each in grids])[order]
        for name in ("normals", "facets", "segments")
    )
    place = grid * (height * width) + pixels
    for number, each in enumerate(direct, 1):
        here = segments == number
        values = each.at(
            normals[here],
            points.samples,
            facets[here],
            cells=number_similar(cells[here], normals[here], SIMILAR),
            patches=number_similar(pixels[here], facets[here], FACET_STEPS),
        )
        for channel, of in zip(np.moveaxis(radiance, -1, 0), values.T, strict=True):
            channel += np.bincount(place[here], of, channel.size).reshape(channel.shape)
    covered += np.bincount(pixels, minlength=covered.size).reshape(covered.shape)


def _places(
    rows: np.ndarray, columns: np.ndarray, width: int, across: int, points: Points
) -> np.ndarray:
    """Return the number of the cell (P,) in which each point of a grid lies.

    across  cells along each side of a pixel
    """
    return rows * across // points.across * (width * across) + columns * across // points.across


def leaning_share(surface: Surface) -> float:
    """Return the share of a surface's points whose normals lean away from their facets'."""
    from shaders.direct_light import COS_LEANING  # and numba, which takes half a second

    cosines = np.einsum("pi,pi->p", surface.normals, surface.facets)
    return float((cosines < COS_LEANING).mean()) if len(cosines) else 0.0


def merge_pictures(known: DirectPicture, finer: DirectPicture, where: np.ndarray) -> DirectPicture:
    """Return the finer picture in `where` (height, width), and the known one elsewhere."""
    inside = where[..., None]
    return DirectPicture(
        np.where(inside, finer.radiance, known.radiance),
        np.where(where, finer.alpha, known.alpha),
        np.where(inside, finer.variance, known.variance),
        known.sampled,
    )


def number_similar(cells: np.ndarray, normals: np.ndarray, count: int) -> np.ndarray:
    """Return integers (P,) that are equal for points of one cell with similar normals.

    cells    (P,) the number of each point's cell
    normals  (P, 3)
    count    steps per unit to which x and y are rounded
    """
    x, y = np.rint((normals[:, :2].T + 1) * count).astype(np.int64)
    steps = 2 * count + 1
    return (cells * steps + x) * steps + y
