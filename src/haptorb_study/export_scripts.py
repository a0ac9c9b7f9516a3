"""Scripts beside the data that read an export, in Python with pandas and in R without packages."""

from __future__ import annotations

import json
from pathlib import Path

from haptorb.version import __version__
from haptorb_study.data_dictionary import FLAGS, WORDS
from haptorb_study.study_file import Study

__all__ = ["make_python_script", "make_r_script"]


def make_python_script(study: Study, table: str) -> str:
    """Python script that reads `table` beside it: NAME.csv, NAME.parquet, or a pattern of TSV files below it."""
    return (
        (_SCRIPT_FOLDER / "read_export.py.txt").read_text(encoding="utf-8").replace("@VERSION@", __version__)
        .replace("@TABLE@", _quote(table)).replace("@FLAGS@", repr(FLAGS)).replace("@WORDS@", repr(WORDS))
        .replace("@CONDITIONS@", _quote_all(study, "[", "]")).replace("@MEASURES@", repr(_list_measures(study)))
    )  # fmt: skip


def make_r_script(study: Study, table: str) -> str:
    """R script that reads `table`; a Parquet file needs the package arrow or nanoparquet."""
    return (
        (_SCRIPT_FOLDER / "read_export.R.txt").read_text(encoding="utf-8").replace("@VERSION@", __version__)
        .replace("@TABLE@", _quote(table)).replace("@FLAGS@", ", ".join(map(_quote, FLAGS)))
        .replace("@WORDS@", ", ".join(map(_quote, WORDS))).replace("@CONDITIONS@", _quote_all(study, "c(", ")"))
        .replace("@MEASURES@", ", ".join(map(_quote, _list_measures(study))))
    )  # fmt: skip


_SCRIPT_FOLDER = Path(__file__).parent


def _list_measures(study: Study) -> tuple[str, ...]:
    """Columns whose means are meaningful."""
    return (
        ("answer", "seconds") if study.procedure in ("rating", "magnitude") else ("correct", "distance_mm", "seconds")
    )


def _quote(text: str) -> str:
    """String literal of both Python and R."""
    return json.dumps(text, ensure_ascii=False)


def _quote_all(study: Study, begin: str, end: str) -> str:
    return begin + ", ".join(_quote(one.name) for one in study.conditions) + end
