"""The CUDA kernels as far as a machine without a GPU can show: they equal the CPU engine when
interpreted, and they compile.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

triton = pytest.importorskip("triton", reason="triton is not installed (extra cuda)")


def test_interpreted_kernels_equal_the_cpu_engine(root):
    """In a process of its own: triton reads TRITON_INTERPRET when it is first imported."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        str(Path(__file__).with_name("interpreted_triton.py")),
    ]
    done = subprocess.run(
        command,
        env=os.environ | {"TRITON_INTERPRET": "1"},
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and "skipped" not in done.stdout, done.stdout


@pytest.mark.parametrize("camera", ["distant", "general"])
@pytest.mark.parametrize("kernel", ["forward", "backward_pixels", "backward_lights"])
@pytest.mark.filterwarnings("ignore:TRITON_DEFAULT_FP_FUSION")
def test_kernels_compile_for_compute_capability_9(camera, kernel, tmp_path, monkeypatch):
    """Triton brings its own assembler, so machine code for an H100 or H200 can be made without
    one.
    """
    import importlib

    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    module = importlib.import_module(f"learn.engines.triton_{camera}")
    function = getattr(module, kernel)
    tile = {"PIXELS": module.PIXELS, "LIGHTS": module.LIGHTS}
    kinds = dict.fromkeys(tile, "constexpr") | dict.fromkeys(("pixels", "lights", "split"), "i32")
    kinds |= {"offsets": "*i32"}
    signature = {name: kinds.get(name, "*fp32") for name in function.arg_names}
    constants = {(i,): tile[name] for i, name in enumerate(function.arg_names) if name in tile}
    compiled = triton.compile(
        ASTSource(function, signature, constants), target=GPUTarget("cuda", 90, 32)
    )
    assert len(compiled.asm["cubin"]) > 10_000
