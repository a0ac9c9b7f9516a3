"""A compiled kernel calls its own copies of the kernels that it calls, independent of what has been loaded before.

numba puts into a kernel's machine code a copy of every kernel that it calls, optimised once more at that place, and
leaves each visible to the loader as one of many. The loader takes the first that comes, also for code that brings its
own. With sums that may be reordered two copies round differently; so the last bits of a result depended on the order in
which a process had called its kernels, and were others in the process that had compiled them. A replay must not.
"""

from __future__ import annotations

from typing import Any

__all__ = ["call_own_copies"]

_SHARED, _EXPORTED, _OWN = "linkonce_odr", "external", "internal"  #: in LLVM's words


def call_own_copies(codegen: Any) -> None:
    """Change `codegen`, the module `numba.core.codegen`, so that what is compiled from now on is complete in itself.

    What other kernels are compiled from, and the passes of the optimiser, stay as they are.
    """
    library: Any = codegen.CPUCodeLibrary
    finish = library._finalize_final_module

    def finish_own(self: Any) -> None:
        module = self._final_module
        if self._shared_module is None and any(not one.is_declaration for one in module.functions):
            # As `_get_module_for_linking` does, which would come too late.
            self._shared_module = _set_linkage(module.clone(), _EXPORTED, _SHARED)
        _set_linkage(module, _SHARED, _OWN)
        finish(self)

    library._finalize_final_module = finish_own


def _set_linkage(module: Any, before: str, after: str) -> Any:
    """`module`, in which the functions of one linkage have got another."""
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == before:
            function.linkage = after
    return module
