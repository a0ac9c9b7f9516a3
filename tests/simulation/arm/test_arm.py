"""Simulated arm against other computations: scipy's integrator, friction formulas, Colgate and Schenkel."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

import haptorb
from haptorb.analysis.workspace import map_workspaces, workspace
from haptorb.arrays import Array
from haptorb.cli.comparison import describe_mappings
from haptorb.devices.arm import Arm
from haptorb.devices.base import State
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import DeviceError, InputError
from haptorb.replay.replay import Replay
from haptorb.simulation.arm import SimulatedArm
from haptorb.testing import assert_no_trip, haptic_device, scripted_hand
from haptorb.worlds import Wall

ARMS = [name for name in catalogue() if name.startswith("arm")]
UPRIGHT, NOWHERE = np.array([0.0, 0.0, 0.0, 1.0]), np.full(3, np.nan)


def arm(name: str = "arm", **changes: float) -> Arm:
    """The device of the catalogue, with other values of its end effector."""
    device = load(name)
    assert isinstance(device, Arm)
    return replace(device, effector=replace(device.effector, **changes))


def let_go(device: Arm, v: tuple[float, float, float]) -> SimulatedArm:
    """A free end effector without a hand that moves at `v` [m/s] from the origin."""
    simulated = SimulatedArm(device, held=False)
    simulated._state["v"] = v
    return simulated


def test_the_motion_is_that_of_another_integrator() -> None:
    """Motor, hand, friction and stop against Radau's method, without dry friction: 0.4 s, with a stop reached."""
    device = arm(coulomb=0.0)
    simulated = SimulatedArm(device)
    hand, effector, stops = device.hand, device.effector, device.stops
    volts, goal, mass = 0.05 * device.supply.voltage, np.array([0.12, 0.01, 0.0]), effector.mass + hand.mass
    resistance, inductance = device.coils.resistance_at(np.full(3, device.coils.heat.ambient)), device.coils.inductance

    def slope(t: float, y: Array) -> Array:
        p, v, i = y[:3], y[3:6], y[6:]
        force = device.force_per_ampere * i + hand.stiffness * (goal - p) - (hand.damping + effector.viscous) * v
        r = math.hypot(p[0], p[2])
        if r > device.workspace.half[0]:
            out = np.array([p[0], 0.0, p[2]]) / r
            push = stops.stiffness * (r - device.workspace.half[0]) + stops.damping * float(out @ v)
            force -= max(push, 0.0) * out
        return np.concatenate((v, force / mass, (np.array([volts, 0, 0]) - resistance * i
                                                 - device.force_per_ampere * v) / inductance))  # fmt: skip

    found = solve_ivp(slope, (0.0, 0.4), np.zeros(9), "Radau", np.arange(0.0, 0.4005, 0.01), rtol=1e-8, atol=1e-10)
    duties = np.array([0.05, 0.0, 0.0])
    for number in range(1, 41):
        for _ in range(10):
            simulated.advance(1e-3, duties, goal, UPRIGHT)
        assert simulated.state().p == pytest.approx(found.y[:3, number], abs=2e-4)
    assert found.y[0].max() > 0.08  # the stop was reached
    assert simulated.state().p[1] == pytest.approx(found.y[1, -1], rel=2e-3)


def test_dry_friction_stops_a_motion_after_the_way_of_its_energy_and_holds() -> None:
    device = arm(viscous=0.0, coulomb=0.4)
    device = replace(device, force_per_ampere=1e-9)  # no back-EMF either
    simulated = let_go(device, (0.3, 0.0, 0.0))
    simulated.advance(0.5, np.zeros(3), NOWHERE, UPRIGHT)
    way = 0.5 * device.effector.mass * 0.3**2 / 0.4
    assert simulated.state().p[0] == pytest.approx(way, rel=2e-3)
    assert simulated.state().v.tolist() == [0.0, 0.0, 0.0]
    held = SimulatedArm(device)
    goal = np.array([0.9 * 0.4 / device.hand.stiffness, 0.0, 0.0])  # the hand pulls with 0.36 N
    held.advance(0.5, np.zeros(3), goal, UPRIGHT)
    assert held.state().p.tolist() == [0.0, 0.0, 0.0]
    held.advance(0.5, np.zeros(3), 1.5 * goal, UPRIGHT)
    assert held.state().p[0] > 1e-4


