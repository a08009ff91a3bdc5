"""Write into the committed weights what they saw in training, where the training did not.

`joint-compact` was trained before weights held such lists. They are put together here from what is
known of its run, and say that they were; `general-compact` and `general-two-encoders` began with
these weights, so that their lists lack nothing once they hold these. No tensor changes.

python docs/list_what_weights_saw.py OUT          # copies of the three files, with lists
python docs/list_what_weights_saw.py OUT --check  # whether the committed files hold them already
"""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from factory.lights import load as load_light
from factory.shapes.catalogue import load as load_shape
from learn.data import sources
from learn.data.light_copies import KnownLights
from learn.data.seen import Seen, label_hash, make_seen, map_hash
from learn.data.settings import Data, decode_run
from learn.networks import built_in_weights, tensor_file, weights
from learn.networks.seen_lists import write_lists
from manifests import JOBS, measured_lights
from manifests.progress import tqdm
from manifests.reading import read
from manifests.splits import shape_roles

FIRST = "joint-compact"
BEGAN_WITH_IT = ("general-compact", "general-two-encoders")
JOB = "geometry"
REASON = (
    "the training of joint-compact wrote no lists. Shapes follow from the job geometry, whose split"
    " has exactly the numbers of shapes that the card of the weights has, and materials from the"
    " built-in ones. Its run names the nine light maps that it held out; that the other seventeen"
    " are the rest of the 26 measured maps is probable, not certain"
)


def shapes() -> Iterable[str]:
    """Yield the names of the shapes of the job, such as chair:17."""
    for text in read(JOBS / f"{JOB}.json", dict)["shapes"]:
        family, _, numbers = text.partition(":")
        first, _, last = numbers.partition("-")
        yield from (f"{family}:{number}" for number in range(int(first), int(last) + 1))


def shape_hashes(names: Iterable[str]) -> dict[str, str]:
    """Return {name: hash} of those shapes that training and validation drew from.

    names  of all shapes of the data set, for the split takes duplicates to one side
    """
    hashes = {name: load_shape(name).hash for name in tqdm(list(names), unit="shape", disable=None)}
    listed = [(name, name.partition(":")[0], hash_) for name, hash_ in hashes.items()]
    roles = shape_roles(listed, "hash")
    return {name: hash_ for name, hash_ in hashes.items() if roles[name] != "test"}


def materials() -> dict[str, str]:
    """Return {name: hash} of the materials that training and validation drew from."""
    sides, _ = sources.split_materials(Data(materials="built-in"), None)
    return {
        material.name: label_hash(material.label.reshape(-1))
        for side in ("train", "validation")
        for material in sides[side]
    }


def lights(path: Path) -> dict[str, str]:
    """Return {name: hash} of the data set's maps and the measured ones that were not for tests.

    path  of the weights, whose run names the maps that it held out
    """
    with tensor_file.open_tensor_file(path) as stored:
        run = decode_run(stored.metadata["run"].encode(), path)
    measured = measured_lights.load_all()
    known = KnownLights(measured)
    own = {name: load_light(name).L64 for name in read(JOBS / f"{JOB}.json", dict)["lights"]}
    maps = measured | {name: L for name, L in own.items() if known.copy_of(L) is not None}
    return {
        name: map_hash(L)
        for name, L in maps.items()
        if (name if name in measured else known.copy_of(L)) not in run.data.test_lights
    }


def lists(names: Iterable[str] | None = None) -> Seen:
    """Return what `joint-compact` saw.

    names  of the shapes of its data set; None: of all of them, whose making takes minutes
    """
    path = built_in_weights.FOLDER / f"{FIRST}.safetensors"
    return make_seen(
        {
            "shapes": shape_hashes(shapes() if names is None else names).values(),
            "materials": materials().values(),
            "lights": lights(path).values(),
        },
        reconstructed=REASON,
    )


def lists_of_all(first: Seen) -> dict[str, Seen]:
    """Return {name: what it saw} of the three weights; first: what `joint-compact` saw.

    Nothing but the lists of `joint-compact` was missing from those of the other two.
    """
    result = {FIRST: first}
    for name in BEGAN_WITH_IT:
        own = weights.seen_by(built_in_weights.FOLDER / f"{name}.safetensors")
        if own is None:
            raise ValueError(f"{name}: expected lists of the stages that its training made")
        union = own.join(first)
        kinds = {kind: getattr(union, kind) for kind in ("shapes", "materials", "lights")}
        result[name] = make_seen(kinds, reconstructed=REASON)
    return result


def main() -> int:
    """Write or check; return 1 where a committed file does not hold its lists."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="folder for the copies; it is made")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    options = parser.parse_args()
    wrong = 0
    for name, seen in lists_of_all(lists()).items():
        path = built_in_weights.FOLDER / f"{name}.safetensors"
        numbers = f"{len(seen.shapes)} shapes, {len(seen.materials)} materials, {len(seen.lights)}"
        if options.check:
            is_there = weights.seen_by(path) == seen
            wrong += not is_there
            print(f"{name}: {numbers} light maps, {'as' if is_there else 'NOT as'} in the file")
            continue
        options.out.mkdir(parents=True, exist_ok=True)
        write_lists(path, seen, options.out / path.name)
        print(f"{name}: {numbers} light maps")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
