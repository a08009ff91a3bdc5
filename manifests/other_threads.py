"""Threads that numpy, scipy and torch start, and what they do while they wait.

Such threads spin for milliseconds while they wait for more work, and the caller spins while it
waits for them. On few cores, or beside other programs, they take processor time from the next step.
The functions here set environment variables that these libraries read when they are loaded: call
them before numpy or torch is imported. What the user has set stays.
"""

import os


def use_one_blas_thread() -> None:
    """Let OpenBLAS, of which numpy and scipy each have a copy, compute on the calling thread.

    Nothing here has products of matrices large enough to be shared, but scipy's L-BFGS-B adds and
    multiplies vectors of many thousand numbers. With a second thread, and beside other programs,
    nearly half of an edit's processor time was OpenBLAS's spinning (docs/log.md, 2026-11-25).
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def let_waiting_threads_sleep() -> None:
    """Use one OpenBLAS thread, and let torch's threads that wait for work sleep, not spin.

    An edit's parallel steps are short and many.
    """
    use_one_blas_thread()
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
