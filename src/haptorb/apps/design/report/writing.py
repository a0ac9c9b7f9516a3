"""The report of a results file: the page, and beside it the best designs as device files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from haptorb.apps.design.report.best_design import make_best
from haptorb.apps.design.report.page import make_page
from haptorb.apps.design.results_table import ResultsTable
from haptorb.design.store import read_results
from haptorb.errors import InputError
from haptorb.files.replace_together import replace_files

__all__ = ["write_report"]


def write_report(
    results: str | Path, output: str | Path, report: Callable[[str, int, int], None] = lambda text, done, total: None
) -> list[Path]:
    """Write the report of `results`, a file or database, to the HTML file `output`; the paths of all files written.

    The best designs are written beside it, as NAME.toml for `haptorb run`; all files or none. `report` is told what is
    done now, how many steps were done, and of how many.

    Raises RecordingError for results that cannot be read, InputError for an output that cannot be written.
    """
    page = Path(output).expanduser()
    if not page.absolute().parent.is_dir():
        raise InputError(f"{page}: there is no folder {page.parent}; make it first")
    if page.is_dir():
        raise InputError(f"{page} is a folder: name a file, such as report.html")
    report("reading the results", 0, 1)
    table = ResultsTable.of(read_results(results))
    best = []
    for number, pick in enumerate(table.picks):
        report(f"card and drawing of {table.name(pick.row)}", number, len(table.picks) + 1)
        best.append(make_best(table, pick.row, pick.reason))
    report("writing the page", len(table.picks), len(table.picks) + 1)
    texts = {page: make_page(table, best)} | {page.with_name(f"{one.name}.toml"): one.text for one in best}
    with replace_files(list(texts)) as parts:
        for part, text in zip(parts, texts.values(), strict=True):
            part.write_text(text, encoding="utf-8")
    return list(texts)
