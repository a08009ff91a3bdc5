"""Reflectance maps of materials: tables of radiance by normal, as small as a picture allows.

A viewer that is far away sees one material under one light as a function of the normal alone. Its
reflectance map holds that radiance at the nodes of a square grid, and radiance at any other normal
is interpolated. Pages for trying materials (learn.editing.interactive) hold one for each material.

grid    The unit normal n, camera frame, lies at p = (n_x, n_y) / √(1 + n_z), a point of the disk
        |p| ≤ 1. `side` intervals stand across the disk. Catmull–Rom interpolation near its rim
        reads nodes outside it, so that MARGIN nodes more stand at either end of each row. Nodes
        are those of learn.methods.reflectance_map.
values  (side + 5, side + 5, 3) float32: the layer's radiance times the display's exposure; 1 is
        white.
codes   The same shape, uint16, by which a map is sent: STEPS · log(1 + BEND · values) /
        log(1 + BEND). A step is about as visible in the dark as in the light. Highlights far above
        white are kept, which blends of two materials need.
error   Root mean square difference from the layer at the normals that a picture shows, in grey
        levels of the display, from 0 to 255.

How fine a map must be is found by trial: `maps_of` renders maps of the sides in SIDES, the coarsest
first, until the error is at most LIMIT; sides that cannot suffice are left out. A fine map may be
rendered at fewer nodes, those that a given picture reads and every (side / COARSE)-th of the
others; each node that is left out has the value of the nearest one (`nodes_read`).

Narrow lobes are integrated, and broad ones summed over the light's texels, which is cheaper and
then as good (`separate_lobes`). `radiance_at_normals` uses two such maps to render a single picture
of many pixels in less time.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, maximum_filter

from learn.data.devices import to_numpy
from learn.layer import predictions
from learn.layer.display_method import method_for
from learn.methods import lobe_shapes, reflectance_map
from learn.methods.quadrature import BROAD
from shaders import tone
from shaders.dsbrdf import SHAPE

SIDES = (16, 32, 64, 128, 256, 512, 1024)
LARGEST = 256  # of SIDES, unless a Scene has another
COARSE = 64  # intervals across the disk to which a map is rendered where no pixel reads it
MARGIN = reflectance_map.MARGIN
LIMIT = 1.2  # grey levels, root mean square
# the finest maps take seconds and a quarter of a megabyte each: below this they are left out
LIMIT_OF_FINEST = 1.8
STEPS, BEND, BRIGHTEST = 256, 32.0, 1e4
# natural logarithm of κ: a lobe that reflects nothing. In float32 its exp is 0 and methods skip it;
# of the smallest κ above 0, they would sum it over all texels
NOTHING = -200.0
# (N, sides): N normals or more are looked up in two maps of these sides
LOOKED_UP = ((40_000, (64, 128)), (20_000, (32, 64)))
# Where the coarse map is off by more than DOUBT grey levels, normals are rendered instead of looked
# up. If these were more than the share MOST_RENDERED, all normals are rendered.
DOUBT, MOST_RENDERED = 3.0, 0.5
RIM = 0.999  # |p| of the outermost normals at which the layer renders


class Scene(NamedTuple):
    """What the maps of all materials share.

    light      (1, 3, Hl, Wl) radiance, light frame
    elevation  of the camera, radians
    exposure   (3,) factors from the layer's radiance to a display's
    tolerance  of the layer
    checked    (N, 3) unit normals, camera frame, where maps are compared with the layer
    finest     largest side of a map
    nodes      {side: Nodes at which maps of that side are rendered}; all nodes where it lacks one
    coded      whether maps are rounded to codes, which their errors then include
    """

    light: torch.Tensor
    elevation: float
    exposure: np.ndarray
    tolerance: float
    checked: np.ndarray
    finest: int = LARGEST
    nodes: "Mapping[int, Nodes] | None" = None
    coded: bool = False


def values_of(label: np.ndarray, scene: Scene) -> tuple[np.ndarray, float]:
    """Return the coarsest sufficient map of a label (108,), and its error in grey levels."""
    return maps_of(label, scene)[-1]


def maps_of(label: np.ndarray, scene: Scene) -> list[tuple[np.ndarray, float]]:
    """Return the maps of a label (108,) that were tried, each with its error in grey levels.

    They are from coarse to fine; the last is the first that is good enough, or the finest.
    """
    truth = radiance(scene.checked, label, scene, "")
    shown, error = tone.display(truth, 1.0), 0.0
    # where the cheaper method shows the same, nodes are rendered by it
    cheaper = _grey_levels_apart(radiance(scene.checked, label, scene, "auto"), shown)
    parts = [(label, "auto")] if cheaper < LIMIT / 2 else separate_lobes(label)
    results = []
    for side in (side for side in SIDES if side <= scene.finest):
        # twice as many nodes reduce the error to a quarter at best
        if error > 4 * LIMIT and side < scene.finest:
            error /= 4
            continue
        values = np.sum([render_map(part, scene, side, method) for part, method in parts], 0)
        if scene.coded:
            values = values_of_codes(codes_of(values))
        error = _grey_levels_apart(interpolate(values, scene.checked), shown)
        results.append((values, error))
        if error <= (LIMIT_OF_FINEST if 2 * side == SIDES[-1] else LIMIT):
            break
    return results


def radiance_at_normals(
    label: np.ndarray,
    n: np.ndarray,
    light: torch.Tensor,
    elevation: float,
    tolerance: float,
) -> np.ndarray:
    """Return radiance (N, 3) float32 of a material at unit normals (N, 3), camera frame.

    The integral over a narrow lobe is costly, so broad lobes are summed separately. Many normals
    are looked up in two reflectance maps, a coarse and a fine one, and only those are rendered
    about which the coarse map is off by more than DOUBT grey levels at the fine map's nodes, under
    automatic exposure.

    label      (108,) natural logarithms
    light      (1, 3, Hl, Wl) radiance, light frame
    elevation  of the camera, radians
    tolerance  of the layer
    """
    scene = Scene(light, elevation, np.ones(3), tolerance, n)
    if method_for(torch.from_numpy(np.asarray(label))) != "quadrature":
        return radiance(n, label, scene, "")
    parts = separate_lobes(label)
    sides = next((sides for least, sides in LOOKED_UP if len(n) >= least), None)
    if sides is None:
        return _radiance_of_parts(n, parts, scene)
    coarse, fine = (
        np.sum([render_map(part, scene, side, method) for part, method in parts], 0)
        for side in sides
    )
    result = interpolate(fine, n)
    exposure = tone.auto_exposure(result[None], np.ones((1, len(n)), bool))
    doubtful = _error_of_coarse_map(coarse, fine, exposure)[_nearest_node(n, len(fine))] > DOUBT
    if doubtful.mean() > MOST_RENDERED:
        return _radiance_of_parts(n, parts, scene)
    if doubtful.any():
        result[doubtful] = _radiance_of_parts(n[doubtful], parts, scene)
    return result


def _radiance_of_parts(
    n: np.ndarray, parts: Sequence[tuple[np.ndarray, str]], scene: Scene
) -> np.ndarray:
    """Return the sum (N, 3) of the radiances of labels at normals (N, 3), each by its method."""
    return np.sum([radiance(n, part, scene, method) for part, method in parts], 0)


def _error_of_coarse_map(coarse: np.ndarray, fine: np.ndarray, exposure: float) -> np.ndarray:
    """Return the largest difference between two maps about each node of the fine one.

    It is in grey levels, (size²,): what a coarse map is off by there.
    """
    upsampled = upsample(coarse, len(fine))
    difference = tone.display(upsampled, exposure) - tone.display(fine, exposure)
    return maximum_filter(np.abs(difference).max(-1), 3).ravel()


def _nearest_node(n: np.ndarray, size: int) -> np.ndarray:
    """Return the flat index of the node nearest to each normal (N, 3), of a map of that size."""
    column, row = (np.rint((disk_points(n) + 1) * (size - 5) / 2).astype(int) + MARGIN).T
    return row * size + column


def separate_lobes(label: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Return labels (108,) whose radiances add up to a label's, each with its method.

    The sum over texels is accurate for broad lobes, and much cheaper than the integral, so only
    narrow lobes are integrated.
    """
    lobes = np.asarray(label, np.float32).reshape(SHAPE)
    narrow = lobe_shapes.sharpness(np.exp(lobes)) > BROAD
    if narrow.all() or not narrow.any():
        return [(lobes.ravel(), "")]
    result = []
    for part, method in ((~narrow, "auto"), (narrow, "")):
        only = lobes.copy()
        only[:, ~part, 0] = NOTHING
        result.append((only.ravel(), method))
    return result


