"""The kernels as machine code: compiled by numba on first use, then loaded from disk without it.

A kernel is a numba function of integers and float pointers that never fails and calls nothing. Its
machine code is stored in the user's cache folder under the hash of everything it depends on: the
sources of the kernel modules, the versions of numba and llvmlite, the processor. numba's own cache
knows only the file of the outermost function and went stale when an imported one changed. Compiling
(learn.engines.compilation) takes up to a second and says so on stderr; loading takes milliseconds
and needs llvmlite alone.

The functions are called through ctypes, which releases Python's lock: threads run them side by
side.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
import re
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from manifests.errors import InputError
from manifests.files import write_bytes
from manifests.notices import notice

if TYPE_CHECKING:
    import numpy as np

DIGEST = hashlib.sha256().digest_size
_lock = threading.Lock()
_found: dict[str, bool] = {}  # library → whether it is installed
_loaded: dict[str, tuple[int, object]] = {}  # name → (address, owner of the memory)


def _renew_lock() -> None:
    global _lock
    _lock = threading.Lock()


os.register_at_fork(after_in_child=_renew_lock)


def is_available() -> bool:
    """Whether numba, which brings llvmlite, is installed; prints a line once if it is not."""
    if "numba" not in _found:  # not functools.cache: torch.compile warns of it
        _found["numba"] = importlib.util.find_spec("numba") is not None
        if not _found["numba"]:
            notice(
                "numba is not installed; the exact sum runs in plain torch, about 100 times slower"
            )
    return _found["numba"]


def call(name: str, *arguments: int | np.ndarray | None) -> None:
    """Run a kernel, "module.function" of this folder.

    arguments  integers, C-contiguous arrays, or None for a null pointer
    """
    # where numba puts the result (None) and would put an exception
    unused = ctypes.c_void_p(), ctypes.c_void_p()
    kinds: list[type] = [ctypes.c_void_p, ctypes.c_void_p]
    values: list[int | None] = [ctypes.addressof(u) for u in unused]
    for argument in arguments:
        if isinstance(argument, int):
            kinds.append(ctypes.c_int64)
            values.append(argument)
        else:
            kinds.append(ctypes.c_void_p)
            values.append(None if argument is None else argument.ctypes.data)
    ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(_address(name))(*values)


def _address(name: str) -> int:
    if name not in _loaded:
        with _lock:
            if name not in _loaded:
                _loaded[name] = _load(name, _machine_code(name))
    return _loaded[name][0]


def _load(name: str, code: bytes) -> tuple[int, object]:
    """Address of the kernel in its machine code, and the engine that owns the memory."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    empty = llvm.parse_assembly("", context=llvm.create_context())
    # its own memory manager lays code and data side by side; LLVM's may put them over 2 GiB apart,
    # and then aborts the process
    engine = llvm.create_mcjit_compiler(empty, _target_machine(llvm), use_lmm=True)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine.get_function_address(_symbol(name)), engine


def _machine_code(name: str) -> bytes:
    """The kernel's object code, from the cache folder or compiled and stored there."""
    path = _cache_folder() / f"{name}-{_key(name.split('.')[0])}.o"
    try:
        digest, code = (stored := path.read_bytes())[:DIGEST], stored[DIGEST:]
        if hashlib.sha256(code).digest() == digest:
            return code
    except OSError:
        pass
    notice(
        f"compiling the kernel {name} for this machine, less than 1 s, once (kept in {path.parent})"
    )
    code = _compile(name)
    try:
        _write(path, hashlib.sha256(code).digest() + code)
    except (OSError, InputError) as error:
        notice(f"cannot keep it ({error}); set BRDFACTORY_CACHE to a folder that can be written")
    return code


def _compile(name: str) -> bytes:
    from learn.engines import compilation

    module_name, function_name = name.split(".")
    module = importlib.import_module(f"learn.engines.{module_name}")
    return compilation.object_code(
        getattr(module, function_name), getattr(module, function_name.upper()), _symbol(name)
    )


def _target_machine(llvm):
    features = llvm.get_host_cpu_features().flatten()
    return llvm.Target.from_default_triple().create_target_machine(
        llvm.get_host_cpu_name(), features, opt=3, reloc="pic"
    )


def _symbol(name: str) -> str:
    return "brdfactory_" + name.replace(".", "_")


def sources(module: str) -> list[str]:
    """Names of a kernel's module, of all modules of this folder that it needs, and of this one."""
    result, open_ = {"machine_code"}, [module]
    while open_:
        name = open_.pop()
        if name not in result:
            result.add(name)
            open_ += re.findall(
                r"^from learn\.engines\.(\w+) import",
                (Path(__file__).parent / f"{name}.py").read_text(),
                re.MULTILINE,
            )
    return sorted(result)


@functools.cache
def _key(module: str) -> str:
    import llvmlite.binding as llvm

    parts = [(Path(__file__).parent / f"{name}.py").read_bytes() for name in sources(module)]
    parts += [importlib.metadata.version(name).encode() for name in ("numba", "llvmlite")]
    parts += [llvm.get_host_cpu_name().encode(), llvm.get_host_cpu_features().flatten().encode()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:20]


def _cache_folder() -> Path:
    named = os.environ.get("BRDFACTORY_CACHE")
    base = (
        Path(named)
        if named
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "brdfactory"
    )
    return base / "kernels"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)
