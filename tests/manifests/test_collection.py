"""The garbage collector while a command loads its libraries."""

import gc
import sys

import pytest

from manifests.collection import hold_while_loading


@pytest.fixture(autouse=True)
def as_it_was():
    yield
    gc.unfreeze()
    gc.enable()


def test_the_collector_is_held_while_libraries_load_and_leaves_their_objects_alone(monkeypatch):
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    with hold_while_loading():
        assert not gc.isenabled()
    assert gc.isenabled() and gc.get_freeze_count() > 1000


def test_after_a_failed_import_the_collector_works_as_before(monkeypatch):
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    with pytest.raises(ImportError), hold_while_loading():
        raise ImportError("no such library")
    assert gc.isenabled() and gc.get_freeze_count() == 0


@pytest.mark.parametrize("loaded", [True, False])
def test_nothing_is_changed_if_torch_is_loaded_or_the_collector_is_off(loaded, monkeypatch):
    if loaded:
        monkeypatch.setitem(sys.modules, "torch", sys)
    else:
        monkeypatch.delitem(sys.modules, "torch", raising=False)
        gc.disable()
    with hold_while_loading():
        assert gc.isenabled() == loaded
    assert gc.isenabled() == loaded and gc.get_freeze_count() == 0
