"""Optional changes to numba's undocumented internals, each with its reason.

`load_numba` makes the changes, `compile_function` asks numba for a kernel. Neither touches numba's internals where the
installed version is newer than `NEWEST`, the last that the tests have run with, or where HAPTORB_PLAIN_NUMBA is 1: then
a first start takes longer, a call of a kernel some microseconds more, and a result may differ in its last bits between
processes that called other kernels before. Nothing else differs.
"""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from typing import Any

__all__ = ["NEWEST", "call_own_copies", "compile_function", "is_patched", "load_numba", "remember_call_types"]

NEWEST = (0, 68)  #: as in pyproject.toml
_PLAIN = "HAPTORB_PLAIN_NUMBA"


@cache
def is_patched(version: str) -> bool:
    """Whether numba of this `version` is changed; one line on stderr if it is too new for that."""
    if os.environ.get(_PLAIN, "") not in ("", "0"):
        return False
    if tuple(map(int, re.findall(r"\d+", version)[:2])) <= NEWEST:
        return True
    tested = ".".join(map(str, NEWEST))
    print(
        f"haptorb: numba {version} is newer than {tested}, the last that haptorb was tested with: it is used as it is, "
        f"and starts take longer; pip install 'numba<{NEWEST[0]}.{NEWEST[1] + 1}' brings the tested one",
        file=sys.stderr,
    )
    os.environ[_PLAIN] = "1"  # child processes do not print it again
    return False


@cache
def load_numba() -> Any:
    """Import numba and apply the patches if its version allows."""
    from importlib.metadata import version

    if not is_patched(version("numba")):
        return import_module("numba")
    _silence_lock()
    numba = import_module("numba")
    _disable_gathers(numba)
    _limit_optimisation(numba)
    _postpone_linear_algebra()
    call_own_copies(import_module("numba.core.codegen"))
    remember_call_types()
    return numba


def compile_function(
    function: Callable[..., Any], folder: str, *, vectors: bool = False, brief: bool = False, exact: bool = False
) -> Any:
    """Return numba's dispatcher of `function`, with `folder` as its cache ("": none).

    vectors: vectorise its loops. brief: do not count references, and keep the interpreter lock.
    exact: operations are neither reordered nor fused.
    """
    numba = load_numba()
    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder  # read at the creation of a dispatcher
    try:
        compiled = numba.njit(
            cache=bool(folder), nogil=not brief, error_model="numpy",
            fastmath=False if exact else {"reassoc", "contract"},
            **(_list_options(brief) if is_patched(numba.__version__) else {}),
        )(function)  # fmt: skip
    finally:
        numba.config.CACHE_DIR = usual
    if is_patched(numba.__version__):
        if vectors and "NUMBA_LOOP_VECTORIZE" not in os.environ:
            _vectorize_loops(numba, compiled)
        _ignore_constants(numba, compiled)
    return compiled


def _list_options(brief: bool) -> dict[str, bool]:
    """Compiler options: kernels are not called through a C pointer, so the C entry point is left out.

    `_nrt` is numba's reference counting of arrays, half of the time of a call; each kernel must set it, or it inherits
    the value of the first kernel that calls it.
    """
    return {"no_cfunc_wrapper": True, "_nrt": not brief}


def _vectorize_loops(numba: Any, compiled: Any) -> None:
    """Compile the loops of `compiled`, a dispatcher, to vector code; other kernels are unchanged.

    Needed because `_limit_optimisation` disabled it for all kernels; numba offers the choice only for a whole process.
    """
    compile_plainly = compiled.compile

    def compile_to_vectors(signature: Any) -> Any:
        usual = numba.config.LOOP_VECTORIZE
        numba.config.LOOP_VECTORIZE = 1
        try:
            return compile_plainly(signature)
        finally:
            numba.config.LOOP_VECTORIZE = usual

    compiled.compile = compile_to_vectors


def _ignore_constants(numba: Any, compiled: Any) -> None:
    """Compile `compiled`, a dispatcher, once for each combination of types, ignoring constant values.

    numba compiles it anew for each constant that another kernel passes, and keeps what it does not need.
    """
    find, plain = compiled.get_call_template, numba.types.unliteral
    compiled.get_call_template = lambda args, named: find(
        tuple(map(plain, args)), {name: plain(kind) for name, kind in named.items()}
    )


# --------------------------------------------------------------------------------------------------
# Private copies of called kernels in each compiled kernel, so that results do not depend on the order of loading.
#
# numba includes in a kernel's machine code a copy of every kernel that it calls, optimised for that call site, and
# exports each as one of many equivalent symbols. The loader takes the first one, also for code that has its own. With
# reordered sums two copies round differently; so the last bits of a result depended on the order in which a process had
# called its kernels, and differed in the process that had compiled them. A replay must be reproducible.