@pytest.mark.parametrize("name", ARMS)
def test_a_free_arm_loses_energy_everywhere(name: str) -> None:
    device = arm(name)
    simulated = let_go(device, (0.8, -0.5, 0.6))
    if device.effector.orientation != "fixed":
        simulated._state["w"] = (3.0, 2.0, -1.0)
    last = math.inf
    for _ in range(300):
        simulated.advance(1e-3, np.zeros(device.channels), NOWHERE, UPRIGHT)
        state = simulated.state()
        r = math.hypot(state.p[0], state.p[2])
        half = np.array(device.workspace.half)
        depth = np.array([r - half[0], abs(state.p[1]) - half[1]])
        if device.workspace.shape == "box":
            depth = np.abs(state.p) - half
        energy = 0.5 * device.effector.mass * float(state.v @ state.v)
        energy += 0.5 * device.effector.inertia * float(state.w @ state.w)
        energy += 0.5 * device.stops.stiffness * float((np.maximum(depth, 0.0) ** 2).sum())
        assert energy <= last * (1 + 1e-3) + 1e-9
        last = energy
    assert last < 1e-3


def test_motors_lag_by_their_time_constant_and_saturate() -> None:
    device = arm()
    simulated = SimulatedArm(device)
    tau = float(device.coils.inductance[0] / device.coils.resistance[0])
    simulated.advance(tau, np.array([0.1, 0.0, 0.0]), np.zeros(3), UPRIGHT)
    settled = 0.1 * device.supply.voltage / device.coils.resistance_at(np.full(3, device.coils.heat.ambient))[0]
    assert simulated.currents[0] == pytest.approx((1 - math.exp(-1)) * settled, rel=0.02)

    def push(state: State) -> Array:
        return np.array([30.0, 40.0, 0.0, 0.0, 0.0, 0.0])

    with haptic_device("arm", push, hand=scripted_hand("start 0 0 0 mm")) as run:
        run.play(0.6)
        given = run.latest().wrench_actual
    assert np.linalg.norm(given[:3]) == pytest.approx(12.0, rel=0.02)
    assert given[1] / given[0] == pytest.approx(4 / 3, rel=0.02)


def test_encoders_have_steps_and_velocity_is_their_difference() -> None:
    device = arm("arm-touch", coulomb=0.0)
    simulated = SimulatedArm(device)
    goal, places, times = np.array([0.02, 0.0, 0.0]), [], []
    for n in range(1, 60):
        simulated.advance(1e-3, np.zeros(3), goal, UPRIGHT)
        sample = simulated.sample(1e-3 * n, 1e-3 * n, True)
        steps = sample.pose.p / device.encoder.step
        assert steps == pytest.approx(np.rint(steps), abs=1e-9)
        assert sample.pose.p == pytest.approx(simulated.state().p, abs=0.51 * device.encoder.step)
        places.append(sample.pose.p)
        times.append(1e-3 * n)
        if n > 6:
            assert sample.pose.v == pytest.approx((places[-1] - places[-6]) / 5e-3, abs=1e-9)
    again = simulated.sample(times[-1], times[-1], True)  # the same time: the same reading
    assert again.pose.v.tolist() == sample.pose.v.tolist()


def stays_calm(device: Arm, stiffness: float, period: float) -> bool:
    """Whether a free arm settles on a sampled spring without damping: the motion in the second half is the smaller."""
    simulated = SimulatedArm(device, held=False)
    simulated.place((1e-3, 0.0, 0.0), UPRIGHT)
    sizes = []
    for _ in range(1600):
        force = -stiffness * float(simulated.state().p[0])
        current = force / device.force_per_ampere
        emf = device.force_per_ampere * float(simulated.state().v[0])
        volts = current * float(device.coils.resistance[0]) + emf
        simulated.advance(period, np.array([volts / device.supply.voltage, 0.0, 0.0]), NOWHERE, UPRIGHT)
        sizes.append(abs(float(simulated.state().p[0])))
    return max(sizes[1200:]) < max(sizes[400:800])


def test_a_wall_becomes_unstable_where_colgate_and_schenkel_say() -> None:
    """b > K T/2 + B with B = 0, of an arm whose motors follow at once and hardly brake; and the eigenvalues of the
    sampled mass, spring and damper, computed another way."""
    period, b = 1e-3, 2.0
    device = arm(viscous=b, coulomb=0.0)
    coils = replace(device.coils, inductance=np.full(3, 1e-7), temperature_coefficient=0.0)
    device = replace(
        device, coils=coils, force_per_ampere=0.02, supply=replace(device.supply, voltage=2e3, duty_bits=24)
    )
    bound = 2 * b / period
    low, high = 0.5 * bound, 2.0 * bound
    while high / low > 1.02:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stays_calm(device, middle, period) else (low, middle)

    def radius(stiffness: float) -> float:
        m = device.effector.mass
        A, B, *_ = cont2discrete(
            (np.array([[0, 1], [0, -b / m]]), np.array([[0], [1 / m]]), np.eye(2), np.zeros((2, 1))), period
        )
        return float(np.abs(np.linalg.eigvals(A - B @ np.array([[stiffness, 0.0]]))).max())

    exact = max(k for k in np.geomspace(0.5 * bound, 2 * bound, 2000) if radius(float(k)) < 1.0)
    assert low == pytest.approx(exact, rel=0.04)
    assert low == pytest.approx(bound, rel=0.06)


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_runs_a_wall_is_recorded_and_replays(name: str, tmp_path: Path) -> None:
    hand = scripted_hand("start 20 0 0 mm\nwait 0.35 s\nmove -10 0 0 mm in 0.2 s\nwait 1.5 s\n")
    with haptic_device(name, Wall(stiffness=300.0, greatest=3.0), hand=hand, record=tmp_path / "a.mcap") as run:
        run.play()
    recording = run.recording
    assert_no_trip(recording)
    last = run.latest()
    assert -0.01 < last.p[0] < -0.001
    # At rest: the wall and dry friction hold the hand.
    device = arm(name)
    pull = device.hand.stiffness * (float(last.p[0]) + 0.01)
    assert float(last.wrench_actual[0]) == pytest.approx(pull, abs=device.effector.coulomb + 0.02)
    assert Replay(recording).run().identical


