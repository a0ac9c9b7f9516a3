"""People who leave, and laboratories that join: withdraw, merge, and backups that withdrawing knows of."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.apps.cli.study.options import DatabaseArgument, NameOption
from haptorb.apps.terminal import make_progress, print_json, say, show_status, tell

__all__ = ["backup", "merge", "withdraw"]


def merge(
    databases: Annotated[list[str], typer.Argument(help="Databases to merge, two or more, of one study.")],
    into: Annotated[Path, typer.Option("--into", help="New database; it must not exist.")],
    rename: Annotated[
        list[str] | None,
        typer.Option(
            metavar="N:OLD=NEW",
            help="Rename a code of database N (1, 2, ...): 2:P01=Q01; or all of its codes: 2:*=B-*; repeatable.",
        ),
    ] = None,
    name: NameOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Merge databases of one study from several laboratories; the sources stay as they are."""
    from haptorb.apps.study.store.merge import merge_databases, read_renaming

    renamings = [read_renaming(one) for one in rename or []]
    with make_progress() as bar:
        task = bar.add_task("merging participants", total=None)
        done = merge_databases(
            databases, into, study=name, renamings=renamings,
            progress=lambda ready, total: bar.update(task, completed=ready, total=total),
        )  # fmt: skip
    for note in done.notes:
        say(f"note: {note}")
    for missing in done.missing:
        say(f"warning: {missing} is not there: its trials keep this name")
    if json:
        print_json({**vars(done), "missing": list(done.missing), "notes": list(done.notes)})
        return
    people = ", ".join(f"{count} participants of {place}" for place, count in done.people.items())
    tell(f"{done.place}: {people}; {done.trials} trials, {done.recordings} recordings")


def withdraw(
    db: DatabaseArgument,
    code: Annotated[str, typer.Argument(help="Code of the person, exactly as in the database.")],
    name: NameOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Remove without asking.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Remove a person who withdraws: answers, words, recordings; from exports, merged databases and backups too."""
    from haptorb.apps.study.store.withdraw import withdraw as remove

    if not yes and not typer.confirm(f"Remove all data of {code} for good?", err=True):
        say("nothing was removed")
        raise typer.Exit(1)
    with show_status(f"removing {code}"):
        done = remove(db, code, name)
    if json:
        print_json({key: list(value) if isinstance(value, tuple) else value for key, value in vars(done).items()})
    else:
        tell(f"{done.code} withdrew from study '{done.study}': {done.sentence}")
    for left in done.left:
        say(f"warning: not removed: {left}")


def backup(
    db: DatabaseArgument,
    into: Annotated[Path, typer.Argument(help="New file.")],
) -> None:
    """Copy a database file as it is at this moment, also while a session runs; `withdraw` knows of the copy."""
    from haptorb.apps.study.store.copies import back_up

    tell(f"backup: {back_up(db, into)}")
