"""The contract on disk as types: what a job asks for, what a record says, what a dataset is.

Written and read by msgspec: unknown keys and wrong types are refused with the key's path, and the JSON Schema comes from these types.
Angles are degrees here, as in every file, and the key says so. Paths are relative to the dataset's folder and stay inside it.
"""

from typing import Literal

from msgspec import Struct

VERSION = 1

Tier = Literal["direct", "shadow", "full"]
LightResolution = Literal["64x128", "full"]
Split = Literal["train", "test"]


class Camera(Struct, frozen=True, forbid_unknown_fields=True):
    """size (height, width) in pixels; fov_deg across the longer side, None: orthographic; elevation above the horizon.

    The object lies in the unit sphere; the frame's longer side spans 2 × half_extent at the object's centre.
    """

    size: tuple[int, int] = (256, 256)
    fov_deg: float | None = None
    elevation_deg: float = 20.0
    half_extent: float = 1.02


class Statistics(Struct, frozen=True, forbid_unknown_fields=True):
    """coverage: share of the frame that the object covers; mean and max of linear radiance over the mask."""

    coverage: float
    mean: float
    max: float


class Record(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One picture and all that determines it.

    id               hash of all that determines the pixels
    materials        one name a segment, in the order of segment ids 1, 2, …; labels stand in the dataset's materials.json
    rotation_texels  the light as the camera sees it is the stored 64×128 map rolled by this many columns
    image            linear Rec.709 radiance under the unit-mean light, half EXR; geometry: normals (camera frame), depth, segments
    """

    id: str
    shape: str
    shape_hash: str
    category: str
    viewpoint: int
    azimuth_deg: float
    camera: Camera
    materials: tuple[str, ...]
    light: str
    light_hash: str
    rotation_texels: int
    tier: Tier
    light_resolution: LightResolution
    samples: int
    seed: int
    image: str
    image_hash: str
    geometry: str
    geometry_hash: str
    split: Split
    statistics: Statistics
    seconds: float
