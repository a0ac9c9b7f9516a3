"""Objects pickled together with their code."""

from __future__ import annotations

import pickle
import traceback
from types import ModuleType

import pytest

from haptorb.own_code import pickle_with_code

CODE = "def divide(x):\n    def inner():\n        return 1 / x\n    return inner()\n"


def test_an_error_in_code_that_was_pickled_names_its_file_and_line() -> None:
    module = ModuleType("not_importable")
    exec(compile(CODE, "/somewhere/own.py", "exec"), module.__dict__)
    divide = pickle.loads(pickle_with_code(module.divide))
    assert divide(4) == 0.25
    with pytest.raises(ZeroDivisionError) as caught:
        divide(0)
    frames = traceback.extract_tb(caught.value.__traceback__)
    assert [(frame.filename, frame.lineno) for frame in frames[1:]] == [
        ("/somewhere/own.py", 4),
        ("/somewhere/own.py", 3),
    ]
