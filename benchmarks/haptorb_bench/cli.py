"""`haptorb bench`: this library against others and against its limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.errors import InputError
from haptorb.figure_file import check_figure_file

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(bench)


def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Benchmarks to run (default: all); with --plot a spherical motor, name or file (default: pmsm).",
        ),
    ] = None,
    effort: Annotated[float, typer.Option(help="Length of the measurements, 0 to 10; 0.1 is short and noisy.")] = 1.0,
    store: Annotated[
        Path | None, typer.Option(help="Store the result in this JSON file, which README and docs quote.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Plot the comparison of magnetics to this PNG, SVG or PDF file.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare haptorb with other libraries on the same problems, and with fixed limits, in one run."""
    import os

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if plot is not None:
        check_figure_file(plot, "--plot")
    if store is not None and not store.parent.is_dir():
        raise InputError(f"--store: the folder '{store.parent}' does not exist")
    from haptorb.terminal import make_console, print_json, show_status
    from haptorb_bench import BENCHMARKS, run_benchmarks
    from haptorb_bench.magnetics import magnetics

    if plot is not None:
        motors = [name for name in names or [] if name != "magnetics"]
        if len(motors) > 1 or (motors[:1] and motors[0] in BENCHMARKS):
            raise InputError(
                "--plot draws the comparison of magnetics: use haptorb bench magnetics [DEVICE] --plot FILE"
            )
        with show_status("magnetics") as status:
            magnetics(motors[0] if motors else "pmsm", 0.5 * effort, lambda text: status.update(text)).plot(plot)
        return
    command = " ".join(["haptorb bench", *(names or []), *([f"--effort {effort:g}"] if effort != 1.0 else [])])
    with show_status("compiling") as status:
        found = run_benchmarks(
            names or BENCHMARKS, effort, command, lambda name, what: status.update(f"{name}: {what}")
        )
    if store is not None:
        found.store(store)
    if json:
        print_json(found.numbers())
    else:
        found.show(make_console())
