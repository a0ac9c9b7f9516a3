"""MuJoCo scenes: contact forces, state over time, and messages of unsupported scenes."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.worlds import Outlet, Remote, Scene
from haptorb.worlds.dynamic import BoundWorld, DynamicSum, MemoryNotFinite, bind_world
from haptorb.worlds.scene_physics import SHIPPED, load_engine
from haptorb.worlds.user_world import try_world
from oracles.repetitions import LONG

FREE = """<mujoco><option timestep="{step}" gravity="0 0 {weight}"/><worldbody>{more}
<body name="peg"><freejoint/><geom type="sphere" size="0.01" mass="0.1"/></body></worldbody></mujoco>"""


def write(folder: Path, *, step: float = 0.001, weight: float = 0.0, more: str = "", text: str = FREE) -> Path:
    path = folder / "mine.xml"
    path.write_text(text.format(step=step, weight=weight, more=more))
    return path


def bind(scene: Scene, device: str) -> BoundWorld:
    bound = bind_world(scene.for_device(load(device)), 1e-3)
    assert bound is not None
    return bound


def step(bound: BoundWorld, state: State, late: bool = False) -> Array:
    """The wrench of the next tick; a step that is computed in the background is there in time, or late."""
    if bound.world.is_work_due(bound.memory) and not late and (work := bound.world.find_work(bound.memory)):
        bound.world.take_over(bound.memory, work.compute())
    return bound.wrench(state)


def feel(bound: BoundWorld, ticks: int, height: float = 0.055) -> None:
    where = State.at((0.0, 0.0, height), R_SR=np.eye(3))
    for _ in range(ticks):
        bound.wrench(where)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scene_is_stepped_on_its_device(name: str) -> None:
    device = "omni" if name == "boxes" else "pmsm"
    scene = Scene(name)
    try_world(scene, load(device))
    kinds = {shape.role for shape in scene.shapes}
    assert {"held", "fixed"} <= kinds


def test_the_peg_is_stopped_by_the_floor_of_its_hole_and_free_outside() -> None:
    bound = bind(Scene("peg", stiffness=2000.0, damping=15.0), "pmsm")
    still = State.at((0.0, 0.0, 0.0), R_SR=np.eye(3))
    for _ in range(200):
        free = bound.wrench(still)
    assert abs(free).max() < 1e-3
    for n in range(1, 1201):  # 30 mm in: its floor is 23.3 mm from the tip
        pushed = bound.wrench(State.at((-25e-6 * n, 0.0, 0.0), R_SR=np.eye(3), v=(-25e-3, 0.0, 0.0)))
    assert pushed[0] == pytest.approx(2000.0 * (0.030 - 0.0233), rel=0.05)


def test_the_pull_out_of_the_outlet_is_that_of_its_formula() -> None:
    bound = bind(Scene("outlet", stiffness=5000.0, damping=28.0), "pmsm")
    speed, found = 0.02, []
    for n in range(400):
        state = State.at((speed * n * 1e-3, 0.0, 0.0), R_SR=np.eye(3), v=(speed, 0.0, 0.0))
        found.append(bound.wrench(state)[0])
    formula = Outlet().wrench(state)[0]
    assert np.mean(found[-100:]) == pytest.approx(formula, rel=0.1)


def test_the_same_memory_state_and_dt_give_the_same_bits() -> None:
    def remember(scene: Scene) -> bytes:
        bound = bind(scene, "omni")
        for n in range(300):
            a = 0.3 * np.sin(0.01 * n)
            bound.wrench(State.at((0.054 * np.sin(a), 0.0, 0.054 * np.cos(a))))
        return bound.memory.tobytes()

    scene = Scene("boxes")
    first = remember(scene)
    assert remember(scene) == first  # the scratch pad was used before
    assert remember(pickle.loads(pickle.dumps(scene))) == first  # as in the servo's process


@pytest.mark.parametrize(("level", "late"), [*((level, 1) for level in range(6)), (5, 3), (5, 17)])
def test_momentum_goes_over_to_the_body_at_every_pace(level: int, late: int, tmp_path: Path) -> None:
    """In the scene's own time: none of the push is lost or counted twice, however few steps there are, and however
    late those that are computed in the background."""
    bound = bind(Scene(write(tmp_path), stiffness=100.0, damping=1.0), "omni")
    bound.memory["detail"] = level
    given = np.zeros(3)
    for n in range(400):
        before = float(bound.memory["behind"][0])
        push = step(bound, State.at((0.001, 0.0, 0.055)), late=bool(n % late))[:3]
        given -= push * (1e-3 - float(bound.memory["behind"][0]) + before)
    one = bound.memory[0]
    velocity, on_its_way = one["state"][8:11], one["waiting"][:3] + 1e-3 * one["pending"] * one["share"][:3]
    assert given == pytest.approx(0.1 * velocity + on_its_way, rel=1e-6)
    assert 0.4 - one["behind"] == pytest.approx(one["state"][0] + 1e-3 * one["due"])
    assert np.linalg.norm(velocity) > 1e-3


def test_a_body_that_waits_for_its_step_is_at_rest(tmp_path: Path) -> None:
    """At the end of the step that is being computed: the damper is not that of a moving body."""
    bound = bind(Scene(write(tmp_path), stiffness=100.0, damping=5.0), "omni")
    bound.memory["detail"], bound.memory["pace"] = 5, 0.125
    bound.memory["state"][0][8] = 0.2  # m/s along x
    for _ in range(12):
        bound.wrench(State.at((1e-3 * 0.2, 0.0, 0.0), R_SR=np.eye(3)))
    assert bound.memory["due"][0] == 1.0
    assert bound.wrench(State.at((1e-3 * 0.2, 0.0, 0.0), R_SR=np.eye(3)))[:3] == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_background_step_that_diverged_is_no_state(tmp_path: Path) -> None:
    bound = bind(Scene(write(tmp_path), stiffness=100.0, damping=5.0), "omni")
    bound.memory["detail"] = 5
    feel(bound, 20)
    wrong = bound.memory["state"][0].copy()
    wrong[1] = 1e9
    bound.world.take_over(bound.memory, wrong)
    with pytest.raises(MemoryNotFinite, match="diverged"):
        feel(bound, 1)


def test_the_scene_goes_on_when_the_coupling_is_changed_and_begins_anew_when_it_is_another() -> None:
    scene = Scene("peg", stiffness=1000.0, damping=5.0)
    bound = bind(scene, "pmsm")
    for n in range(50):
        bound.wrench(State.at((1e-5 * n, 0.0, 0.0), R_SR=np.eye(3)))
    stiffer = bind_world(scene.replace(stiffness=2000.0).for_device(load("pmsm")), 1e-3, bound)
    assert stiffer is not None
    assert (stiffer.memory["state"] == bound.memory["state"]).all()
    other = bind_world(Scene("drawer").for_device(load("pmsm")), 1e-3, bound)
    assert other is not None
    assert (other.memory == other.world.begin()).all()


def set_moving(level: int, axis: int) -> Array:
    """(n,) force [N] or torque [N·m] about `axis` on a hand that takes the peg along for 50 ms, and then rests."""
    scene = Scene(
        "peg", stiffness=4010.0, damping=26.2, turn_stiffness=14.0, turn_damping=0.03, slow_damping=52.4,
        slow_turn_damping=0.06,
    )  # fmt: skip
    bound, felt = bind(scene, "pmsm"), np.zeros(4000)
    bound.memory["detail"] = level
    for n in range(4000):
        gone, pace = (n - 300) / 50, (0.1 if 300 <= n < 350 else 0.0)
        gone = 5e-3 * min(max(gone, 0.0), 1.0)
        turn = 10.0 * gone * (axis >= 3)
        R = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
        moved = np.array([1.0, 0.0, 0.0]) * (axis < 3)
        state = State.at(gone * moved, R_SR=R, v=pace * moved, w=10.0 * pace * np.array([axis >= 3, 0.0, 0.0]))
        felt[n] = step(bound, state)[axis]
    return felt


@pytest.mark.parametrize("axis", [pytest.param(0, marks=pytest.mark.slow), 3])
def test_a_body_does_not_swing_in_slower_time(axis: int) -> None:
    """Bodies are felt heavier, but the coupling damps them by the same ratio as at full pace."""

    def overshoot(felt: Array) -> float:
        return float(-felt[350:].min() / felt[350:].max())

    whole = set_moving(0, axis)
    for level in (2, 3, 4, 5) if LONG else (2, 5):
        felt = set_moving(level, axis)
        assert overshoot(felt) < overshoot(whole) + 0.05
        assert abs(felt[-1]) < 0.02 * -felt.min()


@pytest.mark.parametrize("level", range(1, 6))
def test_with_less_detail_a_plug_is_not_thrown_about(level: int) -> None:
    """Pulled out and pushed in again within 2 s, it never takes much more than the 12 N of full detail."""
    scene = Scene("outlet", stiffness=5000.0, damping=28.2, slow_damping=56.4)
    bound, largest = bind(scene, "pmsm"), 0.0
    for n in range(2000):
        phase = 1e-3 * np.pi * n
        out = State.at((0.006 * (1 - np.cos(phase)), 0, 0), R_SR=np.eye(3), v=(0.006 * np.pi * np.sin(phase), 0, 0))
        bound.memory["detail"] = level
        largest = max(largest, float(np.linalg.norm(step(bound, out)[:3])))
    assert {1: 8.0, 2: 8.0, 3: 8.0, 4: 2.0, 5: 2.0}[level] < largest < 16.0


def test_a_heavy_scene_sheds_detail_and_then_time() -> None:
    bound = bind(Scene("drawer", stiffness=1000.0, damping=5.0), "pmsm")
    still = State.at((0.0, 0.0, 0.0), R_SR=np.eye(3))
    for level in range(1, 6):
        bound.world.lighten(bound.memory)
        assert bound.memory["detail"][0] == min(level, 5)
        bound.wrench(still)
    assert 0.9 < bound.memory["pace"][0] < 1.0  # it goes over, and does not jump
    bound.world.restore(bound.memory)  # the last level needs a background thread
    assert bound.memory["detail"][0] == 4
    feel(bound, 300, 0.0)
    time = bound.memory["state"][0][0]
    feel(bound, 80, 0.0)
    assert bound.memory["state"][0][0] - time == pytest.approx(80e-3 / 8)
    assert bound.memory["lighter"][0] == 385
    assert bound.memory["behind"][0] > 0.2
    for _ in range(9):
        bound.world.restore(bound.memory)
    assert bound.memory["detail"][0] == 0
    feel(bound, 400, 0.0)
    assert bound.memory["pace"][0] == 1.0
    assert bound.memory["due"][0] == 0.0


def test_a_stretched_coupling_grows_stiffer_only_by_what_its_damper_took(tmp_path: Path) -> None:
    """A body that is held fast, pulled aside: as long as nothing moves, no pace may come back."""
    fast = FREE.replace("<freejoint/>", '<joint type="slide" stiffness="1e4" damping="20"/>')
    bound = bind(Scene(write(tmp_path, text=fast), stiffness=400.0, damping=4.0), "omni")
    bound.memory["detail"] = 3
    leant = State.at((0.0, 0.0, 0.002))
    for _ in range(600):
        slow = bound.wrench(leant)
    bound.memory["tank"] = 0.0
    bound.memory["detail"] = 0
    for _ in range(600):
        held = bound.wrench(leant)
    assert held == pytest.approx(slow, rel=0.02)
    for n in range(3000):  # it trembles, and the damper takes energy
        moved = bound.wrench(State.at((0.0, 0.0, 0.002), v=(0.0, 0.0, 0.02 * np.sin(0.1 * n))))
    assert bound.memory["pace"][0] == 1.0
    assert np.linalg.norm(moved) > 3.0 * np.linalg.norm(held)


@pytest.mark.parametrize("depth", [0.3e-3, 1e-3, 2e-3])
def test_the_tool_slides_over_the_dome_of_the_boxes_without_trembling(depth: float) -> None:
    bound = bind(Scene("boxes", stiffness=600.0, damping=5.93), "omni")
    forces, tilt, radius, speed = [], 0.11, 49.5e-3 - depth, 0.06
    for tick in range(700):
        height = max(62e-3 - 0.05e-3 * tick, radius)
        turn = speed / 6e-3 * 1e-3 * tick
        p = height * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        v = speed * np.array([-np.sin(turn), np.cos(turn), 0.0])
        forces.append(bound.wrench(State.at(p, v=v, R_SR=np.eye(3)))[:3].copy())
    pressed = np.array(forces[400:])
    assert np.linalg.norm(pressed, axis=1).min() > 0.1
    assert np.linalg.norm(np.diff(pressed, axis=0), axis=1).max() < 0.01


def test_a_scene_that_explodes_raises_and_does_not_begin_anew_by_itself(tmp_path: Path) -> None:
    bound = bind(Scene(write(tmp_path, weight=-1e9), stiffness=100.0, damping=1.0), "omni")
    with pytest.raises(MemoryNotFinite, match="the scene diverged: position or velocity of body 'peg'"):
        feel(bound, 1000)
    assert bound.failed
    bound.restart()
    assert np.isfinite(bound.numbers).all()


BAD = {
    "no body is named": (FREE.replace('"peg"', '"pen"'), InputError, r"name one \(pen\) with --body"),
    "nothing moves": ("<mujoco><worldbody><body name='peg'/></worldbody></mujoco>", InputError, "freejoint"),
    "body is fixed": (
        FREE.replace('"peg"', '"pen"').replace("{more}", "<body name='peg'><geom size='0.01'/></body>"),
        InputError, "cannot be moved",
    ),
    "not well-formed": ("<mujoco>\n<worldbody>\n<oops", InputError, "mine.xml"),
    "unknown element": (FREE.replace("{more}", "\n<bodi/>"), InputError, "line 2"),
    "missing mesh": (
        FREE.replace("<worldbody>", "<asset><mesh name='m' file='gone.stl'/></asset><worldbody>"), InputError,
        "gone.stl",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_a_scene_is_refused_with_what_to_do(case: str, tmp_path: Path) -> None:
    text, error, says = BAD[case]
    with pytest.raises(error, match=says):
        Scene(write(tmp_path, text=text))


def test_a_missing_file_another_name_and_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.xml"):
        Scene(tmp_path / "gone.xml")
    with pytest.raises(UnknownName, match="drawer"):
        Scene("drawr")
    with pytest.raises(InputError, match="MjModel"):
        Scene(3)


@pytest.mark.parametrize(
    ("step", "period", "count"), [(0.0007, 1e-3, 2), (0.002, 1e-3, 1), (0.0005, 1.25e-3, 3), (0.0005, 1e-3, 2)]
)
def test_a_timestep_that_does_not_divide_the_tick_is_shortened_and_said(
    step: float, period: float, count: int, tmp_path: Path
) -> None:
    scene = Scene(write(tmp_path, step=step), stiffness=1e-3, greatest=1e-6).for_device(load("omni"))
    scene.check_period(period)
    remarks = " ".join(scene.list_remarks(period))
    assert ("does not divide" in remarks) == (count * step != pytest.approx(period))
    bound = bind_world(scene, period)
    assert bound is not None
    for _ in range(40):
        bound.wrench(State.at((0.0, 0.0, 0.055)))
    engine = load_engine()
    model = engine.MjModel.from_xml_path(str(tmp_path / "mine.xml"))
    model.opt.timestep = period / count
    data = engine.MjData(model)
    engine.mj_step(model, data, 40 * count)
    assert bound.memory["state"][0, 0] == pytest.approx(40 * period)
    assert bound.memory["state"][0, 1:8] == pytest.approx(data.qpos, abs=1e-5)


def test_too_many_steps_in_a_tick_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="200 are possible"):
        Scene(write(tmp_path, step=1e-6)).check_period(1e-3)


LEVER = """<mujoco model="lever"><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body name="peg" pos="0 0 0.05"><joint name="hinge" type="hinge" axis="0 1 0" damping="0.01"/>
<geom type="capsule" fromto="0 0 0 0.08 0 0" size="0.006" mass="0.05"/></body></worldbody>
<actuator><position joint="hinge" kp="0.5" ctrlrange="-1 1"/></actuator>{more}</mujoco>"""


@pytest.mark.parametrize(
    ("more", "control", "angle"),
    [
        ("", 0.0, 0.0),
        ("", 0.4, 0.4),
        ('<keyframe><key qpos="0" ctrl="0.3"/></keyframe>', 0.0, 0.3),
        ('<keyframe><key qpos="0" ctrl="0.3"/></keyframe>', -0.5, -0.2),
    ],
)
def test_actuators_hold_the_control_of_the_file_changed_by_a_parameter(
    more: str, control: float, angle: float, tmp_path: Path
) -> None:
    scene = Scene(write(tmp_path, text=LEVER.format(more=more)), stiffness=1e-3, greatest=1e-9).for_device(load("omni"))
    assert "1 actuator" in " ".join(scene.remarks)
    assert scene.unused_parameters == {f"control_{n}" for n in range(2, 9)}
    bound = bind_world(scene.replace(control_1=control), 1e-3)
    assert bound is not None
    for _ in range(1500):
        bound.wrench(State.at((0.0, 0.0, 0.055)))
    assert bound.memory["state"][0, 1] == pytest.approx(angle, abs=2e-3)


def test_rk4_is_replaced_and_said(tmp_path: Path) -> None:
    scene = Scene(write(tmp_path, text=FREE.replace("<option ", '<option integrator="RK4" ').format(
        step=0.001, weight=0, more="")))  # fmt: skip
    assert "implicitfast" in " ".join(scene.remarks)
    assert int(scene.model.model.opt.integrator) == int(load_engine().mjtIntegrator.mjINT_IMPLICITFAST)


def test_a_message_lists_a_few_bodies_of_many(tmp_path: Path) -> None:
    more = "".join(f"<body name='arm{n}'><freejoint/><geom size='0.01'/></body>" for n in range(250))
    path = write(tmp_path, text=FREE.replace('"peg"', '"pen"').format(step=0.001, weight=0, more=more))
    for body in ("", "arm"):
        with pytest.raises(InputError) as said:
            Scene(path, body)
        assert len(str(said.value)) < 400
    assert "arm" in str(said.value)


def test_steps_allocate_nothing_that_grows() -> None:
    import tracemalloc

    bound = bind(Scene("boxes"), "omni")
    still = State.at((0.0, 0.0, 0.055))
    for _ in range(300):
        bound.wrench(still)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(2000):
        bound.wrench(still)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 10_000


def test_beside_the_clients_force_a_scene_goes_on_when_the_sum_is_made_anew() -> None:
    both = Scene("boxes") + Remote()
    assert isinstance(both, DynamicSum)
    names = [field.name for field in both.memory_fields]
    assert names[0].startswith("scene_boxes_")
    assert names[-1].startswith("remote_")
    old, new = both.begin(), both.begin()
    old["scene_boxes"]["detail"] = 3.0
    both.keep(new, both, old)
    assert new["scene_boxes"]["detail"] == 3.0
