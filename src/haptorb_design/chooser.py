"""Chooser: a page of designs; the chosen one runs on a simulated servo with a console of its own.

The servo starts and ends in the thread that calls `serve`, as in `haptorb run`; another thread serves the page. Every
device starts with its coils off: engage them in the console.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, Self, final

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from haptorb.devices.base import Device
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.servo import Servo
from haptorb.web.access import AccessGate, choose_token
from haptorb.web.console import Console
from haptorb.web.server import (
    PageAddress,
    bind_socket,
    freeze_garbage,
    open_browser_at,
    page_files,
    respond,
    server,
    signals,
)
from haptorb_design.evaluate import find_base
from haptorb_design.problem import build_device
from haptorb_design.results_table import ResultsTable

__all__ = ["BASE", "PORT", "Chooser", "Selection", "application"]


# --------------------------------------------------------------------------------------------------
# Selection: shared by the page server's thread and the thread that runs the servo.


BASE = -1  #: row number of the base device
_NO_ROW = -2  #: no row


@final
class Selection:
    """The requested design and the running one. Its methods may be called from any thread.

    count   number of rows
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._lock = threading.Lock()
        self._asked = threading.Event()
        self._wanted = self._row = _NO_ROW
        self._state, self._url, self._text = "none", "", ""
        self._servo: Servo | None = None

    def choose(self, row: Any) -> None:
        """Request the design in `row`, or the base device.

        InputError for an invalid row, or while another device starts. The running device's coils are switched off at
        once.
        """
        if type(row) is not int or not BASE <= row < self._count:
            raise InputError(f"a row must be a whole number from {BASE} (base device) to {self._count - 1}")
        with self._lock:
            if self._state == "starting":
                raise InputError("another design is starting; wait until it has")
            if self._servo is not None:
                self._servo.stop()
            self._wanted, self._servo = row, None
            self._row, self._state, self._url, self._text = row, "starting", "", ""
        self._asked.set()

    def stop(self) -> None:
        """Coils off, until they are engaged in the console."""
        with self._lock:
            if self._servo is not None:
                self._servo.stop()

    @property
    def pending(self) -> bool:
        """Whether another design is requested than the running one."""
        return self._asked.is_set()

    def wait(self, seconds: float) -> int | None:
        """The requested row, once; None if there is none within `seconds`."""
        if not self._asked.wait(seconds):
            return None
        with self._lock:
            self._asked.clear()
            return self._wanted

    def report(self, text: str) -> None:
        """Progress of the start of a device."""
        with self._lock:
            self._text = text

    def set_running(self, servo: Servo, url: str) -> None:
        """The requested device runs, and `url` is its console."""
        with self._lock:
            self._servo, self._state, self._url, self._text = servo, "running", url, ""

    def set_refused(self, text: str) -> None:
        """The requested device cannot run, or has ended, because of `text`."""
        with self._lock:
            self._servo, self._state, self._url, self._text = None, "refused", "", text

    def set_ended(self) -> None:
        """Record that the device has ended."""
        with self._lock:
            self._servo = None

    def describe(self) -> dict[str, Any]:
        """State for the page, as plain JSON types."""
        with self._lock:
            return {
                "state": self._state, "row": max(self._row, BASE), "base": self._row == BASE, "url": self._url,
                "text": self._text,
            }  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The chooser as an ASGI application: one page, the designs, and the selection.


_STATIC = Path(__file__).parent / "static"
_MAX_REQUEST_BYTES = 1000  #: maximum size of a request [bytes]


def application(
    designs: Mapping[str, Any], selection: Selection, where: PageAddress = PageAddress(), frames: str = ""
) -> Starlette:
    """The ASGI application in which pages choose among `designs` (plain JSON types), for those who know
    `app.state.token`.

    where   listening and public address of the page
    frames  origin of the consoles, which the page frames; empty: any port of the page's host

    Raises InputError if the page has not been built, or the environment's HAPTORB_TOKEN cannot be one.
    """
    token = choose_token()
    files = page_files(_STATIC)
    if "chooser.html" not in files:
        raise InputError(
            "the chooser's page has not been built: run `cd web && npm ci && npm run build`, or `make run`"
        )
    known = json.dumps(designs, separators=(",", ":")).encode()

    async def file(request: Request) -> Response:
        return respond(files, request.path_params.get("name", "chooser.html"))

    async def describe(request: Request) -> Response:
        return Response(known, media_type="application/json")

    async def describe_selection(request: Request) -> Response:
        return JSONResponse(selection.describe())

    async def choose(request: Request) -> Response:
        try:
            selection.choose(await _read_row(request))
        except InputError as mistake:
            return PlainTextResponse(f"{mistake}\n", status_code=409)
        return JSONResponse(selection.describe())

    async def stop(request: Request) -> Response:
        selection.stop()  # here, not in a thread of the executor: those may all be busy
        return JSONResponse(selection.describe())

    app = Starlette(
        routes=[
            Route("/", file),
            Route("/static/{name}", file),
            Route("/api/designs", describe),
            Route("/api/now", describe_selection),
            Route("/api/choose", choose, methods=["POST"]),
            Route("/api/stop", stop, methods=["POST"]),
        ],
        middleware=[
            Middleware(
                AccessGate,
                token=token,
                frames=frames or PageAddress(where.host).page_origin("*"),
                exposed=where.exposed,
                origin=where.origin,
            )
        ],
    )
    app.state.token = token
    return app


