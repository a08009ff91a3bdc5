"""What every test may ask for. Tests import from the working tree and run in any order."""

import contextlib
import os
import resource
import signal
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tests.skips import unexpected

ROOT = Path(__file__).resolve().parent.parent
# a database would lie in the source tree, and a busy machine is no reason to fail
settings.register_profile(
    "tests", database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("tests")
SKIPPED = []  # (test or module, reason) of this run, in the process that reports


def kernels_folder():
    """A folder for compiled kernels that all workers and later runs share; it is ours alone."""
    folder = Path(tempfile.gettempdir()) / f"brdfactory-tests-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.stat()
    own = status.st_uid == os.getuid() and not status.st_mode & 0o022
    return folder if own else Path(tempfile.mkdtemp(prefix="brdfactory-tests-"))


# workers and commands that tests start inherit it
os.environ.setdefault("BRDFACTORY_CACHE", str(kernels_folder()))


def pytest_collection_modifyitems(items):
    """Start with the longest tests, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


def pytest_runtest_logreport(report):
    if report.skipped and not hasattr(report, "wasxfail"):
        SKIPPED.append((report.nodeid, report.longrepr[2]))


def pytest_collectreport(report):
    if report.skipped:  # importorskip at the top of a module
        SKIPPED.append((report.nodeid, report.longrepr[2]))


def pytest_sessionfinish(session, exitstatus):
    if unexpected(SKIPPED) and exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter):
    if lines := unexpected(SKIPPED):
        terminalreporter.section("skipped though tests/skips.py does not expect it", red=True)
        for line in lines:
            terminalreporter.line(line)


@pytest.fixture(autouse=True)
def strict_floating_point(request):
    """In the maths tests every overflow, underflow to NaN and division by zero of numpy is an
    error.

    Underflow itself stays allowed: exp(−800) = 0 is the right answer for a lobe's far tail.
    """
    if "shaders" in request.path.parts or request.path.name == "test_misprints.py":
        with np.errstate(divide="raise", over="raise", invalid="raise", under="ignore"):
            yield
    else:
        yield


@pytest.fixture
def rng():
    """A generator of fixed seed, fresh for each test."""
    return np.random.default_rng(20170801)


@pytest.fixture(scope="session")
def root():
    """The repository's folder."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data():
    """The folder of lent development data beside the repository; tests that need it skip without
    it.
    """
    folder = Path(os.environ.get("BRDFACTORY_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(
            f"needs the development data in {folder.name}/ beside the repository"
            " (BRDFACTORY_SHARED_DATA)"
        )
    return folder


@pytest.fixture
def small_files():
    """A context manager of a count of bytes beyond which the system refuses to write a file.

    It stands for a full disk: write() fails in either case, with EFBIG here and ENOSPC there.
    """

    @contextlib.contextmanager
    def limited(count):
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (count, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, handler)

    return limited


@pytest.fixture
def read_only():
    """A function of a folder that makes it a read-only file system until the test ends; skips where
    mounting is not allowed.
    """
    mounted = []

    def mount(folder):
        for options in (["--bind", folder, folder], ["-o", "remount,ro,bind", folder]):
            done = subprocess.run(["mount", *map(str, options)], capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"needs the right to mount a file system: {done.stderr.strip()}")
            mounted.append(folder)

    yield mount
    for folder in dict.fromkeys(mounted):
        subprocess.run(["umount", str(folder)], check=True)
