"""A studio for the tests of one module: Blender is reset each time one is made, so that modules do
not see each other's scenes.
"""

import pytest


@pytest.fixture(scope="module")
def studio():
    """A Studio on two CPU threads; its shots do not depend on what it showed before
    (test_staleness.py).
    """
    pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
    from factory.render.studio import Studio

    return Studio("cpu", 2)
