"""Python's garbage collector, held while a command loads its libraries.

torch and scipy make 200,000 objects when they are imported, and nearly all of them live until the
process ends. The collector looks through them several times meanwhile, again and again while the
command works, and once more at its end.
"""

import contextlib
import gc
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def hold_while_loading() -> Iterator[None]:
    """Hold the collector in the block, and let it never look at what exists at the block's end.

    This is for a command's imports. Where torch is loaded already, as in tests that run commands in
    their own process, nothing changes: objects that come and go must be looked at.
    """
    if "torch" in sys.modules or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        gc.enable()
