"""numba as the kernels use it: inlined functions, and machine code without Python's entry points.

numba makes for every function what Python needs to call it, machine code of its own, and for a C
callback the code a second time. Kernels are called from nowhere but learn.engines.machine_code,
what they are made of from nowhere but kernels: none of it is made here, and of numba's passes only
those run that these functions need. That is a third of the time of first use.
"""

import contextlib
import gc
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from numba import njit
from numba.core import codegen, compiler, registry, typed_passes, untyped_passes
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.typing.templates import Signature

# no closures, lists of Python, arrays or branches on types: numba's other passes find nothing here
PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.IRLegalization,
    typed_passes.AnnotateTypes,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)


class FewPasses(compiler.CompilerBase):
    """numba's compiler with the passes of `PASSES` alone."""

    def define_pipelines(self) -> list[PassManager]:
        passes = PassManager("kernel")
        for each in PASSES:
            passes.add_pass(each, each.__name__)
        passes.finalize()
        return [passes]


class ForThisProcessor(codegen.AOTCPUCodegen):
    """Code that is kept, with the instructions that the processor at hand has."""

    def _customize_tm_features(self) -> str:
        return self._get_host_cpu_features()


Function = TypeVar("Function", bound=Callable[..., object])
OPTIONS: dict[str, Any] = {
    "forceinline": True,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": FewPasses,
}


def inlined(function: Function) -> Function:
    """A function that kernels call, inlined wherever it is called."""
    return njit(**OPTIONS)(function)


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """Hold Python's garbage collector.

    Looking through the hundreds of thousands of objects that numba makes takes a tenth of the time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def object_code(function: Callable[..., None], signature: Signature, symbol: str) -> bytes:
    """Object file of a Python function of integers and pointers, named `symbol` in it."""
    target = registry.cpu_target
    flags = compiler.Flags()
    for each in ("no_compile", "no_cpython_wrapper", "no_cfunc_wrapper"):
        setattr(flags, each, True)
    with global_compiler_lock, without_collection():
        context = target.target_context.subtarget(
            _internal_codegen=ForThisProcessor(symbol, "host"), aot_mode=True
        )
        kinds = signature.args, signature.return_type
        made = compiler.compile_extra(
            target.typing_context, context, function, *kinds, flags, {}, pipeline_class=FewPasses
        )
        made.library.finalize()
        made.library.get_function(made.fndesc.llvm_func_name).name = symbol
        return made.library.emit_native_object()
