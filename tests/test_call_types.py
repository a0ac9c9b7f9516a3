"""Cached argument types of an operation are those that numba infers."""

import math
import operator
from itertools import product

import pytest

from haptorb.compiled import load_compiler

TWO = (operator.add, operator.mul, operator.truediv, operator.lt, operator.eq, operator.getitem, operator.iadd,
       math.atan2, max)  # fmt: skip
ONE = (operator.neg, operator.not_, math.sqrt, abs, len)


@pytest.mark.parametrize("operation", TWO + ONE, ids=lambda operation: operation.__name__)
def test_first_and_later_answers_are_numba_s(operation):
    load_compiler()
    from numba import types
    from numba.core.errors import NumbaError
    from numba.core.registry import cpu_target
    from numba.core.types.functions import BaseFunction

    context = cpu_target.typing_context
    context.refresh()
    function = context.resolve_value_type(operation)
    kinds = (types.float64, types.int64, types.boolean, types.IntegerLiteral(3), types.float64[::1], types.float64[:],
             types.float64[:, ::1], types.unicode_type)  # fmt: skip

    def find(how, args):
        try:
            found = how(function, context, args, {})
        except (NumbaError, AttributeError):  # the latter: numba of what nobody adds in place
            return None
        return found, function.get_impl_key(found)

    found = 0
    for args in product(kinds, repeat=2 if operation in TWO else 1):
        expected = find(BaseFunction.get_call_type.__wrapped__, args)
        for _ in range(2):
            answer = find(BaseFunction.get_call_type, args)
            assert (answer and answer[0]) == (expected and expected[0])
        found += answer is not None
    assert found
