"""The chooser: a page on one port, and for the design that is chosen a simulated servo with the console on another.

The servo starts and ends in the thread that calls `serve`, as `haptorb run` has it; a thread of its own answers the
chooser's page. Every device starts with its coils off: engage them in the console.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Self, final

from haptorb.apps.console import Console
from haptorb.apps.design.results_table import ResultsTable
from haptorb.apps.design.show.selection import BASE, Selection
from haptorb.apps.design.show.site import application
from haptorb.apps.web.browser import open_browser_at
from haptorb.apps.web.server import HOST, bind_socket, freeze_garbage, server, signals
from haptorb.design.device_changes import build_device
from haptorb.design.evaluate import find_base
from haptorb.devices.device import Device
from haptorb.errors import HaptorbError
from haptorb.runtime.servo.servo import Servo

__all__ = ["PORT", "Chooser"]

PORT = 8764  #: default; the console's, the study's and the viewer's are others
_LOOK = 0.1  #: between two looks whether to end [s]


@final
class Chooser:
    """A page at `url` that shows the designs of `table` and starts the one that is chosen.

        with Chooser(ResultsTable.of(read_results("results.sqlite"))) as chooser:
            print(chooser.url)
            chooser.serve()

    port   0 takes any free one
    Raises InputError for a port that cannot be had, or pages that are not built.
    """

    def __init__(self, table: ResultsTable, port: int = PORT) -> None:
        self._table = table
        self.selection = Selection(len(table.found))
        self._socket = bind_socket(port)
        try:
            app = application(table.describe(), self.selection)
        except BaseException:
            self._socket.close()
            raise
        self.port = int(self._socket.getsockname()[1])
        self.token: str = app.state.token
        self.origin = f"http://{HOST}:{self.port}"
        self.url = f"{self.origin}/#{self.token}"
        self._server = server(app)
        self._thread = threading.Thread(target=self._answer, name="haptorb-chooser")
        self._closed = threading.Event()

    def serve(
        self, *, open_browser: bool = False, say: Callable[[str], None] = lambda text: None, until: float | None = None
    ) -> int | None:
        """Serve until `close`, SIGINT or SIGTERM (the signal's number is returned), or for `until` seconds.

        `say` is called for every device that starts, or cannot. Signals are received only in the main thread.
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
                    row = self.selection.wait(_LOOK)
                    number = None if row is None else self._feel(row, over, say)
                    if number is not None:
                        return number
        except _End as ended:
            return ended.number
        return None

    def _feel(self, row: int, over: Callable[[], bool], say: Callable[[str], None]) -> int | None:
        """Run the device of `row` until another is wanted; the number of a signal that ended it, or None."""
        name = find_base(self._table.design).name if row == BASE else self._table.name(row)
        try:
            servo = Servo(self._build(row), record=False)
            with Console(servo, 0, framed_by=self.origin) as console, freeze_garbage(), servo:
                servo.stop()
                self.selection.set_running(servo, console.url)
                say(f"{name} runs, SIMULATED, with its coils off until they are engaged.")
                try:
                    number = console.serve(until=lambda: self.selection.pending or over())
                    servo.check_end()
                finally:
                    self.selection.set_ended()
                return number
        except HaptorbError as mistake:
            self.selection.set_refused(f"{name} does not run: {mistake}")
            say(f"{name} does not run: {mistake}")
            return None

    def _build(self, row: int) -> Device:
        """The device of `row`, with the tables that its servo needs."""
        design = self._table.design
        if row == BASE:
            device = find_base(design)
        else:
            device = build_device(design, self._table.found[row][1].values, self._table.name(row))
        compute = device.kind.part("tables")
        if compute is not None and "tables" not in vars(device):

            def report(done: int, total: int) -> None:
                self.selection.report(f"Computing its exact torque and field: {100 * done // max(total, 1)} %.")

            vars(device)["tables"] = compute(device, report)
        self.selection.report("The first start after an installation compiles code: about 15 s on two cores.")
        return device

    def _answer(self) -> None:
        asyncio.run(self._server.serve(sockets=[self._socket]))

    def close(self) -> None:
        """End `serve`; may be called from any thread, and twice."""
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
    """A signal, on its way through `with` blocks that switch the coils off."""

    def __init__(self, number: int) -> None:
        self.number = number


def _raise_end(number: int) -> None:
    raise _End(number)