async def _read_row(request: Request) -> Any:
    """Parse a page's request; InputError for anything but a small JSON object."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MAX_REQUEST_BYTES:
            raise InputError(f"a choice must have at most {_MAX_REQUEST_BYTES} bytes")
    try:
        asked = json.loads(body)
    except (ValueError, RecursionError) as cause:
        raise InputError(f"a choice must be JSON: {cause}") from cause
    if not isinstance(asked, dict):
        raise InputError("a choice must be a JSON object, such as {'row': 3}")
    return asked.get("row")


PORT = 8764  #: default; console, study and viewer have others
_POLL_INTERVAL_S = 0.1  #: polling interval for the end [s]


@final
class Chooser:
    """A page at `url` with the designs of `table`, which starts the chosen one.

        with Chooser(ResultsTable.of(read_results("results.sqlite"))) as chooser:
            print(chooser.url)
            chooser.serve()

    port             0: any free port
    where            listening and public address; by default loopback only
    console_port     port of the consoles, one after another; 0: any free port
    console_address  public address of the consoles behind a proxy, if the page has one
    Raises InputError for a port that is not available, or pages that are not built.
    """

    def __init__(
        self,
        table: ResultsTable,
        port: int = PORT,
        *,
        where: PageAddress = PageAddress(),
        console_port: int = 0,
        console_address: str = "",
    ) -> None:
        if bool(where.address) != bool(console_address):
            raise InputError(
                "the page shows a console, which has a port and an address of its own: give --address, "
                "--console-address and --console-port together"
            )
        self._table = table
        self._console_port, self._console = console_port, PageAddress(where.host, console_address)
        self.selection = Selection(len(table.found))
        self._socket = bind_socket(port, where.host)
        try:
            app = application(table.describe(), self.selection, where, self._console.origin)
        except BaseException:
            self._socket.close()
            raise
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token
        self.origin = where.page_origin(self.port)
        self.url = f"{where.url(self.port)}#{self.token}"
        self._server = server(app)
        self._thread = threading.Thread(target=self._answer, name="haptorb-chooser")
        self._closed = threading.Event()

    def serve(
        self,
        *,
        open_browser: bool = False,
        notify: Callable[[str], None] = lambda text: None,
        until: float | None = None,
    ) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM (returns the signal's number), or for `until` seconds.

        `notify` is called for every device that starts or fails to. Signals are received in the main thread only.
        """
        end = float("inf") if until is None else monotonic() + until
        self._thread.start()
        if open_browser:
            threading.Thread(target=open_browser_at, args=(self.url,), daemon=True).start()

        def over() -> bool:
            return self._closed.is_set() or monotonic() > end

        try:
            with signals(_raise_end):
                while not over():
                    row = self.selection.wait(_POLL_INTERVAL_S)
                    number = None if row is None else self._feel(row, over, notify)
                    if number is not None:
                        return number
        except _End as ended:
            return ended.number
        return None

    def _feel(self, row: int, over: Callable[[], bool], notify: Callable[[str], None]) -> int | None:
        """Run the device of `row` until another is requested; the number of a signal that ended it, or None."""
        name = find_base(self._table.design).name if row == BASE else self._table.name(row)
        try:
            servo = Servo(self._build(row), record=False)
            console = Console(servo, self._console_port, framed_by=self.origin, where=self._console)
            servo.stop()  # before the start: a stop takes effect from the first tick
            with console, freeze_garbage(), servo:
                self.selection.set_running(servo, console.url)
                notify(f"{name} runs, SIMULATED, with its coils off until they are engaged.")
                try:
                    number = console.serve(until=lambda: self.selection.pending or over())
                    servo.check_end()
                finally:
                    self.selection.set_ended()
                return number
        except HaptorbError as mistake:
            self.selection.set_refused(f"{name} does not run: {mistake}")
            notify(f"{name} does not run: {mistake}")
            return None

    def _build(self, row: int) -> Device:
        """Build the device of `row`, with the tables that its servo needs."""
        design = self._table.design
        if row == BASE:
            device = find_base(design)
        else:
            device = build_device(design, self._table.found[row][1].values, self._table.name(row), override=True)
        if not device.is_prepared:

            def report(done: int, total: int) -> None:
                self.selection.report(f"Computing its exact torque and field: {100 * done // max(total, 1)} %.")

            device.prepare(report)
        self.selection.report("The first start after an installation compiles code: about 15 s on two cores.")
        return device

    def _answer(self) -> None:
        asyncio.run(self._server.serve(sockets=[self._socket]))

    def close(self) -> None:
        """End `serve`; may be called from any thread, repeatedly."""
        self._closed.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()


class _End(BaseException):
    """A signal as an exception, so that `with` blocks switch the coils off."""

    def __init__(self, number: int) -> None:
        self.number = number


def _raise_end(number: int) -> None:
    raise _End(number)
