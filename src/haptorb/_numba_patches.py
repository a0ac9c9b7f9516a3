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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = [
    "NEWEST",
    "call_own_copies",
    "compile_function",
    "find_version",
    "ignore_local_settings",
    "is_patched",
    "load_numba",
    "omit_unused_code",
    "remember_call_types",
]

_CALLEES = "callees"  #: folder of the code of functions that other kernels call, in their file's folder
NEWEST = (0, 68)  #: as in pyproject.toml
_PLAIN = "HAPTORB_PLAIN_NUMBA"
_TOLD = "HAPTORB_NUMBA_SETTINGS_TOLD"


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
def find_version() -> str:
    """Return the version of the installed numba, which need not be loaded for that."""
    from importlib.metadata import version

    return version("numba")


@cache
def load_numba() -> Any:
    """Import numba and apply the patches if its version allows."""
    if not is_patched(find_version()):
        numba = import_module("numba")
        ignore_local_settings()
        return numba
    _silence_lock()
    numba = import_module("numba")
    ignore_local_settings()
    _disable_gathers(numba)
    _limit_optimisation(numba)
    _postpone_linear_algebra()
    codegen = import_module("numba.core.codegen")
    call_own_copies(codegen)
    omit_unused_code(codegen)
    remember_call_types()
    return numba


def ignore_local_settings() -> None:
    """Read no `.numba_config.yaml` of the current folder.

    It may name the folder with compiled code, which numba executes, and switch compilation off; numba looks for it when
    it is imported and before each compilation. Environment variables NUMBA_... are the user's.
    """
    settings: Any = import_module("numba.core.config")
    name = getattr(settings, "_config_fname", "")
    if not name:
        return
    # safety: no-local-numba-settings
    settings._config_fname = ""
    settings.reload_config()
    if os.path.exists(name) and _TOLD not in os.environ:
        os.environ[_TOLD] = "1"  # child processes do not print it again
        print(
            f"haptorb: {name} in the current folder is not read; set environment variables NUMBA_... instead",
            file=sys.stderr,
        )


def compile_function(
    function: Callable[..., Any], folder: str, *, vectors: bool = False, brief: bool = False, exact: bool = False
) -> Any:
    """Return numba's dispatcher of `function`, with `folder` as its cache ("": none).

    vectors: vectorise its loops. brief: do not count references, and keep the interpreter lock.
    exact: operations are neither reordered nor fused.
    """
    numba = load_numba()
    patched = is_patched(numba.__version__)
    options: dict[str, Any] = {
        "nogil": not brief, "error_model": "numpy", "fastmath": False if exact else {"reassoc", "contract"},
        **(_list_options(brief) if patched else {}),
    }  # fmt: skip

    def make(folder: str, **more: bool) -> Any:
        if not patched:
            with _cache_in(numba, folder):
                return numba.njit(cache=bool(folder), **options, **more)(function)
        made = numba.njit(**options, **more)(function)
        if vectors and "NUMBA_LOOP_VECTORIZE" not in os.environ:
            _vectorize_loops(numba, made)
        if folder:
            _postpone_cache(numba, made, folder)
        return made

    compiled = make(folder)
    if patched:
        _compile_callee_apart(
            numba, compiled, lambda: make(folder and str(Path(folder) / _CALLEES), no_cpython_wrapper=True)
        )
    return compiled


def _list_options(brief: bool) -> dict[str, bool]:
    """Compiler options: kernels are not called through a C pointer, so the C entry point is left out.

    `_nrt` is numba's reference counting of arrays, half of the time of a call; each kernel must set it, or it inherits
    the value of the first kernel that calls it.
    """
    return {"no_cfunc_wrapper": True, "_nrt": not brief}


@contextmanager
def _cache_in(numba: Any, folder: str) -> Iterator[None]:
    """Within the block, new dispatchers have their cache in `folder`."""
    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder
    try:
        yield
    finally:
        numba.config.CACHE_DIR = usual


def _postpone_cache(numba: Any, compiled: Any, folder: str) -> None:
    """Open the cache of `compiled`, a dispatcher, in `folder` at its first call.

    numba checks the folder of every dispatcher by writing a file into it; most kernels are never called in a process.
    numba's own lock, which a thread may take again, is held: the folder is a setting of the whole process, and another
    thread that calls the kernel meanwhile must find its cache.
    """
    compile_uncached = compiled.compile

    def compile_cached(signature: Any) -> Any:
        with numba.core.compiler_lock.global_compiler_lock:
            if compiled.compile is compile_cached:
                with _cache_in(numba, folder):
                    compiled.enable_caching()
                compiled.compile = compile_uncached
            return compile_uncached(signature)

    compiled.compile = compile_cached


