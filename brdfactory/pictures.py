"""A picture as Python sees it: linear radiance, and how to show and save it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfactory import arguments
from learn.figures.montage import eight_bit
from manifests import files, outputs
from manifests.errors import InputError
from shaders import tone


@dataclass(frozen=True)
class Picture:
    """A picture as linear radiance, and how to show it.

    linear    (H, W, 3) float32 radiance, on the photograph's scale
    exposure  factor by which radiance is multiplied for display; 1 for a photograph
    opacity   (H, W) in [0, 1]; None: opaque everywhere
    """

    linear: np.ndarray
    exposure: float = 1.0
    opacity: np.ndarray | None = None

    @property
    def display(self) -> np.ndarray:
        """Display values (H, W, 3) uint8; (H, W, 4) if the picture is partly transparent."""
        values = tone.display(self.linear, self.exposure)
        if self.opacity is not None:
            values = np.concatenate([values, 255.0 * self.opacity[..., None]], -1)
        return eight_bit(values)

    def save(self, path: str | Path) -> Path:
        """Write the picture as a PNG or, as radiance, as an EXR; return the path.

        The path's ending decides which. Colours of an EXR are premultiplied by its alpha, which is
        the picture's opacity.

        Raises  InputError for another ending, and for a place that cannot be written; OSError
        """
        rule = "a file ending in .png or .exr"
        text = arguments.require_path("save", path, rule, "save('brass.png')")
        path = Path(text)
        kind = path.suffix.lower()
        if kind not in (".png", ".exr"):
            raise InputError(path, rule, kind or "no ending", "rename it")
        outputs.try_file(text)
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind == ".exr":
            from learn.data import photographs

            photographs.write_picture(path, self.linear, self.opacity)
        else:
            files.write_image(path, self.display, "PNG", compress_level=4)
        return path
