"""Materials, lights and cameras of the work-precision chart, and the settings of its methods.

A point of the chart is a method with a knob, `Setting(method, knob, radiance)`, where
radiance(batch) → (P, 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from learn import methods
from learn.experiments.layer import chart_shapes
from learn.layer.compaction import compact_pixels
from learn.layer.inputs import check_inputs
from learn.methods import Batch, hybrid, median_cut, reflectance_map, sampling, spherical_gaussians
from manifests import arrays, exr, light_files
from manifests.errors import InputError, closest
from shaders import envmap
from shaders.frames import ELEVATION, view_vectors

MATERIALS = (  # from matte to mirror
    "pink-fabric", "white-diffuse-bball", "nylon", "pearl-paint", "gold-paint",
    "red-plastic", "alum-bronze", "chrome",
)  # fmt: skip
SIZE = (64, 128)
FIELD_OF_VIEW = np.radians(30)


@dataclass(frozen=True)
class Setting:
    """A method with a knob: its tolerance, or its number of lights or samples."""

    method: str
    knob: str
    radiance: Callable[[Batch], torch.Tensor]


def settings() -> list[Setting]:
    """Return every point of the chart."""

    def at(batch: Batch, name: str, tolerance: float) -> torch.Tensor:
        return methods.load(name).radiance(batch, tolerance)

    def by_tolerance(name: str, *tolerances: float) -> list[Setting]:
        return [Setting(name, f"{t:g}", partial(at, name=name, tolerance=t)) for t in tolerances]

    def by_count(
        name: str, function: Callable[[Batch, int], torch.Tensor], *counts: int
    ) -> list[Setting]:
        def at(batch: Batch, count: int) -> torch.Tensor:
            return function(batch, count)

        return [Setting(name, str(count), partial(at, count=count)) for count in counts]

    return [
        *by_tolerance("exact", 1e-2),
        *by_tolerance("culled", 1e-1, 1e-2, 1e-4),
        *by_count("reflectance_map", reflectance_map.radiance_by_size, 16, 32, 64, 96),
        *by_count("median_cut", median_cut.radiance_by_lights, 64, 256, 1024, 4096),
        *by_count("hybrid", lambda b, c: hybrid.radiance_by_lights(b, c, 1.0 / c), 64, 256, 1024),
        *by_tolerance("quadrature", 1e-2),
        *by_tolerance("spherical_harmonics", 1e-2),
        *by_tolerance("split_sum", 1e-2),
        *by_count("spherical_gaussians", spherical_gaussians.radiance_by_lights, 64),
        *by_count(
            "monte_carlo", lambda b, c: sampling.radiance_by_samples(b, c // 2, c // 2), 16, 64
        ),
        *by_count("monte_carlo_light", lambda b, c: sampling.radiance_by_samples(b, c, 0), 16),
        *by_count("monte_carlo_brdf", lambda b, c: sampling.radiance_by_samples(b, 0, c), 16),
        *by_tolerance("auto", 5e-2, 1e-2, 1e-3, 1e-4, 1e-5),
    ]


def leading_settings() -> list[Setting]:
    """Return the points that come near the front, for the further shapes and sizes."""
    knobs = {"auto": ("0.05", "0.01", "0.001"), "culled": ("0.01",), "quadrature": ("0.01",)}
    knobs |= {"reflectance_map": ("32", "64"), "median_cut": ("256", "1024"), "hybrid": ("256",)}
    return [each for each in settings() if each.knob in knobs.get(each.method, ())]


def computed_lights() -> dict[str, np.ndarray]:
    """Return {name: (64, 128, 3)} of lights that need no file."""
    w, _ = envmap.directions(*SIZE)
    sky = 0.2 + np.clip(w[..., 1:2], 0, 1) * [0.5, 0.8, 1.4]
    lamps = (
        0.05
        + sum(
            5.0 * np.exp(40 * (w @ (a / np.linalg.norm(a)) - 1))
            for a in np.array([(1, 1, 1), (-2, 1, 0), (0, 0.3, 1)])
        )[..., None]
    )
    spot = np.zeros((*SIZE, 3))
    spot[18, 25] = 1.0
    result = {"sky": sky, "lamps": lamps * np.ones(3), "one texel": spot}
    result = {name: envmap.unit_mean(L)[0] for name, L in result.items()}
    return result | {"sun in a texel": sun_in((20, 40))}


def sun_in(texel: tuple[int, int]) -> np.ndarray:
    """Return (64, 128, 3): 0.6 of the light from one texel, the rest from everywhere alike."""
    light = np.full((*SIZE, 3), 0.4)
    light[texel] = 0.6 * 4 * np.pi / envmap.directions(*SIZE)[1][texel]
    return envmap.unit_mean(light)[0]


def lights(folder: Path | None = None, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Return the computed lights, or the sun in a texel and the maps of a folder.

    folder  with *.exr, or a data set
    names   of those that are requested, of a folder their beginnings; None: all
    """
    if folder is None:
        computed = computed_lights()
        if unknown := [name for name in names or () if name not in computed]:
            raise InputError(
                "--light", "a computed light", f"'{unknown[0]}'", closest(unknown[0], computed)
            )
        return {name: light for name, light in computed.items() if not names or name in names}
    result = {"sun in a texel": computed_lights()["sun in a texel"]}
    paths = sorted(Path(folder).glob("*.exr")) or sorted((Path(folder) / "lights").glob("**/*.npz"))
    chosen = [
        path for path in paths if names is None or any(path.stem.startswith(name) for name in names)
    ]
    if not chosen:
        stems = ", ".join(path.stem for path in paths) or "none"
        raise InputError(
            folder,
            "environment maps (*.exr, or a dataset with lights)",
            stems,
            "check the path and the names, or leave --lights out",
        )
    return result | {
        path.stem: envmap.unit_mean(envmap.resize(np.maximum(radiance_of(path), 0), *SIZE))[0]
        for path in chosen
    }