def test_torque_turns_an_actuated_wrist_and_no_other() -> None:
    def twist(state: State) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])

    for name, turned in (("arm-sigma", True), ("arm-touch", False), ("arm", False)):
        with haptic_device(name, twist, hand=scripted_hand("start 0 0 0 mm")) as run:
            run.play(0.8)
            last = run.latest()
        device = arm(name)
        angle = 2 * math.asin(abs(float(last.q[1])))
        if turned:
            least = (0.05 - device.effector.turn_coulomb) / device.hand.turn_stiffness
            assert least * 0.95 < angle < 0.05 / device.hand.turn_stiffness * 1.05
        else:
            assert angle < 1e-9


def test_a_goal_outside_the_workspace_is_refused_and_a_place_is_put_inside() -> None:
    touch, omega = arm("arm-touch"), arm()
    inside = scripted_hand("start 90 0 0 mm")(touch)  # a hand leans on the stops
    assert inside.at(0.0)[0].tolist() == [0.09, 0.0, 0.0]
    for device, text in ((touch, "start 0 60 0 mm"), (omega, "start 75 0 75 mm")):
        with pytest.raises(InputError, match="outside the workspace"):
            scripted_hand(text)(device)
    simulated = SimulatedArm(omega)
    simulated.place((0.2, 0.2, 0.2), UPRIGHT)
    assert omega.workspace.contains(simulated.state().p[None], 1e-9)[0]


def test_workspaces_are_mapped_onto_each_other() -> None:
    omega, omni, motor = load("arm"), load("omni"), load("pmsm")
    mapping = map_workspaces(omega, omni)
    assert mapping is not None
    places = mapping.place(workspace(omega).places)
    there = workspace(omni).places
    assert (places.min(axis=0) >= there.min(axis=0) - 1e-9).all()
    assert (places.max(axis=0) <= there.max(axis=0) + 1e-9).all()
    assert np.isclose(np.ptp(places, axis=0), np.ptp(there, axis=0)).any()  # the tightest side fits exactly
    assert f"scale {mapping.scale:.3g}" in describe_mappings([omega, omni], ["arm", "omni"])[0]
    assert map_workspaces(omega, motor) is None


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('orientation = "fixed"', 'orientation = "actuated"', "channels"),
        ('orientation = "fixed"', 'orientation = "loose"', "orientation"),
        ("half = { value = [80, 55, 80]", "half = { value = [80, 55, 70]", "radius"),
        ('mass = { value = "0.2 kg"', 'mass = { value = "0 kg"', "mass"),
        ('step = { value = "0.01 mm"', 'step = { value = "-1 mm"', "step"),
        ('velocity_window = { value = "5 ms"', 'velocity_window = { value = "5 s"', "velocity_window"),
        ("force_per_ampere = { value = 1.2,", "force_per_ampere = { value = 1e-9,", "limits.force"),
    ],
)
def test_a_file_that_cannot_be_is_refused(old: str, new: str, told: str) -> None:
    text = (Path(haptorb.__file__).parent / "devices" / "catalogue" / "arm.toml").read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(DeviceError, match=told) as refused:
        parse(text.replace(old, new, 1), "mine")
    assert len(str(refused.value).splitlines()) == 1


def test_no_layer_above_its_parts_names_the_arm() -> None:
    """What runs, records, replays and shows devices knows the kind by its record only; the makers' interfaces are told
    what it is by one registered function."""
    source = Path(haptorb.__file__).parent
    names = re.compile(r"devices\.arm|simulation\.arm|ArmFile|SimulatedArm|\bArm\b|[\"']arm[\"']")
    rooms = ("runtime", "recording", "replay", "web", "serve", "testing", "estimation", "terminal.py")
    files = [
        path for room in rooms for path in ([source / room] if room.endswith(".py") else (source / room).rglob("*.py"))
    ]
    assert len(files) > 60
    found = [str(path.relative_to(source)) for path in files if names.search(path.read_text(encoding="utf-8"))]
    assert set(found) <= {"serve/native.py"}
