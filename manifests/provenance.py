"""The provenance of a published figure: command, commit, date, machine and versions."""

import importlib.metadata
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

LIBRARIES = ("numpy", "torch", "numba", "llvmlite", "bpy")


def provenance(command: str | None = None) -> dict:
    """Return {"command", "commit", "date", "machine", "versions"} of this process.

    command  as a reader would type it; None: this process's own, with paths of this machine
             shortened
    """
    return {
        "command": command or own_command(),
        "commit": commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
        "versions": versions(),
    }


def in_one_line(made_by: Mapping[str, object]) -> str:
    """Return all of a provenance as a reader sees it, on one line."""
    return " · ".join(map(readable, made_by.values()))


def readable(value: object) -> str:
    """Return a value of a provenance as a reader sees it."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {version}" for name, version in value.items())
    return str(value)


def own_command() -> str:
    """Return the command line of this process: `python -m PROGRAM ARGUMENT …`."""
    program = getattr(sys.modules.get("__main__"), "__spec__", None)
    name = program.name.removesuffix(".__main__") if program else "brdfactory"
    words = map(shorten, sys.argv[1:])
    return " ".join(
        [f"python -m {name}", *(shlex.quote(word) if " " in word else word for word in words)]
    )


def shorten(argument: str) -> str:
    """Return an argument as it is published: only the last part of a path on this machine.

    That is done for NAME=PATH too.
    """
    name, equals, path = ("", "", argument) if os.path.isabs(argument) else argument.partition("=")
    return f"{name}{equals}…/{Path(path).name}" if os.path.isabs(path) else argument


def commit() -> str:
    """Return the short hash of this checkout's commit, "none" outside a checkout.

    "0123abcd, with changes" says that Python files in it differ from that commit. Git is run in
    this file's folder, not in the caller's.
    """
    result = _git("rev-parse", "--short", "HEAD")
    if not result:
        return "none"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/*.py")
    return f"{result}, with changes" if changed else result


def _git(*arguments: str) -> str:
    """Return what git prints in this file's folder, "" where there is none or it fails."""
    try:
        done = subprocess.run(
            ["git", *arguments],
            capture_output=True,
            text=True,
            cwd=Path(__file__).parent,
            check=False,
        )
    except OSError:  # no git
        return ""
    return done.stdout.strip()


def versions() -> dict:
    """Return {library: version} of the installed libraries that figures depend on."""
    result = {}
    for name in LIBRARIES:
        try:
            result[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return result


def own_version() -> str:
    """Return the program's installed version, "from a source tree" where nothing is installed."""
    try:
        return importlib.metadata.version("brdfactory")
    except importlib.metadata.PackageNotFoundError:
        return "from a source tree"


def processor() -> str:
    """Return the processor's name and its widest vector instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    fields = dict(line.replace("\t", "").split(":", 1) for line in lines if ":" in line)
    flags = fields.get("flags", "").split()
    widest = next(
        (name for name in ("avx512f", "avx2", "sse2") if name in flags), platform.machine()
    )
    return f"{fields.get('model name', platform.machine()).strip()} ({widest})"
