"""One coil, gently: up a ramp, a moment there, down again; and what its current says about coil, sensor and wiring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, sleep

import numpy as np

from haptorb.devices.device import Device
from haptorb.errors import DriverError, InputError, UnknownName
from haptorb.runtime.drivers.driver import Driver

__all__ = ["GENTLE_CURRENT", "GENTLE_DUTY", "Jog", "jog"]

GENTLE_DUTY = 0.2  #: nothing above this is gentle [1]
GENTLE_CURRENT = 5.3  #: continuous current of every coil: 17 W in 0.6 Ω [A]

_RATE = 250.0  #: of the duties [Hz]: the firmware switches off after 15 ms of silence
_RAMP = 0.4  #: of the time goes up, as much down
_ENOUGH = 0.1  #: current from which a resistance can be measured [A]
_FACTOR = 1.6  #: resistance may be off by this before something is wrong


@dataclass(frozen=True)
class Jog:
    """What was seen at the top.

    duty        what was applied there [1]
    currents    (m,) measured there [A]
    resistance  supply times duty over current [Ω]; NaN if there was too little current to tell
    verdict     sentences; empty if all is as the device file says
    """

    coil: str
    duty: float
    currents: tuple[float, ...]
    resistance: float
    verdict: tuple[str, ...]


def jog(
    device: Device,
    driver: Driver,
    coil: str,
    duty: float = 0.05,
    seconds: float = 1.0,
    current_limit: float = GENTLE_CURRENT,
    clock: Callable[[], float] = monotonic,
    wait: Callable[[float], None] = sleep,
) -> Jog:
    """Move `coil` of `device` to `duty` and back within `seconds` through `driver` (not open yet).

    Raises InputError for what is not gentle, DriverError if the current exceeds `current_limit` [A] or the device
    stops; the coils are off afterwards in any case.
    """
    names = device.coils.names
    if coil not in names:
        raise UnknownName("coil", coil, names)
    if not 0.0 < abs(duty) <= GENTLE_DUTY:
        raise InputError(f"duty must be nonzero and at most {GENTLE_DUTY} in size for jogging; got {duty}")
    if not 0.2 <= seconds <= 10.0:
        raise InputError(
            f"seconds must be 0.2 to 10; got {seconds:g}", command=f"--duration must be 0.2 to 10 s; got {seconds:g}"
        )
    if not 0.0 < current_limit <= GENTLE_CURRENT:
        raise InputError(f"current_limit must be above 0 and at most {GENTLE_CURRENT} A; got {current_limit} A")
    which = names.index(coil)
    duties = np.zeros(device.channels)
    tops: list[tuple[float, np.ndarray]] = []
    with driver:
        start = clock()
        count = 0
        while (passed := clock() - start) < seconds:
            currents = driver.read(passed).currents
            if np.abs(currents).max() > current_limit:
                over = names[int(np.argmax(np.abs(currents)))]
                raise DriverError(
                    f"coil {over} carries {np.abs(currents).max():.2f} A with coil {coil} at a duty of "
                    f"{duties[which]:.3f}, above {current_limit:g} A: switched off. Check its resistance and the "
                    "shunt's value"
                )
            share = passed / seconds
            up = min(share / _RAMP, (1 - share) / _RAMP, 1.0)
            duties[which] = duty * up
            applied = driver.write(duties)
            if 0.5 <= share < 1 - _RAMP:
                tops.append((float(applied[which]), currents.copy()))
            count += 1
            wait(max(0.0, start + count / _RATE - clock()))
        driver.write(np.zeros(device.channels))
    if not tops:
        raise DriverError("the computer was too busy: no reading at the top of the ramp; try again")
    return _judge(device, which, tops)


def _judge(device: Device, which: int, tops: list[tuple[float, np.ndarray]]) -> Jog:
    duty = float(np.mean([one for one, _ in tops]))
    currents = np.mean([one for _, one in tops], axis=0)
    names = device.coils.names
    own = float(currents[which])
    expected = float(device.coils.resistance[which])
    verdict = []
    resistance = float("nan")
    strongest = int(np.argmax(np.abs(currents)))
    if duty == 0.0:
        verdict.append("the device applied no duty: it was not engaged")
    elif np.abs(currents).max() < _ENOUGH:
        verdict.append(f"no coil carries current: check the supply, the driver of coil {names[which]} and its wires")
    elif strongest != which:
        verdict.append(f"coil {names[strongest]} responded instead of {names[which]}: their wires are swapped")
    else:
        resistance = device.supply.voltage * abs(duty) / abs(own)
        if own * duty < 0:
            verdict.append(f"the current of coil {names[which]} is negative for a positive duty: swap its two wires")
        ratio = resistance / expected
        if not 1 / _FACTOR < ratio < _FACTOR:
            ten = 6 < max(ratio, 1 / ratio) < 16
            verdict.append(
                f"coil {names[which]} measures {resistance:.3g} Ω, the device file has {expected:g} Ω: "
                + ("the shunt's value is wrong by a factor of ten" if ten else "check coil and contacts")
            )
    return Jog(names[which], duty, tuple(currents.tolist()), resistance, tuple(verdict))
