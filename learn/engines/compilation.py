"""numba as the kernels use it: small functions that are inlined, and a kernel's machine code
without anything that only Python would call.

numba makes for every function what Python needs to call it, machine code of its own, and for a C
callback the code a second time. Kernels are called from nowhere but learn.engines.machine_code,
what they are made of from nowhere but kernels: none of it is made here, and of numba's passes only
those run that these functions need. That is a third of the time of first use.
"""

import contextlib
import gc

from numba import njit
from numba.core import codegen, compiler, registry, typed_passes, untyped_passes
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager

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
    def define_pipelines(self):
        passes = PassManager("kernel")
        for each in PASSES:
            passes.add_pass(each, each.__name__)
        passes.finalize()
        return [passes]


class ForThisProcessor(codegen.AOTCPUCodegen):
    """Code that is kept, with the instructions that the processor at hand has."""

    def _customize_tm_features(self):
        return self._get_host_cpu_features()


inlined = njit(
    forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=FewPasses
)


@contextlib.contextmanager
def without_collection():
    """Python's garbage collector waits: looking through what numba makes, hundreds of thousands of
    objects, takes a tenth of the time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def object_code(function, signature, symbol):
    """Object file of a Python function of integers and pointers, named `symbol` in it."""
    target = registry.cpu_target
    flags = compiler.Flags()
    flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
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
