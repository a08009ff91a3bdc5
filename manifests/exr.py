"""OpenEXR files, read and written in the same way by the factory and by training."""

import contextlib
import io
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from manifests.errors import InputError
from manifests.files import write_bytes
from manifests.inputs import require_file
from manifests.quiet import silenced

MAX_PIXELS = 1 << 26  # 8192²: a header may ask for more than there is memory
MAX_BYTES = 16 * MAX_PIXELS  # of all channels of all parts


class Part:
    """The header of a part, read before memory is allocated for its pixels.

    height, width  of the data window; 0 where it is inverted
    channels       names
    flat           not deep
    sampled        some channel is smaller than the picture
    bytes          the most that the library allocates to read the part: for pixels, and for a tile
    """

    def __init__(self, header: dict[str, Any]):
        import OpenEXR

        self.flat = header.get("type", OpenEXR.scanlineimage) in (
            OpenEXR.scanlineimage,
            OpenEXR.tiledimage,
        )
        low, high = header["dataWindow"]
        self.width, self.height = (max(int(high[k]) - int(low[k]) + 1, 0) for k in (0, 1))
        self.channels = [channel.name for channel in header["channels"]]
        self.sampled = any(
            channel.xSampling != 1 or channel.ySampling != 1 for channel in header["channels"]
        )
        tile = header["tiles"].xSize * header["tiles"].ySize if "tiles" in header else 0
        self.bytes = 4 * len(self.channels) * (self.height * self.width + tile)


def parts_of(file: Any) -> list[Part]:
    """Return the Part of each part of an open OpenEXR.File; the library always reads all."""
    return [Part(file.header(k)) for k in range(len(file.parts))]


def read(path: str | os.PathLike, data: bytes | None = None) -> dict[str, np.ndarray]:
    """Return the channels of a file: {name: (height, width) array of the file's own type}.

    data    the file's bytes if they are in memory; `path` then only names them
    Raises  InputError for a file that is missing, truncated, no EXR, or larger than MAX_PIXELS
    """
    if data is None:
        require_file(path, "an OpenEXR file", "render or copy it again")
    # the library prints each error besides raising it, by C and by Python
    with silenced(2), contextlib.redirect_stdout(io.StringIO()):
        return _read(path, data)


def _read(path, data):
    import OpenEXR

    def source():
        return str(path) if data is None else io.BytesIO(data)

    try:
        with OpenEXR.File(source(), separate_channels=True, header_only=True) as file:
            parts = parts_of(file)
        width, height = (parts[0].width, parts[0].height) if parts else (0, 0)
        if not 1 <= height * width <= MAX_PIXELS:
            raise InputError(
                path,
                f"a picture of 1 to {MAX_PIXELS} pixels",
                f"{width} × {height}",
                "check the file's header",
            )
        if not all(part.flat for part in parts) or sum(part.bytes for part in parts) > MAX_BYTES:
            raise InputError(
                path,
                f"flat pictures of at most {MAX_BYTES >> 20} MiB",
                "more in its header",
                "check the file's header",
            )
        with OpenEXR.File(source(), separate_channels=True) as file:
            return {name: channel.pixels for name, channel in file.channels().items()}
    except InputError:
        raise
    except Exception as error:  # OpenEXR raises bare RuntimeErrors and others, by version
        raise InputError(
            path, "a whole OpenEXR file", str(error)[:160] or "none", "render or copy it again"
        ) from None


def encode(channels: Mapping[str, np.ndarray]) -> bytes:
    """Return the bytes of an OpenEXR file.

    channels  {name: (height, width) array of float16, float32 or uint32}
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # not a path: the library ignores the error of its last flush to a file
    buffer = io.BytesIO()
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(header, contiguous) as file:
        file.write(buffer)
    return buffer.getvalue()


def write(path: str | os.PathLike, channels: Mapping[str, np.ndarray]) -> None:
    """Write channels as `encode` takes them, whole or not at all.

    Raises  OSError with the system's reason
    """
    write_bytes(path, encode(channels))
