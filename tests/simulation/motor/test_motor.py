"""Simulated spherical motor: energy conservation, electrical power balance, a hand, a stop."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from haptorb.devices.api import torque_characteristic
from haptorb.devices.field_sensors import SensorErrors
from haptorb.devices.loader import load
from haptorb.devices.motor import HANDLE_LOOSE
from haptorb.errors import InputError, UnknownName
from haptorb.rotations import rotation_from_euler
from haptorb.simulation.motor import SimulatedMotor
from haptorb.simulation.motor_specimen import pack_truth
from haptorb.simulation.registry import simulate

PMSM = replace(load("pmsm"), tolerance=None)  # as its file says; a motor within its tolerances: test_motor_specimen
OFF = np.zeros(12)
NOWHERE = np.zeros(3)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
DT = 1e-3


def turn_of(psi=0.0, lam=0.0, phi=0.0):
    return Rotation.from_euler("XYZ", [psi, lam, phi], degrees=True).as_quat()


def frictionless(**changes):
    """No hand, nothing that rubs, magnets that no coil feels."""
    motor = SimulatedMotor(PMSM, grasp=HANDLE_LOOSE)
    for name, value in {"damping": 0.0, "friction": 0.0, "stop_damping": 0.0, **changes}.items():
        motor._rotor[name] = value
    motor._strength[:] = 0.0
    return motor


def weightless(motor):
    """Neither weight nor regulator."""
    motor._parts = motor._parts._replace(tilt_torque=np.zeros(2))
    motor._magnetics = pack_truth(motor._parts)
    return motor


def go(motor, seconds, duties=OFF, goal=UPRIGHT):
    for _ in range(round(seconds / DT)):
        motor.advance(DT, duties, NOWHERE, goal)
    return motor


@settings(max_examples=10, deadline=None)
@given(st.tuples(*[st.floats(-6, 6)] * 3), st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(-180, 180)))
def test_a_free_rotor_keeps_energy_and_spin(w, angles):
    """Weight, regulator and stop only: all have potentials and turn about horizontal axes."""
    motor = frictionless()
    motor.place(NOWHERE, turn_of(*angles))
    motor.spin(w)
    energy, upright = motor.energy, motor.momentum[2]
    energies, momenta, touched = [], [], False
    for _ in range(200):
        motor.advance(DT, OFF, NOWHERE, UPRIGHT)
        energies.append(motor.energy)
        touched = touched or motor.stop_deflection > 0
        momenta.append(motor.momentum[2])
    motor.advance(DT, OFF, NOWHERE, UPRIGHT)  # an impact that has just begun shows in the next step
    touched = touched or motor.stop_deflection > 0
    size = max(abs(energy), 1e-3)
    # an impact on the stop begins within a step: that costs a thousandth, nothing else does more than 1e-6
    assert np.abs(np.array(energies) - energy).max() < 2e-3 * size
    if not touched:
        assert np.abs(np.array(energies) - energy).max() < 1e-5 * size
    assert np.abs(np.array(momenta) - upright).max() < 1e-10


def test_a_free_rotor_moves_as_eulers_equations_say():
    motor = weightless(frictionless(stop=0.0, inertia=(3e-3, 4e-3, 6e-3)))
    motor.spin((2.0, 1.0, 5.0))
    inertia = motor._rotor["inertia"][0]

    def rates(t, s):
        w = s[4:]
        x, y, z, a = s[:4]
        dq = 0.5 * np.array(
            [a * w[0] + y * w[2] - z * w[1], a * w[1] + z * w[0] - x * w[2], a * w[2] + x * w[1] - y * w[0],
             -x * w[0] - y * w[1] - z * w[2]]
        )  # fmt: skip
        return np.r_[dq, np.cross(inertia * w, w) / inertia]

    end = solve_ivp(rates, (0, 0.5), np.r_[UPRIGHT, 2.0, 1.0, 5.0], rtol=1e-10, atol=1e-12).y[:, -1]
    go(motor, 0.5)
    between = Rotation.from_quat(end[:4]).inv() * Rotation.from_matrix(motor.state().R_SR)
    assert between.magnitude() < 2e-5


def test_it_rests_where_nothing_pushes_it_and_falls_where_no_regulator_holds_it():
    held = go(SimulatedMotor(PMSM, grasp=HANDLE_LOOSE), 0.5)
    assert held.state().R_SR[2, 2] == 1.0
    falling = SimulatedMotor(dataclasses.replace(PMSM, regulator=None), grasp=HANDLE_LOOSE)
    falling.place(NOWHERE, turn_of(lam=5.0))
    go(falling, 3.0)
    tilt = np.degrees(np.arccos(falling.state().R_SR[2, 2]))
    assert tilt == pytest.approx(22.5, abs=0.2)  # on the end stop, which yields by a tenth of a degree
    assert falling.stop_deflection > 0
    assert np.abs(falling.state().w).max() < 1e-6


def test_dry_friction_holds_what_is_too_weak():
    """Tilted so far that weight and regulator give half of what the bearing holds."""
    motor = SimulatedMotor(PMSM, grasp=HANDLE_LOOSE)
    tilts = np.linspace(0.0, 20.0, 200)
    pull = [np.linalg.norm(PMSM.passive(rotation_from_euler(0.0, np.radians(one), 0.0))[3:]) for one in tilts]
    small = tilts[np.flatnonzero(np.array(pull) > 0.5 * PMSM.rotor.dry_friction)[0] - 1]
    motor.place(NOWHERE, turn_of(lam=float(small)))
    before = motor.state().R_SR
    go(motor, 0.2)
    assert np.abs(motor.state().R_SR - before).max() < 1e-12


def test_passive_torque_is_the_devices_own():
    motor = SimulatedMotor(PMSM, grasp=replace(PMSM.hand, stiffness=1e6, damping=1e3))
    for angles in ((10, 5, 40), (-20, 3, 0), (0, 0, 0), (7, -19, 123)):
        q = turn_of(*angles)
        motor.place(NOWHERE, q)
        motor.advance(DT, OFF, NOWHERE, q)
        assert motor.wrench_actual() == pytest.approx(PMSM.passive(motor.state().R_SR), abs=2e-5)


def test_torque_is_the_characteristic_times_the_currents():
    q = turn_of(10, 5, 5)
    motor = SimulatedMotor(PMSM, grasp=replace(PMSM.hand, stiffness=1e6, damping=1e3))
    motor.place(NOWHERE, q)
    duties = 0.3 * np.sin(np.arange(12.0))
    go(motor, 0.05, duties, q)
    state = motor.state()
    K = torque_characteristic(PMSM, state.R_SR, grouped=True)
    assert motor.wrench_actual()[3:] == pytest.approx(K @ motor.currents + PMSM.passive(state.R_SR)[3:], abs=1e-5)
    assert not motor.wrench_actual()[:3].any()
    assert motor.currents == pytest.approx(duties * 60 / PMSM.coils.resistance_at(motor.winding), rel=2e-3, abs=1e-9)


@pytest.mark.parametrize("speed", [0.2, 6.0])
def test_one_look_up_of_the_characteristic_serves_a_tick(speed):
    """A millisecond at once, or its four steps one by one, each with a characteristic of its own: the same motion to
    0.001°, the same torque to 0.05 % of the greatest, while up to 1.1 N·m throw the rotor about at up to 12 rad/s."""
    whole, apart = SimulatedMotor(PMSM, seed=1), SimulatedMotor(PMSM, seed=1)
    for motor in (whole, apart):
        motor.place(NOWHERE, turn_of(5, -3, 10))
        motor.spin(speed * np.array([0.3, -0.2, 1.0]))
    turned, torques, fastest = [], [], 0.0
    for n in range(400):
        duties = 0.6 * np.sin(0.02 * n * np.arange(1, 13))
        goal = turn_of(11 * np.sin(4e-3 * speed * n), 11 * np.cos(3e-3 * speed * n), 0.057 * speed * n)
        whole.advance(DT, duties, NOWHERE, goal)
        mean = np.zeros(6)
        for _ in range(4):
            apart.advance(DT / 4, duties, NOWHERE, goal)
            mean += 0.25 * apart.wrench_actual()
        torques.append((whole.wrench_actual(), mean))
        turned.append(np.abs(whole.state().R_SR - apart.state().R_SR).max())
        fastest = max(fastest, float(np.linalg.norm(whole.state().w)))
    found, fine = np.array(torques).swapaxes(0, 1)
    assert fastest > 5.0
    assert np.abs(fine).max() > 0.8
    assert np.abs(found - fine).max() < 5e-4 * np.abs(fine).max()
    assert max(turned) < np.radians(1e-3)


def test_the_coils_pay_for_what_the_rotor_gets():
    """Energy from the supply = heat + field + motion: checked over a swing under constant duty, no friction."""
    motor = SimulatedMotor(PMSM, grasp=HANDLE_LOOSE)
    for name in ("damping", "friction", "stop", "stop_damping"):
        motor._rotor[name] = 0.0
    motor.place(NOWHERE, turn_of(3, -4, 10))
    duties = np.where(np.arange(12) % 3 == 0, 0.08, -0.05)
    start = motor.energy
    supplied = heated = 0.0
    resistance = PMSM.coils.resistance_at(motor.winding)
    h = 2.5e-4
    for _ in range(400):
        before = motor.currents
        motor.advance(h, duties, NOWHERE, UPRIGHT)
        mean = 0.5 * (before + motor.currents)
        supplied += h * float(duties @ mean) * 60
        heated += h * float((resistance * (before**2 + before * motor.currents + motor.currents**2) / 3).sum())
    stored = 0.5 * float((PMSM.coils.inductance * motor.currents**2).sum())
    gained = motor.energy - start
    assert abs(gained) > 1e-3
    assert supplied - heated - stored == pytest.approx(gained, rel=0.03)


def test_the_hand_leads_and_yields():
    """Mass, spring and damper: at rest the handle stands off by torque over stiffness."""
    grasp = PMSM.hand
    motor = SimulatedMotor(PMSM, grasp=grasp)
    go(motor, 1.5, OFF, turn_of(lam=10.0))
    off = 10.0 - np.degrees(Rotation.from_matrix(motor.state().R_SR).as_euler("XYZ")[1])
    back = -motor.wrench_actual()[4]
    rub = PMSM.rotor.dry_friction
    assert abs(np.radians(off) * grasp.stiffness * 0.12**2 - back) <= rub * 1.05


@settings(max_examples=10, deadline=None)
@given(st.tuples(*[st.floats(-180, 180)] * 3), st.lists(st.floats(-1, 1), min_size=12, max_size=12))
def test_no_hand_and_no_current_brings_it_out_of_its_workspace(angles, duties):
    motor = SimulatedMotor(PMSM)
    go(motor, 0.3, np.array(duties), turn_of(*angles))
    tilt = np.degrees(np.arccos(motor.state().R_SR[2, 2]))
    assert tilt < 22.5 + 6.0  # a hand that wants it 180° away leans 13 N·m on a stop of 200 N·m/rad
    assert np.isfinite(motor.state().R_SR).all()


def test_the_sensors_read_magnets_and_coils():
    motor = SimulatedMotor(PMSM, seed=3, quality=SensorErrors())
    q = turn_of(8, -6, 20)
    go(motor, 0.05, np.full(12, 0.1), q)
    sample = motor.sample(0.05, 0.05, True)
    R = motor.state().R_SR
    true = PMSM.sensor_field(R[None], "table")[0] + PMSM.coil_field(PMSM.sensor_layout.positions, motor.currents)
    error = sample.field - true
    assert np.sqrt((error**2).mean()) == pytest.approx(np.hypot(0.05e-3, 0.02e-3 / 12**0.5), rel=0.3)
    assert np.abs(PMSM.coil_field(PMSM.sensor_layout.positions, motor.currents)).max() > 10 * np.abs(error).max()
    assert (sample.pose.R_SR == R).all()


def test_sensors_fail_as_they_are_told():
    motor = SimulatedMotor(PMSM, seed=3)
    good = motor.sample(0, 0, True).field
    motor.fail([4], "dead")
    motor.fail([5], "saturated")
    motor.fail([6], "stuck")
    motor.place(NOWHERE, turn_of(lam=15.0))
    seen = motor.sample(0, 0, True).field
    frames = PMSM.sensor_layout.frames
    assert np.abs(seen[4]).max() < 1e-3
    assert np.abs(frames[5].T @ seen[5]).min() > 0.65
    assert seen[6] == pytest.approx(good[6], abs=1e-12)
    motor.fail([4, 5, 6], "none")
    assert np.abs(motor.sample(0, 0, True).field[4]).max() > 1e-2
    with pytest.raises(UnknownName, match="did you mean 'dead'"):
        motor.fail([0], "ded")
    with pytest.raises(InputError, match="0 to 47"):
        motor.fail([48])


def test_the_same_seed_gives_the_same_bits():
    def course(seed):
        motor = SimulatedMotor(PMSM, seed=seed, magnet_spread=0.01)
        go(motor, 0.02, np.full(12, 0.2), turn_of(lam=10.0))
        return motor.sample(0.0, 0.0, True).field.tobytes()

    one = SimulatedMotor(PMSM, seed=5, magnet_spread=0.01)
    go(one, 0.1, np.full(12, -0.2))
    one.reset(7)
    go(one, 0.02, np.full(12, 0.2), turn_of(lam=10.0))
    assert one.sample(0.0, 0.0, True).field.tobytes() == course(7) != course(8)


def test_magnets_of_uneven_strength_give_another_torque():
    def torque(spread):
        q = turn_of(10, 5, 5)
        motor = SimulatedMotor(PMSM, seed=1, grasp=replace(PMSM.hand, stiffness=1e6, damping=1e3), magnet_spread=spread)
        motor.place(NOWHERE, q)
        go(motor, 0.03, 0.2 * np.cos(np.arange(12.0)), q)
        return motor.wrench_actual()[3:]

    assert 1e-4 < np.linalg.norm(torque(0.02) - torque(0.0)) < 0.1 * np.linalg.norm(torque(0.0))


def test_what_is_no_number_changes_nothing():
    motor = SimulatedMotor(PMSM)
    go(motor, 0.05, OFF, turn_of(lam=10.0))
    go(motor, 0.3, motor.quantise(np.full(12, np.nan)), np.full(4, np.nan))
    assert not motor.quantise(np.full(12, np.nan)).any()
    assert np.degrees(Rotation.from_matrix(motor.state().R_SR).as_euler("XYZ")[1]) > 5.0


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: SimulatedMotor(PMSM, step=0.1),
        lambda: SimulatedMotor(PMSM, magnet_spread=-1),
        lambda: SimulatedMotor(PMSM, -1),
        lambda: replace(PMSM.hand, stiffness=-1),
        lambda: replace(PMSM.hand, mass=float("nan")),
        lambda: SensorErrors(-1e-3, 0, 0),
        lambda: SimulatedMotor(PMSM).place(NOWHERE, np.zeros(4)),
        lambda: SimulatedMotor(PMSM).place(NOWHERE, (0, 0, np.nan, 1)),
        lambda: SimulatedMotor(PMSM).spin((1, 2)),
        lambda: SimulatedMotor(PMSM).advance(-1.0, OFF, NOWHERE, UPRIGHT),
        lambda: SimulatedMotor(PMSM).advance(float("nan"), OFF, NOWHERE, UPRIGHT),
    ],
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(InputError):
        wrong()


def test_the_registry_knows_motors():
    assert isinstance(simulate(PMSM), SimulatedMotor)
