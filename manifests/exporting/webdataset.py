"""Parts of a WebDataset: tar files whose samples the package `webdataset` decodes by itself.

A sample is up to three files that share its id: ID.json (the line of the data set and the exposure
of the picture), ID.png (display values; not without a picture) and ID.npz (radiance, normals,
depth, segments, labels). The tar's headers hold nothing of this machine, so that the same data set
gives the same bytes.
"""

import io
import tarfile
from collections.abc import Iterator
from typing import BinaryIO

import msgspec

from manifests.exporting.samples import Sample, Samples, png_bytes
from manifests.files import npz_bytes


def write_tar(file: BinaryIO, samples: Iterator[Sample], source: Samples) -> None:
    """Write samples to a stream as one tar file."""
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for sample in samples:
            members = {"json": msgspec.json.encode(sample.metadata())}
            if sample.display is not None:
                members["png"] = png_bytes(sample.display)
            members["npz"] = npz_bytes(sample.arrays())
            for ending, data in members.items():
                info = tarfile.TarInfo(f"{sample.line.id}.{ending}")
                info.size = len(data)
                tar.addfile(info, io.BytesIO(data))