def _vectorize_loops(numba: Any, compiled: Any) -> None:
    """Compile the loops of `compiled`, a dispatcher, to vector code; other kernels are unchanged.

    Needed because `_limit_optimisation` disabled it for all kernels; numba offers the choice only for a whole process.
    """
    compile_plainly = compiled.compile

    def compile_to_vectors(signature: Any) -> Any:
        with numba.core.compiler_lock.global_compiler_lock:  # the setting is one of the whole process
            usual = numba.config.LOOP_VECTORIZE
            numba.config.LOOP_VECTORIZE = 1
            try:
                return compile_plainly(signature)
            finally:
                numba.config.LOOP_VECTORIZE = usual

    compiled.compile = compile_to_vectors


def _compile_callee_apart(numba: Any, compiled: Any, make: Callable[[], Any]) -> None:
    """Let other kernels call a second dispatcher of the function of `compiled`, which `make` creates at the first call.

    Hardly any function is called both from Python and by other kernels. The second one has no entry point for Python
    and, as each kernel contains copies of those that it calls, no machine code (`omit_unused_code`). Both took a
    quarter of a first start.

    It is compiled once for each combination of types. numba compiles a kernel anew for each constant that another
    kernel passes, and keeps what it does not need.
    """
    plain, callee = numba.types.unliteral, cache(make)

    def find(args: Any, named: Any) -> Any:
        return callee().get_call_template(tuple(map(plain, args)), {name: plain(kind) for name, kind in named.items()})

    compiled.get_call_template = find
    compiled.get_overload = lambda signature: callee().get_overload(signature)


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
        is_entry = _find_kind(self) == _ENTRY  # nobody copies it
        if self._shared_module is None and not is_entry and any(not one.is_declaration for one in module.functions):
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
# A kernel's code is either machine code, for Python, or optimised code for copies in other kernels, never both.
#
# An "environment" holds the Python objects of a function, such as its exceptions. numba writes its address into a
# variable of the function's machine code; here the variable is in the machine code of its callers.


_ENTRY, _CALLEE = "haptorb entry", "haptorb callee"  #: kinds of cached code: called from Python, by other kernels
_ENVIRONMENT = "_ZN08NumbaEnv"  #: prefix of the variables


def omit_unused_code(codegen: Any) -> None:
    """Change `codegen`, the module `numba.core.codegen`, so that functions without entry points are only optimised.

    The cache has no code for copies of the others, which took a third of the time to load a kernel.
    """
    from numba.core.environment import lookup_environment
    from numba.core.typed_passes import BaseNativeLowering

    library, generator = codegen.JITCodeLibrary, codegen.JITCPUCodegen
    lower, finish, store, load, set_environment = (
        BaseNativeLowering.run_pass, library._finalize_final_module, library.serialize_using_object_code,
        library._unserialize, generator.set_env,
    )  # fmt: skip

    def mark(self: Any, state: Any) -> bool:
        flags = state.flags
        # numba gives its own functions in Python, such as `np.empty`, an entry point for C, which nothing calls.
        if flags.no_cpython_wrapper and (state.func_id.func.__module__ or "").startswith("numba."):
            flags.no_cfunc_wrapper = True
        if flags.no_cfunc_wrapper and state.library is None:
            state.library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
            state.library.enable_object_caching()
            state.library.kind = _CALLEE if flags.no_cpython_wrapper else _ENTRY
        done: bool = lower(self, state)
        return done

    def finish_by_kind(self: Any) -> None:
        if _find_kind(self) == _CALLEE:
            self._finalize_dynamic_globals()
            self._verify_declare_only_symbols()
            self._finalized = True
            return
        finish(self)
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                known = lookup_environment(variable.name)
                if known is not None:
                    self.codegen.set_env(variable.name, known)

    def store_by_kind(self: Any) -> Any:
        kind = _find_kind(self)
        if not kind:
            return store(self)
        self._ensure_finalized()
        if kind == _CALLEE:
            return self.name, kind, self._get_module_for_linking().as_bitcode()
        module = self._final_module
        defined = [one.name for one in (*module.functions, *module.global_variables) if not one.is_declaration]
        return self.name, kind, (self._get_compiled_object(), defined)

    def load_by_kind(_: Any, generator: Any, stored: Any) -> Any:
        name, kind, code = stored
        if kind not in (_CALLEE, _ENTRY):
            return load(generator, stored)
        made = generator.create_library(name)
        made.kind = kind
        if kind == _CALLEE:
            made._shared_module, made._finalized = codegen.ll.parse_bitcode(code), True
            return made
        machine_code, defined = code
        made.enable_object_caching()
        made._set_compiled_object(machine_code)
        made._finalize_final_module()
        generator._engine._defined_symbols.update(defined)
        return made

    def set_existing(self: Any, name: str, environment: Any) -> None:
        if self._engine.is_symbol_defined(name):
            set_environment(self, name, environment)

    BaseNativeLowering.run_pass = mark
    library._finalize_final_module, library.serialize_using_object_code = finish_by_kind, store_by_kind
    library._unserialize, generator.set_env = classmethod(load_by_kind), set_existing


def _find_kind(library: Any) -> str:
    """Return the kind of the code of `library`; empty for functions that are not compiled by this package."""
    return getattr(library, "kind", "")


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
