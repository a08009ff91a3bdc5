"""Masks of a photograph's regions: finds, merges and checks them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter

from learn.data import photographs
from manifests.errors import InputError

RIM = 3  # pixels without a label that hand-drawn regions may leave along the mask's edge
# sum of masks above which they lie over one another: those that meet sum to 1, rounded
OVERLAPPING = 1.02


def find_mask_beside(path: Path, folder: Path | None = None) -> Path | None:
    """Return the mask file of a picture, None where there is none.

    It is NAME.mask.png beside the picture; of a folder of masks, its NAME.mask.png or NAME.png.
    """
    path = Path(path)
    # "." and "/" have no name that another could replace
    candidates = [path.with_name(f"{path.stem}.mask.png")] if path.name else []
    if folder is not None:
        candidates = [Path(folder) / f"{path.stem}{ending}" for ending in (".mask.png", ".png")]
    return next(
        (
            file
            for file in candidates
            if file.is_file() and not (path.is_file() and file.samefile(path))
        ),
        None,
    )


def read_region_masks(
    masks: Sequence[Path], size: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return coverage (H, W) and regions (H, W) uint8 of one mask per region.

    masks   files; where two overlap the later one counts
    size    height and width of the picture
    Raises  InputError: an unusable mask, a region of too few pixels

    Where soft masks meet, their shares of a pixel add up: no background is between them. Where one
    lies over another, and along an edge that they have in common, the larger share counts.
    """
    each = np.stack([photographs.read_mask(mask, size) for mask in masks])
    total = each.sum(0)
    meeting = maximum_filter(total, 2 * RIM + 1) <= OVERLAPPING
    coverage = np.where(meeting, total.clip(0, 1), each.max(0))
    labels = np.where(coverage >= 0.5, each.argmax(0) + 1, 0).astype(np.uint8)
    for number, one in enumerate(each, 1):
        labels[one >= 0.5] = number
    for number, mask in enumerate(masks, 1):
        require_pixels(labels, number, mask)
    return coverage, labels


def remove_unlabelled(coverage: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return coverage with 0 where the object is in no region, except for a rim of RIM pixels.

    coverage (H, W) in [0, 1]; labels (H, W) 1 … S, 0 in no region
    """
    inside = coverage >= 0.5
    outside = inside & (labels == 0)
    if outside.any():
        outside &= distance_transform_edt(labels == 0) > RIM
        # a soft edge belongs to what it is the edge of
        index = distance_transform_edt(~inside, return_distances=False, return_indices=True)
        coverage = np.where(outside[tuple(index)], 0, coverage).astype(np.float32)
    return coverage


def require_pixels(labels: np.ndarray, count: int, where: object) -> None:
    """Raise InputError if one of the regions 1 … count has too few pixels.

    labels (H, W) 1 … S, 0 in no region; where: what the error names
    """
    for number in range(1, int(count) + 1):
        if (result := int((labels == number).sum())) < photographs.LEAST_PIXELS:
            rule = f"{photographs.LEAST_PIXELS} pixels or more in region {number}"
            raise InputError(
                where,
                rule,
                str(result),
                "regions must lie inside the mask, and not under one another",
            )