def _grey_levels_apart(values: np.ndarray, shown: np.ndarray) -> float:
    """Return the root mean square difference of values (N, 3) and display values, grey levels."""
    return float(np.sqrt(np.mean((tone.display(values, 1.0) - shown) ** 2)))


def radiance(n: np.ndarray, label: np.ndarray, scene: Scene, method: str) -> np.ndarray:
    """Return the layer's radiance (N, 3) at normals (N, 3), times the exposure of the display.

    method  of the layer; "": the one that suits the material
    """
    device = scene.light.device
    picture = predictions.picture(
        torch.from_numpy(np.ascontiguousarray(n.T, np.float32))[None, :, None].to(device),
        torch.from_numpy(np.asarray(label, np.float32).reshape(1, 1, -1)).to(device),
        scene.light,
        torch.ones(1, 1, len(n), dtype=torch.long, device=device),
        scene.elevation,
        predictions.Policy(method, scene.tolerance),
    )
    return to_numpy(picture[0, 0]) * scene.exposure.astype(np.float32)


class Nodes(NamedTuple):
    """The nodes of a grid.

    n        (N, 3) normals at which the layer renders: nodes on the disk, then two for each beyond
    inside   flat indices of nodes on the disk
    beyond   flat indices of nodes beyond it that interpolation on the disk reads
    share    (len(beyond), 1) of radiance at the rim in the linear continuation
    nearest  (size²) flat index of the nearest node that is read
    """

    n: np.ndarray
    inside: np.ndarray
    beyond: np.ndarray
    share: np.ndarray
    nearest: np.ndarray


