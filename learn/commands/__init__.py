"""The commands of `python -m learn`: one module each, and the options that they share."""


def prepare() -> None:
    """Make the process keep freed memory for reuse, and run linear algebra on one thread.

    Called before a command runs, but not for --help.
    """
    from manifests.allocator import keep_freed
    from manifests.other_threads import use_one_blas_thread

    keep_freed()
    use_one_blas_thread()
