"""OpenEXR files read and written the same way on both sides of the contract: whole or not there at all."""

import contextlib
import io

import numpy as np

from manifests.files import write_bytes
from manifests.inputs import require_file
from manifests.problems import Problem
from manifests.quiet import silenced

MAX_PIXELS = 1 << 26  # 8192²: a header may ask for more than there is memory


def read(path, data=None):
    """Channels of a file, name → (height, width) array of the file's own type.

    data    the file's bytes, where they are in memory already; `path` only names them then
    Raises  Problem for a file that is missing, truncated, no EXR, or larger than MAX_PIXELS
    """
    if data is None:
        require_file(path, "an OpenEXR file", "render or copy it again")
    with silenced(2), contextlib.redirect_stdout(io.StringIO()):  # the library prints each error besides raising it, by C and by Python
        return _read(path, data)


def _read(path, data):
    import OpenEXR

    def source():
        return str(path) if data is None else io.BytesIO(data)

    try:
        with OpenEXR.File(source(), separate_channels=True, header_only=True) as file:
            low, high = (np.asarray(corner, np.int64) for corner in file.header()["dataWindow"])
        width, height = np.maximum(high - low + 1, 0).tolist()
        if not 1 <= height * width <= MAX_PIXELS:
            raise Problem(path, f"a picture of 1 to {MAX_PIXELS} pixels", f"{width} × {height}", "check the file's header")
        with OpenEXR.File(source(), separate_channels=True) as file:
            return {name: channel.pixels for name, channel in file.channels().items()}
    except Problem:
        raise
    except Exception as error:  # OpenEXR raises bare RuntimeErrors and others, by version
        raise Problem(path, "a whole OpenEXR file", str(error)[:160] or "none", "render or copy it again") from None


def encode(channels):
    """The bytes of an OpenEXR file of channels, name → (height, width) array of float16, float32 or uint32."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    buffer = io.BytesIO()  # not a path: the library passes over the error of its last flush to a file
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(header, contiguous) as file:
        file.write(buffer)
    return buffer.getvalue()


def write(path, channels):
    """Writes channels as `encode` takes them, whole or not at all. Raises OSError with the system's reason."""
    write_bytes(path, encode(channels))
