"""Locks where nothing can be written: whoever reads a data set needs none that is not there."""

import pytest

from manifests import lock
from manifests.errors import InputError


def test_a_folder_on_a_read_only_file_system_is_locked_without_a_file(tmp_path, read_only):
    (tmp_path / "data").mkdir()
    read_only(tmp_path / "data")
    with lock.writing(tmp_path / "data", patience=0) as descriptors:
        assert descriptors == []


def test_a_run_that_writes_elsewhere_into_a_folder_seen_read_only_here_keeps_it_locked(
    tmp_path, read_only
):
    (tmp_path / "data").mkdir()
    with lock.writing(tmp_path / "data"):
        read_only(tmp_path / "data")
        with (
            pytest.raises(InputError, match="no other run writes to"),
            lock.writing(tmp_path / "data", patience=0),
        ):
            pass
    with lock.writing(tmp_path / "data", patience=0) as descriptors:
        assert len(descriptors) == 1


def test_a_lock_that_cannot_be_made_where_others_can_write_is_an_error(tmp_path):
    (tmp_path / ".lock").mkdir()
    with pytest.raises(OSError, match=r"\.lock"), lock.writing(tmp_path, patience=0):
        pass
