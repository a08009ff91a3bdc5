"""Lines that are read from their files when they are asked for: their order, changes, memory."""

import random
import tracemalloc

import numpy as np
import pytest

from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.placed_lines import PlacedLines
from manifests.store import Store


@pytest.fixture
def store(tmp_path, a_record):
    """A data set of 3,000 records in three files, in no order; every third is for testing."""
    files = [Lines(tmp_path / "records" / f"worker-{k:02d}.jsonl") for k in range(3)]
    numbers = list(range(3000))
    random.Random(1).shuffle(numbers)
    for k in numbers:
        split = "train" if k % 3 else "test"
        files[k % 7 % 3].append(a_record(f"{k:024x}", seed=k, split=split))
    for file in files:
        file.close()
    return Store(tmp_path)


def test_lines_come_in_the_order_of_their_ids(store):
    lines = PlacedLines(store)
    expected = sorted(store.records(), key=lambda record: record.id)
    assert list(lines) == expected and len(lines) == 3000
    assert lines[17] == expected[17] and lines[-1] == expected[-1]
    assert list(lines[1000:1010]) == expected[1000:1010]
    is_even = np.arange(3000) % 2 == 0
    assert list(lines.select(is_even)[3:5]) == expected[6:10:2]


def test_lines_that_are_not_kept_are_left_out(store):
    watched = []
    lines = PlacedLines(store, keep=lambda record: record.split == "test", watch=watched.append)
    assert [record.seed for record in lines] == list(range(0, 3000, 3))
    assert sorted(record.seed for record in watched) == list(range(0, 3000, 3))


def test_lines_of_one_id_stay_in_the_order_of_the_files(store, a_record):
    file = Lines(store.folder / "records" / "worker-09.jsonl")
    file.append(a_record(f"{5:024x}", seed=9999))
    file.close()
    assert [record.seed for record in PlacedLines(store)[4:8]] == [4, 5, 9999, 6]


def test_a_line_that_was_added_later_does_not_matter_and_one_that_changed_is_refused(
    store, a_record
):
    lines = PlacedLines(store)
    path = store.record_files()[0]
    added = Lines(path)
    added.append(a_record("f" * 24))
    added.close()
    assert len(list(lines)) == 3000
    _, *others = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(others))
    with pytest.raises(InputError, match=r"worker-00\.jsonl: expected the lines that it had"):
        list(lines)
    path.unlink()
    with pytest.raises(InputError, match="a file of lines"):
        list(lines)


def test_a_line_takes_a_few_bytes_of_memory(store):
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        lines = PlacedLines(store)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(lines) == 3000
    assert after - before < 3000 * 40 + 10_000  # objects would take 1,700 bytes each
    assert peak - before < 3000 * 150 + 50_000
