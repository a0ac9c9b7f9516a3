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
from haptorb.files.text_file import open_regular

__all__ = ["MOST", "write_report"]

MOST = 20  #: best designs of a report
_OURS = "# Found by design '"  #: what a device file of a report begins with


def write_report(
    results: str | Path,
    output: str | Path,
    report: Callable[[str, int, int], None] = lambda text, done, total: None,
    *,
    count: int = 5,
) -> list[Path]:
    """Write the report of `results`, a file or database, to the HTML file `output`; the paths of all files written.

    The `count` best designs are written beside it, as NAME.toml for `haptorb run`; all files or none. `report` is
    called with what is done now, how many steps were done, and of how many.

    Raises RecordingError for results that cannot be read, InputError for an output that cannot be written: a device
    file from elsewhere stays.
    """
    if not 1 <= count <= MOST:
        raise InputError(f"the number of best designs must be from 1 to {MOST}; got {count}")
    page = Path(output).expanduser()
    if not page.absolute().parent.is_dir():
        raise InputError(f"{page}: there is no folder {page.parent}; create it first")
    if page.is_dir():
        raise InputError(f"{page} is a folder: name a file, such as report.html")
    report("reading the results", 0, 1)
    table = ResultsTable.of(read_results(results), count)
    paths = [page, *(page.with_name(f"{table.name(one.row)}.toml") for one in table.picks)]
    for path in paths[1:]:
        _check_device_file(path)
    best = []
    for number, pick in enumerate(table.picks):
        report(f"card and drawing of {table.name(pick.row)}", number, len(table.picks) + 1)
        best.append(make_best(table, pick.row, pick.reason))
    report("writing the page", len(table.picks), len(table.picks) + 1)
    texts = [make_page(table, best), *(one.text for one in best)]
    try:
        with replace_files(paths) as parts:
            for part, text in zip(parts, texts, strict=True):
                part.write_text(text, encoding="utf-8")
    except PermissionError as cause:
        raise InputError(f"{page} and the files beside it cannot be written: {cause.strerror}") from cause
    return paths


def _check_device_file(path: Path) -> None:
    """InputError if something else than an earlier report's device file is at `path`."""
    try:
        if not path.exists():
            return
        with open_regular(path, "device file", InputError) as file:
            ours = file.read(len(_OURS.encode())) == _OURS.encode()
    except (OSError, InputError) as cause:
        raise InputError(f"{path} cannot be replaced: {cause}; choose another --output") from cause
    if not ours:
        raise InputError(f"{path} was not written by `haptorb design report`: move it, or choose another --output")