@functools.cache
def nodes_of(side: int) -> Nodes:
    """Return the Nodes of a grid of `side` intervals across the disk."""
    size, h = side + 5, 2 / side
    line = (np.arange(size) - MARGIN) * h - 1
    p = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    r = np.linalg.norm(p, axis=-1)
    inside = np.flatnonzero(r <= RIM)
    # interpolation at |p| ≤ 1 reads nodes up to two columns and two rows away
    beyond = np.flatnonzero((r > RIM) & (r < 1 + 2.9 * h))
    out = p[beyond] / r[beyond, None]
    # the layer has no radiance where the normal looks away: it is continued linearly from between
    # the rim and a point as far within
    step = np.maximum(r[beyond] - RIM, h)
    share = 1 + (r[beyond] - RIM) / step
    n = normals_at_points(np.concatenate([p[inside], out * RIM, out * (RIM - step)[:, None]]))
    read = np.zeros(size * size, bool)
    read[inside] = read[beyond] = True
    return Nodes(n, inside, beyond, share[:, None], _nearest_of(read, size))


def normals_at_points(p: np.ndarray) -> np.ndarray:
    """Return unit normals (N, 3) of points (N, 2) of the disk."""
    z = 1 - (p * p).sum(-1, keepdims=True)
    return np.concatenate([p * np.sqrt(1 + z), z], -1)


def disk_points(n: np.ndarray) -> np.ndarray:
    """Return the points (…, 2) of the disk of unit normals (…, 3): undoes `normals_at_points`."""
    return n[..., :2] / np.sqrt(1 + np.maximum(n[..., 2:], 0))


