"""`--serve lsl`: every row of the loop to programs of this computer that speak to the lab streaming layer."""

from __future__ import annotations

from time import monotonic, sleep
from typing import Any

from haptorb.apps.serve.lsl.row_outlet import RowOutlet
from haptorb.apps.serve.lsl.stream_description import NAME
from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.errors import InputError

__all__ = ["prepare", "serve"]

_EVERY = 0.005  #: between two looks for rows [s]
_REPORT = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Nothing stands behind `lsl`; its ports are the layer's own. Raises InputError if something does."""
    if where:
        raise InputError(f"--serve lsl takes no address, because LSL discovers streams; got '{where}'")
    remark = (
        "lsl: the layer cannot know its readers: every account of this computer, and who reaches its ports from the "
        "network, can read the rows while this server runs"
    )
    return ServerPreparation({}, f"stream '{NAME}' of the lab streaming layer", remarks=(remark,))


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`."""
    facts = {"device": served.device.name, **{key: str(value) for key, value in served.facts.items()}}
    outlet = RowOutlet(served.layout, float(served.facts["rate_hz"]), facts)
    try:
        last = float("-inf")
        while not served.over:
            outlet.send(served.read_rows())
            if monotonic() - last >= _REPORT:
                last = monotonic()
                _report(served, outlet)
            sleep(_EVERY)
        outlet.send(served.read_rows())
        _report(served, outlet)
    finally:
        outlet.close()


def _report(served: ServedDevice, outlet: RowOutlet) -> None:
    clients = [{"name": "reader", "session": 0, "rate_hz": served.facts["rate_hz"], "holds": False}]
    served.report("lsl", NAME, clients if outlet.watched else [], sent=outlet.sent)
