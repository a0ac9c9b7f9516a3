"""Duty from current: eqs. (3), (4), (6) with a coil that warms, and all possible divisions by zero."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.estimation.types import Estimate

from .protected import DT, FRESH, OMNI, PUSH, Loop, sample


class CoilCurrents:
    """A loop without limits, of which only the drive remains."""

    def __init__(self, device=OMNI):
        self.loop = Loop(device).unlimit()
        self.coils = self.loop.protection.coils

    def duties(self, wanted, measured, applied, emf=None):
        """(m,) duties for `wanted` currents, after learning from `measured` currents under `applied` duties."""
        estimate = FRESH
        if emf is not None:  # a mover at 1 m/s
            matrix = np.zeros((6, len(emf)))
            matrix[0] = emf
            moving = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.array([1.0, 0, 0]))
            estimate = Estimate(moving, WrenchMap(matrix, np.zeros(6)), True, 0.0)
        elif self.coils.size != 3:
            estimate = replace(FRESH, wrench_map=WrenchMap(np.zeros((6, self.coils.size)), np.zeros(6)))
        self.loop.open().ask(PUSH, estimate)
        return self.loop.drive(wanted, sample(measured), applied, estimate)

    @property
    def resistance(self):
        """(m,) as believed now [Ω]."""
        return self.coils["resistance"].copy()


def drive_coils(wanted, resistance, seconds, drive=None):
    """Currents through real coils of `resistance` (t) under the drive, no inductance, nothing quantised."""
    drive = drive or CoilCurrents()
    measured, applied = np.zeros(3), np.zeros(3)
    course = []
    for n in range(int(seconds / DT)):
        applied = np.clip(drive.duties(np.asarray(wanted, float), measured, applied), -1, 1).copy()
        measured = applied * OMNI.supply.voltage / resistance(n * DT)
        course.append(measured.copy())
    return np.array(course), drive


def test_at_the_resistance_it_knows_the_current_is_right_at_once():
    cold = OMNI.coils.resistance_at(np.full(3, 298.15))
    course, _ = drive_coils((5, -3, 1), lambda t: cold, 0.1)
    assert np.allclose(course[5:], (5, -3, 1), rtol=1e-3)


def test_a_warm_coil_is_learned_within_a_fifth_of_a_second():
    """60 K are 24 % of resistance: uncompensated 19 % of current are missing, compensated less than 1 %."""
    cold, warm = (OMNI.coils.resistance_at(np.full(3, t)) for t in (298.15, 358.15))
    course, _ = drive_coils((5, -3, 1), lambda t: cold if t < 0.5 else warm, 1.0)
    error = np.abs(course / (5, -3, 1) - 1)
    assert error[501].min() > 0.15
    assert error[-300:].max() < 0.01


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-30, 30), st.floats(-1e6, 1e6) | st.just(float("nan")), st.floats(-1, 1)),
        min_size=1,
        max_size=80,
    )
)
def test_it_cannot_run_away(course):
    """Whatever is read: zero currents, saturated duties, wrong signs, no numbers; the duty stays a duty and the
    resistance stays one that copper can have."""
    drive = CoilCurrents()
    low, high = OMNI.coils.resistance_at(np.full(3, 230.0)), OMNI.coils.resistance_at(np.full(3, 455.0))
    for wanted, measured, applied in course:
        duties = drive.duties(np.full(3, wanted), np.full(3, measured), np.full(3, applied))
        assert np.isfinite(duties).all()
        assert (np.abs(duties) <= 1 + 1e-12).all()
        assert (drive.resistance > low).all()
        assert (drive.resistance < high).all()


def test_saturation_keeps_the_direction():
    alike = replace(OMNI, coils=replace(OMNI.coils, inductance=np.full(3, 4e-4)))
    drive = CoilCurrents(alike)
    for _ in range(3):
        duties = drive.duties(np.array([40.0, -20, 10]), np.zeros(3), np.zeros(3)).copy()
    assert np.abs(duties).max() == pytest.approx(1)
    assert np.allclose(duties / duties[0], (1, -0.5, 0.25))


def test_without_current_nothing_is_learned():
    drive = CoilCurrents()
    before = drive.resistance.copy()
    for _ in range(1000):
        drive.duties(np.zeros(3), np.zeros(3), np.zeros(3))
    assert (drive.resistance == before).all()


def test_rest_is_zero_and_forgets_the_last_step():
    drive = CoilCurrents()
    drive.duties(np.full(3, 10.0), np.zeros(3), np.zeros(3))
    drive.loop.protection.trip(Trip.STOPPED)
    drive.loop.ask()
    assert not drive.loop.drive(np.full(3, 10.0), sample(np.zeros(3)), np.zeros(3)).any()
    first = drive.duties(np.zeros(3), np.zeros(3), np.zeros(3))
    assert not first.any()


def test_what_the_mover_induces_is_fed_forward_and_not_taken_for_resistance():
    """A coil under 2 V of its mover's making carries what is wanted, and its resistance stays what it is."""
    cold = OMNI.coils.resistance_at(np.full(3, 298.15))
    wanted, emf = np.array([5.0, -3.0, 1.0]), np.array([2.0, 2.0, -1.0])
    drive, measured, applied = CoilCurrents(), np.zeros(3), np.zeros(3)
    for _ in range(400):
        applied = drive.duties(wanted, measured, applied, emf).copy()
        measured = (applied * OMNI.supply.voltage - emf) / cold
    assert measured == pytest.approx(wanted, rel=1e-3)
    assert drive.resistance == pytest.approx(cold, rel=1e-3)


