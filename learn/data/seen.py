"""What a training run drew from, as hashes of its shapes, materials and light maps.

Weights and checkpoints carry these lists, so that an evaluation can refuse data that they saw.

shape     hash of the mesh (manifests.schema.ShapeEntry.hash): the same in every view and size
material  SHA-256 of the label, 108 little-endian float32
light     SHA-256 of the map at rotation 0, (64, 128, 3) little-endian float32

What a run makes itself is not listed, because no data set holds it: computed lights, and labels
that are mixtures, scaled or principled (learn.data.label_augmentation). Mixtures and scaled labels
come from listed materials alone.

Lists that a training did not write, but that were put together later from what is known of it, say
so and why.

Of each hash the first DIGITS hexadecimal digits are kept. A copy of a map that was rotated, scaled
or resampled has another hash and is not recognised.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from manifests.errors import InputError
from manifests.reading import decode

if TYPE_CHECKING:
    from learn.data.data_split import DataSplit

DIGITS = 16
MOST = 20_000  # hashes of a kind in a file's metadata: 400 KB
LONGEST_REASON = 2_000  # characters
KEY = "seen"  # in the metadata
KINDS = ("shapes", "materials", "lights")
REMEDY = "put a copy of the file back, or train again"

Digits = Annotated[str, Meta(pattern=f"^[0-9a-f]{{{DIGITS}}}$", max_length=DIGITS)]
Reason = Annotated[str, Meta(min_length=1, max_length=LONGEST_REASON)]
Hashes = Annotated[tuple[Digits, ...], Meta(max_length=MOST)]


class Seen(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sorted hashes of what training and validation drew from.

    complete       False where the lists lack something: the run began from weights without such
                   lists, or there were more than MOST hashes of a kind, of which the smallest MOST
                   are kept
    reconstructed  why the lists, or a part of them, were put together after the training, and from
                   what; not in the file where the training wrote them itself
    """

    version: Literal[1] = 1
    shapes: Hashes = ()
    materials: Hashes = ()
    lights: Hashes = ()
    complete: bool = True
    reconstructed: Reason | UnsetType = UNSET

    def join(self, other: Seen | None) -> Seen:
        """Return the lists of both; None stands for weights that do not say what they saw."""
        if other is None:
            return msgspec.structs.replace(self, complete=False)
        reasons = dict.fromkeys(
            each.reconstructed for each in (self, other) if each.reconstructed is not UNSET
        )
        return make_seen(
            {kind: (*getattr(self, kind), *getattr(other, kind)) for kind in KINDS},
            self.complete and other.complete,
            "; ".join(map(str, reasons))[:LONGEST_REASON],
        )


class _Stored(Struct, frozen=True, forbid_unknown_fields=True):
    """The lists as they are written; digest: `_digest` of them."""

    lists: Seen
    digest: str


def make_seen(
    hashes: Mapping[str, Iterable[str]], complete: bool = True, reconstructed: str = ""
) -> Seen:
    """Return Seen of {kind: hashes of at least DIGITS digits}, in any order.

    reconstructed  as of Seen; "": the training wrote the lists
    """
    shapes, materials, lights = (
        tuple(sorted({each[:DIGITS] for each in hashes[kind]})) for kind in KINDS
    )
    return Seen(
        shapes=shapes[:MOST],
        materials=materials[:MOST],
        lights=lights[:MOST],
        complete=complete and max(map(len, (shapes, materials, lights))) <= MOST,
        reconstructed=reconstructed or UNSET,
    )


def label_hash(label: np.ndarray) -> str:
    """Return the hash of a material's label (108,)."""
    return hashlib.sha256(np.ascontiguousarray(label, "<f4").tobytes()).hexdigest()[:DIGITS]


def map_hash(L: np.ndarray) -> str:
    """Return the hash of a light map (64, 128, 3)."""
    return hashlib.sha256(np.ascontiguousarray(L, "<f4").tobytes()).hexdigest()[:DIGITS]


def seen_in_splits(data_splits: Iterable[DataSplit], source: str) -> Seen:
    """Return what examples of these splits are drawn from.

    source  of the examples, as learn.data.settings.Data: "relit", "pictures" or "mix"
    """
    hashes: dict[str, set[str]] = {kind: set() for kind in KINDS}
    for data_split in data_splits:
        # every source takes targets from the labels, and the network its ranges
        hashes["materials"] |= set(map(label_hash, data_split.labels.values()))
        rendered = data_split.rendered_split if source != "relit" else None
        if not rendered or (source == "mix" and data_split.side == "train"):
            views = data_split.geometry.views
            hashes["shapes"] |= {views[v].shape_hash for v in data_split.views}
            hashes["lights"] |= {*map(map_hash, data_split.maps), *data_split.copies}
        if rendered:
            for kind, of_kind in names_in_pictures(data_split).items():
                hashes[kind] |= of_kind.keys()
    return make_seen(hashes)


def names_in_pictures(data_split: DataSplit) -> dict[str, dict[str, str]]:
    """Return {kind: {hash: name}} of a split's pictures by Cycles; empty without them."""
    rendered = data_split.rendered_split
    if not rendered:
        return {kind: {} for kind in KINDS}
    records, chosen = rendered.records, rendered.chosen
    return {
        "shapes": {record.shape_hash[:DIGITS]: record.shape for record in chosen},
        "materials": {
            label_hash(records.label(name)): name
            for name in sorted({name for record in chosen for name in record.materials})
        },
        "lights": {
            map_hash(records.light(name)): name
            for name in sorted({record.light for record in chosen})
        },
    }


def encode_seen(seen: Seen) -> str:
    """Return the lists as text for a file's metadata."""
    return msgspec.json.encode(_Stored(seen, _digest(seen))).decode()


def read_seen(metadata: Mapping[str, str], where: object) -> Seen | None:
    """Return the lists in a file's metadata; None where it has none.

    where   names the file in an InputError
    Raises  InputError: malformed lists, or others than were written
    """
    text = metadata.get(KEY)
    if text is None:
        return None
    place = f"{where}: {KEY} in the metadata"
    stored = decode(text.encode(), _Stored, place)
    if stored.digest != _digest(stored.lists):
        raise InputError(place, "the lists that were written", "others", REMEDY)
    return stored.lists


def _digest(seen: Seen) -> str:
    return hashlib.sha256(b"brdfactory seen\n" + msgspec.json.encode(seen)).hexdigest()[:DIGITS]
