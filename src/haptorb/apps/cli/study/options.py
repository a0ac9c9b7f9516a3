"""What several commands of a study take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["DataOption", "DatabaseArgument", "DatabaseOption", "FileArgument", "NameOption"]

FileArgument = Annotated[Path, typer.Argument(help="Study file (TOML).")]
DatabaseArgument = Annotated[str, typer.Argument(help="Database of the study: a file, or postgresql://host/name.")]
DatabaseOption = Annotated[
    str, typer.Option("--db", help="Database for the answers: a file, or postgresql://host/name.")
]
NameOption = Annotated[str | None, typer.Option("--study", help="Name of the study, if the database holds several.")]
DataOption = Annotated[
    str | None,
    typer.Option(
        "--data",
        help="Kind of data: real, pilot or simulated (default: real; if there are none, pilot, then simulated).",
    ),
]
