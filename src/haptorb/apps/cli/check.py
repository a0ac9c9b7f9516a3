"""`haptorb check`: is this computer fit for a real-time loop?"""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(check)


def check(
    duration: Annotated[float, typer.Option(help="How many seconds to measure.")] = 30.0,
    rate: Annotated[float, typer.Option(help="Of the loop [Hz], 50 to 4000.")] = 1000.0,
    device: Annotated[str, typer.Option(help="The simulated device that is run.")] = "omni",
    alone: Annotated[bool, typer.Option("--alone", help="Without a client that drags and reads at 60 Hz.")] = False,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Is this computer fit? Runs the loop, counts what was late, and says yes or no."""
    from haptorb.apps.check import measured, shown

    result = measured(duration, rate=rate, device=device, dragging=not alone)
    if json:
        from json import dumps

        print(dumps(result.numbers(), indent=2))
    else:
        shown(result)
    if not result.fit:
        raise typer.Exit(1)
