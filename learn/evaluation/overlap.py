"""Whether tested pictures show what weights saw in training: a shape, a material or a light.

An evaluation refuses such pictures, or with --allow-overlap begins its report with the sentences
that `sentences` returns.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from msgspec import UNSET

from learn.baselines import FILES
from learn.data.data_split import DataSplit
from learn.data.pairs import EditPair
from learn.data.records import Records
from learn.data.seen import DIGITS, KINDS, Seen, label_hash, map_hash, names_in_pictures
from learn.networks import weights as checkpoint
from manifests.errors import InputError

Tested = Mapping[str, Mapping[str, str]]  # {kind of learn.data.seen.KINDS: {hash: name}}
SHOWN = 3  # names in a sentence
REMEDY = "--allow-overlap to go on, which the report then says at its top, or another data set"


def shown_by_edits(records: Records, edits: Iterable[EditPair]) -> Tested:
    """Return what edits show: shapes, lights and materials of their pictures, as {hash: name}.

    The target's materials count where the pictures are of the test side, since the tables call them
    held out; elsewhere those of the input alone.
    """
    edits = list(edits)
    names = {name for edit in edits for name in edit.source.materials}
    names |= {name for edit in edits if edit.truth.split == "test" for name in edit.truth.materials}
    return {
        "shapes": {edit.source.shape_hash[:DIGITS]: edit.source.shape for edit in edits},
        "materials": {label_hash(records.label(name)): name for name in sorted(names)},
        "lights": {
            map_hash(records.light(name)): name
            for name in sorted({edit.source.light for edit in edits})
        },
    }


def shown_by_split(data_split: DataSplit) -> Tested:
    """Return what the relit and rendered pictures of a split show, as {hash: name}."""
    views, rendered = data_split.geometry.views, names_in_pictures(data_split)
    relit = {
        "shapes": {views[v].shape_hash[:DIGITS]: views[v].shape for v in data_split.views},
        "materials": {label_hash(label): name for name, label in data_split.labels.items()},
        "lights": {
            map_hash(L): data_split.map_names[i] if data_split.map_names else f"map {i}"
            for i, L in enumerate(data_split.maps)
        },
    }
    return {kind: rendered[kind] | relit[kind] for kind in KINDS}


def baseline_files(folder: Path | None) -> list[Path]:
    """Return the baselines' files that are in a folder; none for None."""
    paths = [] if folder is None else [Path(folder) / name for name in FILES.values()]
    return [path for path in paths if path.exists()]


def report_overlap(
    files: Sequence[Path], tested: Tested, data: Path, is_allowed: bool
) -> list[str]:
    """Return what a report must say at its top of its weights and their tests; print it too.

    files       of weights and priors
    data        the data set, for messages
    is_allowed  whether overlaps are reported; otherwise the first raises InputError
    """
    result: list[str] = []
    reconstructed: list[str] = []
    silent: dict[str, list[str]] = {"what": [], "all that": []}
    for path in files:
        seen = checkpoint.seen_by(path)
        if seen is None or not seen.complete:
            silent["what" if seen is None else "all that"].append(Path(path).name)
        if seen is not None and seen.reconstructed is not UNSET:
            reconstructed.append(
                f"Note: what {Path(path).name} saw was reconstructed: {seen.reconstructed}."
            )
        if seen is None or not (shared := _shared_names(seen, tested)):
            continue
        if not is_allowed:
            rule = f"shapes, materials and lights that {Path(path).name} never saw"
            raise InputError(data, rule, shared, REMEDY)
        result.append(f"Overlap: {Path(path).name} saw in training {shared}.")
    result += reconstructed
    result += [
        f"Warning: these weights do not say {words} they saw: {', '.join(names)}."
        for words, names in silent.items()
        if names
    ]
    for sentence in result:
        print(sentence, flush=True)  # before hours of measuring; errors alone go to stderr
    return result


def _shared_names(seen: Seen, tested: Tested) -> str:
    """Return how many of each kind were seen, and the first names; "" where none was."""
    parts = []
    for kind in KINDS:
        known = set(getattr(seen, kind))
        if both := sorted({name for hash_, name in tested[kind].items() if hash_ in known}):
            names = ", ".join(both[:SHOWN]) + " …" * (len(both) > SHOWN)
            parts.append(f"{len(both)} of {len(tested[kind])} {kind} ({names})")
    return ", ".join(parts)