def radiance_of(path: Path) -> np.ndarray:
    """Return (height, width, 3) of an EXR, or of a dataset's light."""
    if path.suffix == ".npz":
        return light_files.read_light(path).astype(np.float64)
    channels = exr.read(path)
    if missing := [name for name in arrays.PICTURE_CHANNELS if name not in channels]:
        raise InputError(
            path,
            f"channels {', '.join(arrays.PICTURE_CHANNELS)}",
            f"no {', '.join(missing)}",
            "export it as RGB",
        )
    return np.stack([channels[name] for name in arrays.PICTURE_CHANNELS], -1).astype(np.float64)


def sphere(size: int) -> torch.Tensor:
    """Return normals (1, size, size, 3) of a sphere that covers 40 % of the picture."""
    return chart_shapes.normals("sphere", size)


def batch_of(
    label: np.ndarray,
    light: np.ndarray,
    size: int,
    camera: str,
    with_gradients: bool = False,
    shape: str = "sphere",
) -> tuple[Batch, list[torch.Tensor]]:
    """Return a batch of one shape, and its tensors, which require gradients or not."""
    n, m = (
        chart_shapes.normals(shape, size),
        torch.as_tensor(np.exp(np.asarray(label)).reshape(1, 108), dtype=torch.float32),
    )
    L = torch.as_tensor(light, dtype=torch.float32)[None]
    view = None
    if camera == "perspective":
        view = torch.as_tensor(view_vectors(size, size, FIELD_OF_VIEW).copy(), dtype=torch.float32)[
            None
        ]
        n = torch.where((n * view).sum(-1, keepdim=True) > 1e-3, n, torch.zeros(()))
    leaves = [x.requires_grad_(with_gradients) for x in (n, m, L)]
    mask = (n != 0).any(-1).detach()
    return compact_pixels(check_inputs(n, m, L, view, None, mask, 1e-2, ELEVATION))[0], leaves