def nodes_read(n: np.ndarray, side: int) -> Nodes:
    """Return the Nodes of a grid that unit normals (N, 3) read, and every side / COARSE-th one.

    side  COARSE at least
    """
    nodes, size = nodes_of(side), side + 5
    corner = np.floor((disk_points(n) + 1) * side / 2).astype(int) + MARGIN
    read = np.zeros((size, size), bool)
    read[corner[:, 1].clip(0, size - 1), corner[:, 0].clip(0, size - 1)] = True
    # interpolation reads nodes −1 to 2 from the corner; one more, because whoever looks up rounds
    read = maximum_filter(read, 6)
    step = side // COARSE
    read[MARGIN + step // 2 :: step, MARGIN + step // 2 :: step] = True
    inside, beyond = read.ravel()[nodes.inside], read.ravel()[nodes.beyond]
    kept = np.zeros(size * size, bool)
    kept[nodes.inside[inside]] = kept[nodes.beyond[beyond]] = True
    return Nodes(
        nodes.n[np.concatenate([inside, beyond, beyond])],
        nodes.inside[inside],
        nodes.beyond[beyond],
        nodes.share[beyond],
        _nearest_of(kept, size),
    )


def _nearest_of(kept: np.ndarray, size: int) -> np.ndarray:
    """Return for each node (size²) the flat index of the nearest one of `kept` (size²) bool."""
    index = distance_transform_edt(
        ~kept.reshape(size, size), return_distances=False, return_indices=True
    )
    return (index[0] * size + index[1]).ravel()


def render_map(label: np.ndarray, scene: Scene, side: int, method: str) -> np.ndarray:
    """Return the values of a map of `side` intervals, rendered by a method of the layer."""
    nodes, size = (scene.nodes or {}).get(side) or nodes_of(side), side + 5
    result = radiance(nodes.n, label, scene, method)
    first, second = len(nodes.inside), len(nodes.inside) + len(nodes.beyond)
    rim, within = result[first:second], result[second:]
    values = np.zeros((size * size, 3), np.float32)
    values[nodes.inside] = result[:first]
    values[nodes.beyond] = np.maximum(nodes.share * rim + (1 - nodes.share) * within, 0)
    return values[nodes.nearest].reshape(size, size, 3)


def interpolate(values: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return values (N, 3) of a map at unit normals (N, 3), by Catmull–Rom weights."""
    size = len(values)
    n_, table = torch.from_numpy(np.ascontiguousarray(n, np.float32)), torch.from_numpy(values)
    nodes = torch.arange(size * size)
    return reflectance_map.look_up(n_, table.reshape(-1, 3), nodes, size).numpy()


def upsample(values: np.ndarray, size: int) -> np.ndarray:
    """Return a reflectance map (a, a, 3) read at the nodes of a finer one (size, size, 3)."""
    if len(values) == size:
        return values
    # node i of a map stands at (i − MARGIN) 2 / (a − 5) − 1
    at = (np.arange(size) - MARGIN) * (len(values) - 5) / (size - 5) + MARGIN
    at = at.clip(0, len(values) - 1)
    low = np.minimum(at.astype(int), len(values) - 2)
    low = np.clip(low, 1, len(values) - 3)
    t = (at - low).astype(np.float32)
    # Catmull–Rom weights, as interpolation within a map
    weights = np.stack(
        [
            -0.5 * t + t**2 - 0.5 * t**3,
            1 - 2.5 * t**2 + 1.5 * t**3,
            0.5 * t + 2 * t**2 - 1.5 * t**3,
            -0.5 * t**2 + 0.5 * t**3,
        ],
        -1,
    )
    matrix = np.zeros((size, len(values)), np.float32)
    for k in range(4):
        matrix[np.arange(size), low - 1 + k] += weights[:, k]
    result = np.einsum("ia,abc,jb->ijc", matrix, values, matrix, optimize=True)
    return np.maximum(result, 0).astype(np.float32)


def codes_of(values: np.ndarray) -> np.ndarray:
    """Return the codes (uint16) of a map's values."""
    scaled = np.log1p(BEND * np.clip(values, 0, BRIGHTEST)) * (STEPS / np.log1p(BEND))
    return np.rint(scaled).astype(np.uint16)


def values_of_codes(codes: np.ndarray) -> np.ndarray:
    """Return the values (float32) that codes stand for, the inverse of `codes_of`."""
    return (np.expm1(codes * (np.log1p(BEND) / STEPS)) / BEND).astype(np.float32)
