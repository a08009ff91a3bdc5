"""HDF5 files with the keys of BlenderProc's writer, and a reader of both programs' files.

BlenderProc (`blenderproc.writer.write_hdf5`) writes a file N.hdf5 for each frame, with one gzipped
dataset for each output and JSON as byte strings:

colors                   (height, width, 3) uint8 display values
normals                  (height, width, 3) float32, (n + 1) / 2 in the camera frame (x right, y up,
                         z towards the viewer); 0.5 in the background
depth                    (height, width) float32, distance from the camera's plane along the optical
                         axis; 1e10 in the background. Ours is in radii of the object's sphere
instance_segmaps         (height, width) integers; 0 in the background
instance_attribute_maps  JSON: a list of {"idx", "name", "category_id"} of the instances; names are
                         those of materials, category_id is the segment

Ours have three more keys, which programs for BlenderProc's files ignore: `radiance` (float16,
linear Rec.709), `labels` (segments × L float32) and `record`, the line of the data set as JSON.
"""

import io
import os
from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from manifests.arrays import MOST_SEGMENTS
from manifests.errors import InputError
from manifests.exporting.samples import Sample, Samples
from manifests.inputs import require_file
from manifests.picture_files import Geometry
from manifests.schema import Record
from shaders.frames import camera_distance

FAR = 1e10  # depth of the background
MOST_FILE_BYTES = 1 << 30
MOST_SIDE = 8192
BACKGROUND_DEPTH = 1e5  # depths above it are no surface: BlenderProc's clip ends before
AGAIN = "write it again with BlenderProc or export --to hdf5"
# dimensions, kinds of numbers (numpy's letters), and the most bytes that a number takes
KEYS: dict[str, tuple[int, str, int]] = {
    "colors": (3, "u", 1),
    "normals": (3, "f", 8),
    "depth": (2, "f", 8),
    "instance_segmaps": (2, "ui", 8),
}


class Frame(NamedTuple):
    """What a file shows, in the units and frames of this project.

    colors    (height, width, 3) uint8 display values, None if the file has none
    geometry  normals in the camera frame, depth as in the file and 0 in the background, segments in
              the order of the file's instance ids, or one segment where it has none
    """

    colors: np.ndarray | None
    geometry: Geometry


def require_package() -> None:
    """Raise InputError where h5py is missing."""
    try:
        import h5py  # noqa: F401 (is it there?)
    except ImportError as error:
        raise InputError(
            "HDF5 files", "the package h5py", str(error).split(":")[0], "pip install h5py"
        ) from None


def write_frame(file: BinaryIO, samples: Iterator[Sample], source: Samples) -> None:
    """Write one sample to a stream as one HDF5 file."""
    import h5py
    import msgspec

    (sample,) = samples
    line, geometry, mask = sample.line, sample.geometry, sample.geometry.mask
    arrays: dict[str, np.ndarray] = {}
    if sample.display is not None:
        arrays["colors"] = sample.display
    arrays["normals"] = (geometry.normals + 1) / 2
    away = np.float32(camera_distance(line.camera.half_extent, line.camera.fov_deg))
    arrays["depth"] = np.where(mask, geometry.depth + away, np.float32(FAR))
    arrays["instance_segmaps"] = geometry.segments.astype(np.int32)
    extra = sample.arrays()
    arrays |= {name: extra[name] for name in ("radiance", "labels") if name in extra}
    count = line.segments
    names = line.materials if isinstance(line, Record) else ("",) * count
    instances = [{"idx": 0, "name": "background", "category_id": 0}]
    instances += [{"idx": k, "name": n, "category_id": k} for k, n in enumerate(names, 1)]
    texts = {"instance_attribute_maps": instances, "record": sample.metadata()}
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as made:
        for key, array in arrays.items():
            made.create_dataset(key, data=array, compression="gzip")
        for key, value in texts.items():
            made.create_dataset(key, data=np.bytes_(msgspec.json.encode(value)))
    file.write(buffer.getvalue())


