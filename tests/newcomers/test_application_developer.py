"""First hour of an application developer in Python: a world of her own, an event loop, and her mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from newcomers.newcomer_shell import NewcomerShell

pytestmark = pytest.mark.realtime

FIRST = """
import haptorb
import numpy as np

def spring(state):
    '''20 N/m towards 60 mm above the centre.'''
    force = 20.0 * (np.array([0.0, 0.0, 0.06]) - state.p)
    return np.append(force, np.zeros(3))

with haptorb.Servo("omni", spring, record=False) as servo:
    servo.hand.hold((0.0, 0.0, 0.052))
    servo.run(seconds=0.6)
    row = servo.latest()
    print(servo)
    print(repr(row))
    commanded, actual = row.wrench_commanded[2], row["wrench_actual"][2]
    print("commanded", commanded, row.units["wrench_commanded"], "actual", actual, "coils", row.temperature.max(), "K")
    assert abs(row.wrench_commanded[2] - 20.0 * (0.06 - row.p[2])) < 0.02
    assert abs(row.wrench_actual[2] - row.wrench_commanded[2]) < 0.03
    servo.hand.follow([(0.0, 0.0, 0.052), (0.01, 0.0, 0.055)], times=[0.0, 0.3])
    servo.run(seconds=0.6)
    row = servo.latest()
    assert np.allclose(row.hand_goal, (0.01, 0.0, 0.055)), row.hand_goal
    assert servo.report()["trips"] == [], servo.report()["trips"]
print(servo.report())
"""
EVENT_LOOP = """
import asyncio
import haptorb

async def tick(ticks):
    while True:
        ticks.append(1)
        await asyncio.sleep(0.01)

async def main():
    ticks, rows = [], []
    ticker = asyncio.create_task(tick(ticks))
    async with haptorb.Servo("omni", "dome", record=False) as servo:
        started = len(ticks)
        servo.hand.hold((0.0, 0.0, 0.05))
        await servo.wait(0.3)
        async for row in servo.watch(every=0.02):
            rows.append(row.t)
            if len(rows) == 10:
                break
    ticker.cancel()
    assert started > 5, f"{started} ticks while it started"
    assert rows == sorted(rows) and len(set(rows)) > 1
    print("ticks while it started:", started)

asyncio.run(main())
"""
BUG = """
import haptorb
import numpy as np

def sticky(state):
    if state.t > 0.2:
        return None
    return np.zeros(6)

with haptorb.Servo("omni", sticky, record=False) as servo:
    servo.run(seconds=30)
"""
MISTAKES = """
import haptorb

def refuse(call, *words):
    try:
        call()
    except haptorb.errors.HaptorbError as error:
        for word in words:
            assert word in str(error), (word, str(error))
        print(type(error).__name__, error)
    else:
        raise AssertionError(f"nothing was said of {words}")

refuse(lambda: haptorb.Servo("omny"), "did you mean 'omni'")
refuse(lambda: haptorb.Servo("omni", "dme"), "did you mean 'dome'")
refuse(lambda: haptorb.Servo("omni", 3), "function of a State")
with haptorb.Servo("omni", "dome", record=False) as servo:
    refuse(lambda: servo.hand.point((0, 0, 50)), "50 mm are 0.05")
    refuse(lambda: servo.hand.hold((0, 0, float("nan"))), "finite")
    refuse(lambda: servo.set_world("dome", {"momment": 1}), "did you mean 'moment'")
    refuse(lambda: servo.latest()["wrench_actua"], "did you mean 'wrench_actual'")
    servo.run(seconds=0.1)
    1 / 0
"""


@pytest.fixture
def shell(tmp_path: Path) -> NewcomerShell:
    for name, text in (("first", FIRST), ("event_loop", EVENT_LOOP), ("bug", BUG), ("mistakes", MISTAKES)):
        (tmp_path / f"{name}.py").write_text(text)
    return NewcomerShell(tmp_path)


def test_she_feels_her_function_and_reads_it_by_name(shell: NewcomerShell) -> None:
    told = shell.run("python first.py").stdout
    assert "<Servo of omni, world 'spring', driver sim, tracker pointer, 1000 Hz: running" in told
    assert "commanded" in told
    assert "N, N·m" in told
    assert shell.list_running() == []


@pytest.mark.slow
def test_her_event_loop_goes_on(shell: NewcomerShell) -> None:
    assert "ticks while it started" in shell.run("python event_loop.py").stdout
    assert shell.list_running() == []


@pytest.mark.slow
def test_her_bug_is_told_with_its_line_and_nothing_is_left(shell: NewcomerShell) -> None:
    said = shell.run("python bug.py", code=1).stderr
    assert "WorldError: world 'sticky' failed: wrench must return an array of 6 numbers" in said
    assert "got None" in said
    assert 'bug.py", line 5, in sticky' in said
    assert shell.list_running() == []


@pytest.mark.slow
def test_her_mistakes_are_told_and_her_exception_ends_it_cleanly(shell: NewcomerShell) -> None:
    said = shell.run("python mistakes.py", code=1).stderr
    assert said.rstrip().endswith("ZeroDivisionError: division by zero")
    assert shell.list_running() == []