def test_a_motors_small_currents_teach_as_well():
    """A twentieth of a motor's ampere is enough to learn by; a fixed half ampere would never be reached."""
    pmsm = load("pmsm")
    warm = pmsm.coils.resistance_at(np.full(12, 338.15))
    drive, measured, applied = CoilCurrents(pmsm), np.zeros(12), np.zeros(12)
    wanted = np.full(12, 0.05)
    for _ in range(600):
        applied = drive.duties(wanted, measured, applied).copy()
        measured = applied * pmsm.supply.voltage / warm
    assert measured == pytest.approx(wanted, rel=0.01)


def through_inductance(wanted, seconds, resistance, inductance):
    """Currents at the ends of the ticks through coils with inductance, each tick an exponential."""
    drive, measured, applied = CoilCurrents(), np.zeros(3), np.zeros(3)
    left, course = np.exp(-resistance * DT / inductance), []
    for n in range(int(seconds / DT)):
        applied = drive.duties(np.asarray(wanted(n), float), measured, applied).copy()
        end = applied * OMNI.supply.voltage / resistance
        measured = end + (measured - end) * left
        course.append(measured)
    return np.array(course), drive


def test_a_current_is_there_at_the_end_of_its_tick():
    """No overshoot at a cold start, and no resistance learned from the inductance's voltage."""
    cold = OMNI.coils.resistance_at(np.full(3, 298.15))
    course, drive = through_inductance(lambda n: (5, -3, 8) if n >= 3 else (0, 0, 0), 0.1, cold, OMNI.coils.inductance)
    assert course[3:] == pytest.approx(np.tile((5.0, -3.0, 8.0), (len(course) - 3, 1)), rel=2e-3)
    assert drive.resistance == pytest.approx(cold, rel=2e-3)


def test_a_step_that_the_supply_cannot_force_does_not_overshoot():
    cold = OMNI.coils.resistance_at(np.full(3, 298.15))
    course, _ = through_inductance(lambda n: (19.0, 0, 0), 0.05, cold, OMNI.coils.inductance)
    assert course[0, 0] < 18.0
    assert course[:, 0].max() < 19.0 * 1.002
    assert course[-1, 0] == pytest.approx(19.0, rel=2e-3)


def test_an_inductance_that_the_file_has_wrong_is_no_resistance():
    """Half and twice the file's: the current errs for ticks, the resistance never by more than a few parts in 100."""
    cold = OMNI.coils.resistance_at(np.full(3, 298.15))
    for factor in (0.5, 2.0):
        course, drive = through_inductance(lambda n: (5, -3, 8), 0.3, cold, factor * OMNI.coils.inductance)
        assert course[-1] == pytest.approx((5.0, -3.0, 8.0), rel=5e-3)
        assert drive.resistance == pytest.approx(cold, rel=5e-3)
