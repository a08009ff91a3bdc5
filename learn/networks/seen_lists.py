"""Lists of what weights saw, written into a file of weights after its training.

Only the file's metadata change: its tensors keep every bit, which is checked on a trial before the
file takes the place of the old one.
"""

from pathlib import Path

from learn.data.seen import KEY, Seen, encode_seen
from learn.networks import tensor_file
from learn.networks.weights import digest_of
from manifests.errors import InputError


def write_lists(path: Path, lists: Seen, out: Path) -> None:
    """Write a copy of a weights file that says it saw what `lists` name, in place of its own lists.

    out     the new file; it may be `path`
    Raises  InputError: no weights, numbers that are not finite; ValueError: the copy would have
            other tensors
    """
    path, out = Path(path), Path(out)
    with tensor_file.open_tensor_file(path) as stored:
        tensors = {name: stored.tensor(name) for name in stored.shapes}
        metadata = stored.metadata | {KEY: encode_seen(lists)}
        if "network" not in metadata:
            rule, remedy = "weights that name their network", "use weights that `learn train` wrote"
            raise InputError(path, rule, "none", remedy)
    before = digest_of(tensors)
    trial = out.with_name(f"{out.name}.trial")
    try:
        tensor_file.write(trial, tensors, metadata)
        with tensor_file.open_tensor_file(trial) as stored:
            after = digest_of({name: stored.tensor(name) for name in stored.shapes})
    finally:
        trial.unlink(missing_ok=True)
    if after != before:
        raise ValueError(f"{path}: expected tensors of digest {before}, found {after}")
    tensor_file.write(out, tensors, metadata)
