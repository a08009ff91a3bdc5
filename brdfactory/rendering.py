"""Render normals under a light with numpy arrays; `RenderLayer` does so with tensors."""

from pathlib import Path

import numpy as np

from brdfactory import arguments
from brdfactory.materials import Material, material
from learn.editing import desired_light
from manifests import measured_lights
from manifests.errors import InputError, closest
from shaders import envmap
from shaders.frames import ELEVATION

PICTURE = "bf.decompose(photo, mask).light is the light of a picture"


def light(text: str | Path, rotation_deg: float = 0.0) -> np.ndarray:
    """Return a light (64, 128, 3) float32 of unit mean luminance, light frame.

    text          a measured map's name ("city", "courtyard", …), a map FILE.exr or FILE.npz#NAME,
                  or computed:SEED
    rotation_deg  about the vertical, rounded to the map's columns of 2.8°
    Raises        InputError: an unknown name, an unusable map
    """
    rule = "a light's name or file; an array is a light already"
    text = arguments.require_path("light", text, rule, "bf.light('city') is one")
    rule = "a number of degrees"
    rotation_deg = arguments.require_number("light: rotation_deg", rotation_deg, rule, "give 0")
    if not np.isfinite(rotation_deg):
        raise InputError("light: rotation_deg", rule, f"{rotation_deg}", "give 0")
    known = measured_lights.credits()
    names = {name: name for name in known}
    names |= {name.removeprefix("blender_"): name for name in known if name.startswith("blender_")}

    def refuse(path: object) -> np.ndarray:
        rule = f"a measured map's name, {desired_light.FORMS.rsplit(', or', 1)[0]}"
        raise InputError(
            f"light {text}", rule, "none of these", f"{closest(text, names)} {PICTURE}"
        )

    if text in names:
        turned = envmap.roll(
            measured_lights.load(names[text]), round(rotation_deg / 360 * desired_light.WIDTH)
        )
        return envmap.unit_mean(turned.astype(np.float32))[0].astype(np.float32)
    return desired_light.resolve_light(text, refuse, rotation_deg)


def render(
    normals: np.ndarray,
    light: np.ndarray,
    material: "str | np.ndarray | Material" = "white-diffuse-bball",
    mask: np.ndarray | None = None,
    elevation: float = float(ELEVATION),
) -> np.ndarray:
    """Return the linear radiance (H, W, 3) float32 of normals in a material under a light.

    normals    (H, W, 3) unit vectors, camera frame; 0 in the background
    light      (Hl, Wl, 3) linear radiance, light frame
    material   as `brdfactory.material` takes it; a blend's picture is its parts' weighted sum
    mask       (H, W) bool; None: where normals are not 0
    elevation  radians from the light frame to the camera's, docs/conventions.md
    Raises     InputError: arrays of other shapes, normals that are not unit vectors
    """
    import torch

    from learn.layer import predictions

    rule = "a finite array (height, width, 3)"
    n = arguments.require_floats("render: normals", normals, rule, "bf.decompose gives normals")
    L = arguments.require_floats("render: light", light, rule, "bf.light('city') is one")
    for name, array in (("normals", n), ("light", L)):
        if array.ndim != 3 or array.shape[2] != 3 or not np.isfinite(array).all():
            raise InputError(f"render: {name}", rule, f"shape {array.shape}", "see its help")
    if mask is None:
        covered = (n != 0).any(-1)
    else:
        rule = f"an array {n.shape[:2]} of bool"
        covered = arguments.require_floats("render: mask", mask, rule, arguments.ARRAY) != 0
    if covered.shape != n.shape[:2]:
        rule = f"shape {n.shape[:2]}, as the normals"
        raise InputError("render: mask", rule, f"{covered.shape}", "give one mask per picture")
    picture = np.zeros(n.shape, np.float32)
    if not covered.any():
        return picture
    try:
        for weight, label in _parts(material):
            part = predictions.picture(
                torch.from_numpy(np.where(covered[..., None], n, 0)).movedim(-1, 0)[None],
                torch.from_numpy(label)[None, None],
                torch.from_numpy(L).movedim(-1, 0)[None],
                torch.from_numpy(covered.astype(np.int64))[None],
                elevation,
                predictions.SHOWN,
            )
            picture += weight * part[0].numpy()
    except InputError:
        raise
    except ValueError as error:  # of the layer: it names the argument, the rule and the value
        raise InputError(
            "render", "arrays as its help describes", str(error), "see help(bf.render)"
        ) from None
    return picture


def _parts(text: "str | np.ndarray | Material") -> tuple[tuple[float, np.ndarray], ...]:
    return material(text).parts
