"""Properties that every true picture, geometry file and light map has.

They follow from the physics and the format, not from one program's output, so they hold for the
numbers whatever hashes a file has. Each function returns lines that say what was expected and what
was found.

radiance (height, width, 3), mask (height, width) bool, normals (height, width, 3) in the camera
frame
"""

import numpy as np

from manifests.arrays import LARGEST_HALF, STEPS_PER_UNIT
from manifests.picture_files import Geometry
from manifests.schema import Camera, Statistics
from shaders import frames
from shaders.envmap import row_solid_angles
from shaders.tone import LUMINANCE

LENGTH = 1e-3  # of |n|; rounding to 2^-15 moves it by 3e-5
RADIUS = 1.001  # objects lie in the unit sphere; the largest of 250 views of 36 shapes is 1.00007
# of figures that records round to six places: half a place, and float64's own rounding
ROUNDED = 1e-6
HALF = 2.0**-11  # relative rounding of half precision
SUBNORMAL = 2.0**-25  # absolute, of values that half precision rounds to 0 or near it
SMOOTH = np.cos(np.radians(20.0))  # neighbouring normals that bend less lie on one piece of surface
# least correlation of normals and slopes: 0.75 or more in 340 views of 36 shapes, 0.17 of a slab
# shaded as a sphere
LEAST_CORRELATION = -0.1
# root mean square of the normals' correlated part, below which the correlation means nothing
LEAN = 0.1
LEAST_PIXELS = 60  # on smooth pieces, below which slopes of depth mean nothing
# lit pixels beside the object, in units of a frame's edge: see `support_faults`
LIT = {"centre": 0.5, "square": 4.0}
LEAST_LIT_SHARE = {"centre": 0.0, "square": 0.25}


def statistics_faults(radiance: np.ndarray, mask: np.ndarray, said: Statistics) -> list[str]:
    """Check a picture's coverage, mean and maximum against its record, within rounding."""
    results = []
    coverage = float(mask.mean())
    if abs(coverage - said.coverage) > ROUNDED:
        results.append(f"expected coverage {said.coverage:.6f}, found {coverage:.6f}")
    inside = radiance[mask]
    if not len(inside):
        return results
    largest = float(inside.max())
    if not abs(min(said.max, LARGEST_HALF) - largest) <= HALF * largest + SUBNORMAL + ROUNDED:
        results.append(f"expected a largest value of {said.max:g}, found {largest:g}")
    mean = float(inside.mean(axis=0, dtype=np.float64) @ LUMINANCE)
    # the part of the mean above the largest value of half precision
    cut = float((inside >= LARGEST_HALF).mean()) * max(said.max - LARGEST_HALF, 0.0)
    if (
        not -HALF * mean - SUBNORMAL - ROUNDED
        <= said.mean - mean
        <= HALF * mean + SUBNORMAL + ROUNDED + cut
    ):
        results.append(f"expected a mean of {said.mean:g} over the object, found {mean:g}")
    return results


def support_faults(radiance: np.ndarray, mask: np.ndarray, pixel: str) -> list[str]:
    """Check that a picture is black where the object is not.

    A pixel's square may hold a part of the object that its centre misses: a silhouette, or a wire
    that is thinner than a pixel.

    pixel  "centre" or "square", as manifests.schema.Camera has it
    """
    near = mask.copy()
    padded = np.pad(mask, 1)
    height, width = mask.shape
    for i in (0, 1, 2):
        for j in (0, 1, 2):
            near |= padded[i : i + height, j : j + width]
    share = float((radiance.any(-1) & ~near).mean())
    allowed = max(LIT[pixel] / min(mask.shape), LEAST_LIT_SHARE[pixel])
    return (
        [f"expected a black background, found {share:.1%} of the frame lit beside the object"]
        if share > allowed
        else []
    )


def black_faults(radiance: np.ndarray, mask: np.ndarray, lit: bool) -> list[str]:
    """Check that a picture is not black.

    lit  whether light comes from most directions, and the materials reflect
    """
    if lit and mask.any() and not radiance[mask].any():
        return ["expected some light on the object, found a black picture"]
    return []


def shines_around(L: np.ndarray) -> bool:
    """Return whether a map (height, width, 3) is above 0 over three quarters of the sphere.

    Such a light reaches any surface.
    """
    weight = np.broadcast_to(row_solid_angles(*L.shape[:2])[:, None], L.shape[:2])
    return float(weight[L.max(-1) > 0].sum() / weight.sum()) > 0.75