def read_frame(path: str | os.PathLike) -> Frame:
    """Return the Frame of a file that BlenderProc or `export --to hdf5` has written.

    Sizes are bounded before memory is taken, and no other file is read: links, virtual datasets
    and external storage are refused.

    Raises  InputError: no such file, damaged, none of normals and depth and segments, wrong sizes
    """
    require_package()
    import h5py

    require_file(path, "an HDF5 file", "check the path", MOST_FILE_BYTES)
    try:
        with h5py.File(path, "r") as file:
            arrays = {key: _array(path, file, key) for key in KEYS if key in file}
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(path, "an HDF5 file", str(error).splitlines()[0][:200], AGAIN) from None
    sizes = {array.shape[:2] for array in arrays.values()}
    if len(sizes) != 1 or set(arrays) == {"colors"}:
        result = f"the keys {', '.join(arrays) or 'none'} of {len(sizes)} sizes"
        raise InputError(path, "normals, depth or instance_segmaps of one size", result, AGAIN)
    return Frame(arrays.get("colors"), _geometry(path, arrays))


def _array(path: str | os.PathLike, file: Any, key: str) -> np.ndarray:
    """Return one dataset of a file, after its kind and size have been checked."""
    import h5py

    dimensions, kinds, most = KEYS[key]
    link = file.get(key, getlink=True)
    dataset = file[key] if isinstance(link, h5py.HardLink) else None
    if not isinstance(dataset, h5py.Dataset) or dataset.is_virtual or dataset.external:
        raise InputError(f"{path}: {key}", "an array in the file itself", "a link", AGAIN)
    shape, dtype = dataset.shape, dataset.dtype
    if key == "instance_segmaps" and shape is not None and len(shape) == 3 and shape[2] == 1:
        shape = shape[:2]
    fits = (
        shape is not None
        and len(shape) == dimensions
        and all(0 < side <= MOST_SIDE for side in shape[:2])
        and (dimensions == 2 or shape[2] == 3)
        and dtype.kind in kinds
        and dtype.itemsize <= most
    )
    if not fits:
        expected = f"height × width{' × 3' * (dimensions == 3)} numbers, sides to {MOST_SIDE}"
        raise InputError(f"{path}: {key}", expected, f"{shape} of type {dtype}", AGAIN)
    return np.asarray(dataset[()]).reshape(shape)


def _geometry(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> Geometry:
    """Return what the arrays show as Geometry; what a file lacks is 0."""
    size = next(iter(arrays.values())).shape[:2]
    masks = []
    segments = np.zeros(size, np.uint8)
    if (ids := arrays.get("instance_segmaps")) is not None:
        masks.append(ids != 0)
        known = np.unique(ids[ids != 0])
        if len(known) > MOST_SEGMENTS:
            raise InputError(
                path, f"at most {MOST_SEGMENTS} instances", str(len(known)), "join some of them"
            )
        segments = np.where(ids != 0, np.searchsorted(known, ids) + 1, 0).astype(np.uint8)
    normals = np.zeros((*size, 3), np.float32)
    if (stored := arrays.get("normals")) is not None:
        normals = stored.astype(np.float32) * 2 - 1
        lengths = np.linalg.norm(normals, axis=-1)
        masks.append(np.isfinite(lengths) & (lengths > 0.5))
        normals = normals / np.where(lengths > 0.5, lengths, 1)[..., None]
    depth = np.zeros(size, np.float32)
    if (far := arrays.get("depth")) is not None:
        masks.append(np.isfinite(far) & (far < BACKGROUND_DEPTH))
        depth = far.astype(np.float32)
    mask = np.logical_and.reduce(masks)
    segments = np.where(mask, segments if ids is not None else 1, 0).astype(np.uint8)
    return Geometry(
        np.where(mask[..., None], normals, 0).astype(np.float32),
        np.where(mask, depth, 0).astype(np.float32),
        segments,
    )
