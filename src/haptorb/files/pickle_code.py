"""Pickle objects together with the code that defines them, for processes that do not have its files."""

from __future__ import annotations

import io
from types import CodeType
from typing import Any

__all__ = ["make_code", "pickle_with_code"]


def pickle_with_code(what: object) -> bytes:
    """`what` pickled as cloudpickle does it; `pickle.loads` reads it.

    Code keeps the name of its file. Cloudpickle 3.1.2 and later replace it, and a message about an error in a user's
    code could then not say where the error is.
    """
    from cloudpickle import Pickler  # imported late: few commands need it

    reduce_code = Pickler.dispatch_table[CodeType]

    def keep_filename(code: CodeType) -> tuple[Any, tuple[Any, ...]]:
        _, values = reduce_code(code)
        return make_code, (code.co_filename, *values)

    class CodePickler(Pickler):  # type: ignore[misc]  # cloudpickle has no types
        dispatch_table = Pickler.dispatch_table.new_child({CodeType: keep_filename})

    file = io.BytesIO()
    CodePickler(file).dump(what)
    return file.getvalue()


def make_code(filename: str, *values: Any) -> CodeType:
    """The code object that the constructor's `values` describe, from the file `filename`."""
    return CodeType(*values).replace(co_filename=filename)