def geometry_faults(geometry: Geometry, camera: Camera) -> list[str]:
    """Check the normals and depth of a geometry file.

    Normals must be unit vectors that face the viewer and fit the depth. The object must lie in the
    unit sphere, and the background must be 0.
    """
    normals, mask = geometry.normals.astype(np.float64), geometry.mask
    if not mask.any():
        return ["expected an object in the frame, found an empty mask"]
    results = []
    if geometry.normals[~mask].any() or geometry.depth[~mask].any():
        results.append("expected normals and depth 0 in the background, found others")
    for what, values in (("normals", geometry.normals), ("depth", geometry.depth)):
        # a damaged value times 2^15 may be beyond float32
        steps = values.astype(np.float64) * STEPS_PER_UNIT
        if (steps != np.rint(steps)).any():
            results.append(
                f"expected {what} in steps of 2^-{int(np.log2(STEPS_PER_UNIT))}, found others"
            )
    lengths = np.sqrt(_dots(normals, normals)[mask])
    if np.abs(lengths - 1).max() > LENGTH:
        results.append(
            f"expected unit normals, found lengths {lengths.min():.4f}–{lengths.max():.4f}"
        )
    if away := count_turned_away(geometry, camera):
        results.append(f"expected normals that face the viewer, found {away} turned away")
    places = positions(geometry.depth, camera)
    radius = float(np.sqrt(_dots(places, places)[mask].max()))
    if radius > RADIUS:
        results.append(
            f"expected an object inside the unit sphere, found depths that put it at {radius:.4f}"
        )
    if (correlation := correlation_of_slopes(places, normals, mask)) < LEAST_CORRELATION:
        results.append(
            "expected normals that lean as the depth slopes, found a correlation of"
            f" {correlation:.2f}"
        )
    return results


def count_turned_away(geometry: Geometry, camera: Camera) -> int:
    """Return the number of the object's pixels whose normals face away: n·v ≤ 0."""
    if camera.fov_deg is None:
        return int((geometry.normals[geometry.mask][:, 2] <= 0).sum())
    height, width = geometry.mask.shape
    view = frames.view_vectors(height, width, fov=np.radians(camera.fov_deg))
    return int((_dots(geometry.normals.astype(np.float64), view)[geometry.mask] <= 0).sum())


def positions(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Return each pixel's surface point (height, width, 3), camera frame, object's centre at 0."""
    x, y = frames.pixel_grid(*depth.shape)
    depth = depth.astype(np.float64)
    spread = np.full_like(depth, camera.half_extent)
    if camera.fov_deg is not None:
        # the frame spans 2 half_extent at the centre's depth
        spread += np.tan(np.radians(camera.fov_deg) / 2) * depth
    return np.stack([x * spread, y * spread, -depth], axis=-1)


def correlation_of_slopes(places: np.ndarray, normals: np.ndarray, mask: np.ndarray) -> float:
    """Return the correlation of normals with the slope of the depth, from -1 to 1.

    It is the smaller one of the horizontal and the vertical correlation. Shading makes normals of
    flat faces lean as their neighbours do, but never in the opposite direction.

    places   (height, width, 3), of `positions`
    Returns  1 where the object has few pixels on smooth pieces, or none that lean
    """
    centre = np.s_[1:-1, 1:-1]
    sides = np.s_[1:-1, 2:], np.s_[1:-1, :-2], np.s_[:-2, 1:-1], np.s_[2:, 1:-1]
    smooth = mask[centre].copy()
    for side in sides:
        smooth &= mask[side] & (_dots(normals[centre], normals[side]) > SMOOTH)
    right, left, up, down = (places[side][smooth] for side in sides)
    slope, shown = np.cross(right - left, up - down), normals[centre][smooth]
    length = np.sqrt(_dots(slope, slope))
    known = length > 0
    if known.sum() < LEAST_PIXELS:
        return 1.0
    slope, shown = slope[known] / length[known, None], shown[known]
    energy = (slope**2).mean(0), (shown**2).mean(0)
    results = [
        float((slope[:, axis] * shown[:, axis]).mean() / np.sqrt(energy[0][axis] * energy[1][axis]))
        for axis in (0, 1)
        if min(energy[0][axis], energy[1][axis]) > LEAN**2
    ]
    return min(results, default=1.0)


def light_faults(
    L: np.ndarray, scale: float, reference: tuple[np.ndarray, float] | None, said_scale: float
) -> list[str]:
    """Check a stored light against the program's own map of this name and hash.

    reference  (L, scale) as the program makes them itself, None: it does not know the light
    said_scale the scale in dataset.json
    """
    results = []
    if scale != said_scale:
        results.append(f"expected scale {said_scale:.9g}, as in dataset.json, found {scale:.9g}")
    if reference is not None:
        true, true_scale = reference
        # sums on another machine differ in the last digits
        if not np.allclose(L, true, rtol=1e-4, atol=1e-6) or not np.isclose(
            scale, true_scale, rtol=1e-4
        ):
            results.append("expected the map of this name and hash, found another")
    return results


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return scalar products over the last axis."""
    return np.einsum("...c,...c->...", a, b)