_SHARED, _EXPORTED, _OWN = "linkonce_odr", "external", "internal"  #: names in LLVM


def call_own_copies(codegen: Any) -> None:
    """Change `codegen`, the module `numba.core.codegen`, so that code compiled from now on is self-contained.

    What other kernels are compiled from, and the passes of the optimiser, stay as they are.
    """
    library: Any = codegen.CPUCodeLibrary
    finish = library._finalize_final_module

    def finish_own(self: Any) -> None:
        module = self._final_module
        if self._shared_module is None and any(not one.is_declaration for one in module.functions):
            # As `_get_module_for_linking` does, which would be too late.
            self._shared_module = _set_linkage(module.clone(), _EXPORTED, _SHARED)
        _set_linkage(module, _SHARED, _OWN)
        finish(self)

    library._finalize_final_module = finish_own


def _set_linkage(module: Any, before: str, after: str) -> Any:
    """Return `module` with one linkage of its functions replaced by another."""
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == before:
            function.linkage = after
    return module


# --------------------------------------------------------------------------------------------------
# Cache of numba's resolved operation types.
#
# For each `a * b` of a kernel numba tries the templates of `*` one after the other, including arrays, strings, lists
# and sets, until one matches. All kernels use the same few operations on numbers and arrays, and this search took a
# seventh of their compilation time.


_KNOWN = "_haptorb_call_types"  #: attribute of numba's function types: types of arguments → signature


def remember_call_types() -> None:
    """Cache the signature of a builtin operation on numbers and arrays for the whole process.

    Only of operations that are not compiled themselves: what is compiled depends on the kernel's own settings.
    """
    from numba.core import types
    from numba.core.types.functions import BaseFunction

    plain = (types.Number, types.Boolean, types.Array)
    find = BaseFunction.get_call_type

    @wraps(find)
    def find_once(self: Any, context: Any, args: Any, kws: Any) -> Any:
        args = tuple(args)
        if kws or not all(isinstance(kind, plain) for kind in args):
            return find(self, context, args, kws)
        known = vars(self).setdefault(_KNOWN, {})
        signature = known.get((context, args))
        if signature is None:
            signature = find(self, context, args, kws)
            if self.get_impl_key(signature) == self.typing_key:
                known[context, args] = signature
        return signature

    BaseFunction.get_call_type = find_once  # type: ignore[method-assign]


def _silence_lock() -> None:
    """Disable numba's timing of each of the ten thousands of LLVM calls, which is not needed."""
    ffi: Any = import_module("llvmlite.binding.ffi")
    register, ffi.register_lock_callback = ffi.register_lock_callback, lambda begin, end: None
    try:
        import_module("numba.core.base")  # registers at import
    finally:
        ffi.register_lock_callback = register


def _postpone_linear_algebra() -> None:
    """Assume that scipy has a BLAS instead of importing it to check, which takes half a second at every start.

    No kernel here multiplies matrices by it. One that does loads it when it is compiled.
    """
    from numba.np import linalg

    if "numba.np.arraymath" not in sys.modules:
        check, linalg.ensure_blas = linalg.ensure_blas, lambda: None
        try:
            import_module("numba.np.arraymath")
        finally:
            linalg.ensure_blas = check


def _limit_optimisation(numba: Any) -> None:
    """Disable compiler passes that are expensive and have no benefit here.

    Most kernels work on three or six numbers in turn: vector code for their loops, and what the third level adds to the
    second, took a third of the time of a first start (docs/decisions/03). Those whose loops run over every magnet of
    a motor have vector code nevertheless: `vector_kernel`. Not where the user chose otherwise.
    """
    if "NUMBA_OPT" not in os.environ:
        numba.config.OPT = type(numba.config.OPT)(2)
    if "NUMBA_LOOP_VECTORIZE" not in os.environ:
        numba.config.LOOP_VECTORIZE = 0


def _disable_gathers(numba: Any) -> None:
    """Disable gather instructions: table entries are loaded one at a time.

    The microcode against "Downfall" (Intel, 2023) makes the vector instruction for it several times slower than single
    loads, and a guest cannot see whether its host has that microcode. Not if the user chose the features already.
    """
    from llvmlite.binding import llvm_version_info
    from numba.core.codegen import get_host_cpu_features

    if numba.config.CPU_FEATURES is None and platform.machine() == "x86_64" and llvm_version_info >= (18,):
        host: str = get_host_cpu_features()
        numba.config.CPU_FEATURES = f"{host},+prefer-no-gather"
