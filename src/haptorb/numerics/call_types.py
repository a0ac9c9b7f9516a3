"""What numba finds of an operation's types, found once.

For each `a * b` of a kernel numba tries one template of `*` after the other, for arrays, strings, lists and sets too,
until one fits. The same few operations on numbers and arrays stand in all kernels, and this search was a seventh of
the time that they took to compile.
"""

from __future__ import annotations

from functools import wraps
from typing import Any

__all__ = ["remember_call_types"]

_KNOWN = "_haptorb_call_types"  #: attribute of numba's function types: types of arguments → signature


def remember_call_types() -> None:
    """Have numba find the signature of a builtin operation on numbers and arrays once in a process.

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
