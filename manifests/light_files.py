"""Files of stored light maps: how they are written and read."""

import io
import zipfile
from pathlib import Path

import numpy as np

from manifests import archives
from manifests.arrays import LIGHT_MEMBERS
from manifests.errors import InputError
from manifests.files import npz_bytes
from manifests.inputs import require_file, require_hash
from manifests.wording import number_of
from shaders.envmap import mean_radiance
from shaders.tone import LUMINANCE

LIGHT_BYTES = 4 << 20  # a stored map takes a tenth of it
UNIT_MEAN = 1e-4  # of a light's mean luminance; float32 sums keep it to 1e-6
LIGHT_AGAIN = "render or copy the data set again"
_NO_ARCHIVE = (*archives.DAMAGE, KeyError)  # KeyError: a member is missing


def encode_light(L: np.ndarray, scale: float) -> bytes:
    """Return the bytes of a stored light's file.

    L      (64, 128, 3)
    scale  what L was divided by
    """
    return npz_bytes({"L": np.asarray(L, np.float32), "scale": np.float64(scale)})


def read_light(path: str | Path, file_hash: str | None = None) -> np.ndarray:
    """Return L (64, 128, 3) float32 of a stored light: finite, not negative, mean luminance 1.

    file_hash  sha256 that the file must have, None: any
    Raises     InputError
    """
    arrays, data = _light_arrays(path, ("L",))
    L = arrays["L"]
    if wrong := int((~(np.isfinite(L) & (L >= 0))).sum()):
        raise InputError(
            path,
            "finite radiance ≥ 0",
            number_of(wrong, "value that is not", "values that are not"),
            LIGHT_AGAIN,
        )
    if not abs((mean := float(mean_radiance(L) @ LUMINANCE)) - 1) <= UNIT_MEAN:
        raise InputError(
            path, "radiance of unit mean luminance", f"a mean of {mean:.6g}", LIGHT_AGAIN
        )
    require_hash(path, data, file_hash)
    return L.astype(np.float32)


def read_scale(path: str | Path) -> float:
    """Return the number by which a stored light was divided.

    Raises  InputError: no such file, other members or types than `encode_light` writes
    """
    arrays, _ = _light_arrays(path, tuple(LIGHT_MEMBERS), exact=True)
    scale = float(arrays["scale"])
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(path, "a finite scale above 0", f"{scale:g}", LIGHT_AGAIN)
    return scale


def _light_arrays(
    path: str | Path, names: tuple[str, ...], exact: bool = False
) -> tuple[dict[str, np.ndarray], bytes]:
    """Return members of a stored light, and the file's bytes.

    exact  refuse other members, and other types than `encode_light` writes
    """
    data = require_file(path, "a stored light map", LIGHT_AGAIN, LIGHT_BYTES).read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            there = sorted(archive.namelist())
            if exact and there != sorted(f"{name}.npy" for name in names):
                raise InputError(
                    path,
                    f"arrays {', '.join(names)} alone",
                    ", ".join(there)[:120] or "none",
                    LIGHT_AGAIN,
                )
            arrays = {name: _light_member(path, archive, name) for name in names}
    except InputError:
        raise
    except _NO_ARCHIVE as error:
        result = str(error).replace("\n", " ")[:120] or type(error).__name__
        raise InputError(path, "a stored light map", result, LIGHT_AGAIN) from None
    if exact and (
        other := [name for name in names if arrays[name].dtype != LIGHT_MEMBERS[name][1]]
    ):
        expected, result = LIGHT_MEMBERS[other[0]][1], arrays[other[0]].dtype
        raise InputError(path, f"{other[0]} of {expected}", str(result), LIGHT_AGAIN)
    return arrays, data


def _light_member(path: str | Path, archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return one array of a stored light; its size is checked before memory is allocated."""
    expected = LIGHT_MEMBERS[name][0]
    what = f"radiance of shape {expected}" if name == "L" else f"one number {name}"
    with archive.open(f"{name}.npy") as stored:
        header = archives.ArrayHeader(stored)
        if header.shape != expected or header.dtype.kind != "f":
            raise InputError(path, what, f"{header.shape} of {header.dtype}", LIGHT_AGAIN)
        values = np.frombuffer(stored.read(header.bytes), header.dtype)
        return values.reshape(header.shape, order="F" if header.fortran else "C")
