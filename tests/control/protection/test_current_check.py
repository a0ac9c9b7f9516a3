"""Measured currents against applied voltages: faulty sensors are detected, tolerances are not."""

import numpy as np
import pytest

from haptorb.control.drive import check_currents
from haptorb.control.guard import make_coils
from haptorb.control.missed_deadlines import make_clock

from .protected import DT, OMNI

COLD = np.full(3, 298.15)
STILL = np.zeros(3)


class Coil:
    """Three coils that follow their voltages, with the resistance and inductance that they really have."""

    def __init__(self, resistance=1.0, inductance=1.0, voltage=1.0):
        self.R = resistance * OMNI.coils.resistance_at(COLD)
        self.L = inductance * OMNI.coils.inductance
        self.V = voltage * OMNI.supply.voltage
        self.i = np.zeros(3)

    def advance(self, duties, dt, emf=STILL):
        end = (duties * self.V - emf) / self.R
        self.i = end + (self.i - end) * np.exp(-self.R * dt / self.L)
        return self.i.copy()


class Check:
    """Readings put into the records of three cold coils, and the kernel that the protection of currents asks."""

    def __init__(self):
        self.clock, self.coils = make_clock(DT), make_coils(OMNI)

    def agrees(self, duties, measured, *, emf=STILL, age=0.0, elapsed=DT, restart=False):
        """Whether `measured` currents, `age` [s] old, match the `duties` of the time `elapsed` [s]."""
        self.clock["elapsed"], self.clock["restart"] = elapsed, restart
        self.coils["applied"], self.coils["current"], self.coils["emf"] = duties, measured, emf
        self.coils["winding"] = COLD
        return check_currents(self.clock[0], self.coils, age)


def ticks_until_found(lie, coil=None, duties=lambda n: np.array([0.4, -0.2, 0.1]), ticks=2000, start=100, age=0.0):
    """Ticks from the `lie`'s beginning until the check says no; None: never."""
    coil, check = coil or Coil(), Check()
    applied, before = np.zeros(3), np.zeros(3)
    for n in range(ticks):
        now = coil.advance(applied, DT)
        told = before if age else now
        before = now
        measured = lie(told.copy()) if n >= start else told
        if not check.agrees(applied, measured, age=age):
            return n - start
        applied = duties(n)
    return None


def one(change):
    def lie(i):
        i[0] = change(i[0])
        return i

    return lie


@pytest.mark.parametrize(
    "change",
    [lambda i: 0.0, lambda i: 0.1 * i, lambda i: 10.0 * i, lambda i: -i, lambda i: i + 3.0, lambda i: i - 3.0],
    ids=["zero", "tenth", "tenfold", "reversed", "3 A more", "3 A less"],
)
@pytest.mark.parametrize("start", [0, 700])
def test_a_sensor_that_lies_is_found_within_50_ms(change, start):
    assert ticks_until_found(one(change), start=start) <= 50


def test_current_in_a_coil_that_was_told_to_have_none_is_found():
    assert ticks_until_found(one(lambda i: 19.0), duties=lambda n: np.zeros(3)) <= 50


def test_a_sensor_that_reads_three_quarters_is_found_by_the_resistance_that_it_makes():
    assert ticks_until_found(lambda i: 0.7 * i, duties=lambda n: np.full(3, 0.15), ticks=20000) is not None


@pytest.mark.parametrize("age", [0.0, DT])
@pytest.mark.parametrize(
    ("coil", "gain", "offset"),
    [
        (Coil(), 1.0, 0.0),
        (Coil(resistance=1.08, inductance=1.3, voltage=0.95), 1.02, 0.1),
        (Coil(resistance=0.92, inductance=0.7, voltage=1.05), 0.98, -0.1),
    ],
    ids=["as in the file", "weaker", "stronger"],
)
def test_tolerances_and_delays_are_no_fault(coil, gain, offset, age):
    random = np.random.default_rng(1)
    steps = random.uniform(-0.6, 0.6, (40, 3))

    def duties(n):  # as a world would: waves, and steps at the slew limit
        turn = 2 * np.pi * np.array([3.0, 17.0, 60.0]) * n * DT
        return np.clip(0.3 * np.sin(turn) + 0.5 * steps[n // 100], -1, 1)

    noise = random.normal(0, 0.004, (4000, 3))
    counter = iter(noise)
    assert ticks_until_found(lambda i: gain * i + offset + next(counter), coil, duties, 4000, 0, age) is None


@pytest.mark.parametrize("hertz", [40.0, 90.0, 140.0, 250.0])
@pytest.mark.parametrize("change", [lambda i: 0.0, lambda i: 0.1 * i, lambda i: -i], ids=["zero", "tenth", "reversed"])
def test_a_sensor_that_lies_about_an_alternating_current_is_found_within_50_ms(change, hertz):
    found = ticks_until_found(one(change), duties=lambda n: 0.7 * np.sin(2 * np.pi * hertz * n * DT) * np.ones(3))
    assert found is not None
    assert found <= 50


@pytest.mark.parametrize("late", [0.1, 0.3])
def test_alternating_currents_read_a_little_late_are_no_fault(late):
    last = np.zeros(3)

    def delay(i):
        nonlocal last
        read, last = i + late * (last - i), i
        return read

    assert ticks_until_found(delay, Coil(1.08, 1.3, 0.95), lambda n: np.full(3, 0.9 * (-1.0) ** n), 2000, 0) is None


def test_a_moving_mover_induces_and_is_no_fault():
    coil, check = Coil(), Check()
    emf = np.array([6.0, 0.0, 0.0])  # half of the supply: far beyond any tool
    for _ in range(300):
        measured = coil.advance(np.zeros(3), DT, emf)
        plausible = check.agrees(np.zeros(3), measured, emf=emf)
    assert plausible


def test_a_silence_begins_anew():
    coil, check = Coil(), Check()
    duties = np.array([0.5, 0.0, 0.0])
    for _ in range(100):
        assert check.agrees(duties, coil.advance(duties, DT))
    # the device's watchdog switched off meanwhile
    assert check.agrees(duties, np.zeros(3), elapsed=0.03, restart=True)
    coil.i[:] = 0.0
    for _ in range(100):
        assert check.agrees(duties, coil.advance(duties, DT))
