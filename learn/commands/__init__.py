"""The commands of `python -m learn`: one module each, and the options that they share."""


def prepare() -> None:
    """Keep freed memory for the next step, and linear algebra on one thread.

    It is called before a command runs, not for --help.
    """
    from manifests.allocator import keep_freed
    from manifests.other_threads import use_one_blas_thread

    keep_freed()
    use_one_blas_thread()
