"""`haptorb view`: play a recording in the browser, or two side by side."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.cli.run import AddressOption, HostOption
from haptorb.errors import InputError
from haptorb.terminal import notify, print_json, show_status

if TYPE_CHECKING:
    from haptorb.web.view import Viewer

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(view)


def view(
    file: Annotated[str, typer.Argument(help="Recording (MCAP), or a part of it: FILE#t=FROM,TO [s].")],
    other: Annotated[str | None, typer.Argument(help="Recording to play beside it.")] = None,
    at: Annotated[
        str | None, typer.Option(help='Time at which to begin, after the first tick, such as "12.5 s" (default: 0 s).')
    ] = None,
    offset: Annotated[str, typer.Option(help='Delay of the other recording, such as "0.5 s" or "-2 s".')] = "0 s",
    device: Annotated[
        str | None,
        typer.Option("--as", help="Device to draw, name or path of a device file (default: the recording's)."),
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the page; 0 takes any free port.")] = 8767,
    host: HostOption = "127.0.0.1",
    address: AddressOption = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    duration: Annotated[float | None, typer.Option(help="Duration [s] (default: until Ctrl-C).")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the address and the recordings as JSON.")] = False,
) -> None:
    """Play a recording, or two side by side, in the console's page. No servo runs."""
    if duration is not None and not 0 < duration < float("inf"):
        raise InputError(f"--duration must be greater than 0 s; got {duration:g} s")
    from haptorb.cli.recording import parse_time
    from haptorb.web.server import PageAddress
    from haptorb.web.view import Viewer, parse_part

    where = PageAddress(host, address)
    parts = [parse_part(one) for one in (file, other) if one is not None]
    begin, later = parse_time("--at", at), parse_time("--offset", offset) or 0.0
    with show_status("reading the recording" + "s" * (len(parts) > 1)):
        opened = Viewer(
            [part.path for part in parts], port,
            at=begin, span=parts[0].span, offset=later, device=device, where=where,
        )  # fmt: skip
    if warning := where.describe_exposure("see the recording"):
        notify(warning)
    with opened as viewer:
        number = viewer.serve(open_browser=browser, ready=lambda: _print_address(viewer, json), until=duration)
    if number is not None and number != signal.SIGINT:
        raise typer.Exit(128 + number)


def _print_address(viewer: Viewer, json: bool) -> None:
    """Print the address of the page, and notices on the recordings."""
    from haptorb.cli.recording import list_missing

    if json:
        print_json(
            {
                "url": viewer.url,
                "recordings": [
                    {
                        "file": one.name,
                        "device": one.device.name,
                        "ticks": len(one),
                        "duration_s": one.seconds,
                        "notices": one.notices,
                        **list_missing(one.recording),
                    }
                    for one in viewer.recordings
                ],
            },
            line=True,
        )
        return
    for one in viewer.recordings:
        for notice in one.notices:
            notify(f"{one.name}: {notice}")
    names = " beside ".join(f"{one.name} ({one.device.name}, {one.seconds:.1f} s)" for one in viewer.recordings)
    notify(f"Open {viewer.url} in a browser: {names}. Ctrl-C ends.")
