"""`haptorb calibrate`, step by step: prompt, measure, store; stop when a step fails, and resume at the last step.

The driver is opened separately for every step, so that the coils are off while a person reads a prompt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from haptorb.cli.calibration_measurement import DriverSession, Pace, hold_tool
from haptorb.cli.calibration_progress import ProgressFile
from haptorb.cli.calibration_steps import (
    EFFORT,
    STEPS,
    CalibrationEffort,
    Step,
    StepContext,
    calibration_of,
    schedule_of,
)
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, DriverError, InputError, UnknownName
from haptorb.estimation.calibration_file import Calibration, MeasuredHeat, write_calibration
from haptorb.estimation.load_cell_calibration import LoadRecord, calibrate_by_loads
from haptorb.runtime.drivers.base import Driver
from haptorb.terminal import queue_output

__all__ = ["Dialog", "check_steps", "guide_calibration"]


NEEDED = ("rest", "currents", "magnetic")  #: steps without which no calibration file is written

Bar = Callable[[Step, float], AbstractContextManager[Callable[[float], None]]]


def _ignore_message(text: str) -> None:
    """Discard a message."""


def _is_ready(step: Step) -> bool:
    """Confirm a step without a prompt."""
    return True


def _no_bar(step: Step, seconds: float) -> AbstractContextManager[Callable[[float], None]]:
    """Return a progress callback that does nothing."""
    return nullcontext(lambda passed: None)


@dataclass(frozen=True)
class Dialog:
    """User interface of a calibration: messages, prompts and progress bars.

    notify  prints one line
    prompt  asks for confirmation before a step; True: continue, False: stop here and keep the completed steps
    bar     context manager of a progress bar for a step of that many seconds; it returns a function of the elapsed time
    """

    notify: Callable[[str], None] = _ignore_message
    prompt: Callable[[Step], bool] = _is_ready
    bar: Bar = _no_bar


def check_steps(names: Sequence[str] | None, skip: Sequence[str] = ()) -> tuple[Step, ...]:
    """Return the steps `names` in their order of execution; None: all but `skip`. Raises UnknownName for others."""
    known = {step.name: step for step in STEPS}
    for name in names or ():
        if name not in known:
            raise UnknownName("step", name, known)
    return tuple(step for step in STEPS if (step.name in names if names is not None else step.name not in skip))


def guide_calibration(
    device: SphericalElectromagnet,
    driver: Driver,
    out: Path,
    *,
    steps: Sequence[Step] = STEPS,
    heat: MeasuredHeat | None = None,
    loads: LoadRecord | None = None,
    pace: Pace | None = None,
    guide: Dialog | None = None,
    restart: bool = False,
    overwrite: bool = False,
    effort: CalibrationEffort = EFFORT,
) -> Calibration | None:
    """Take the remaining `steps` and write `out`; return None if the person stopped or steps are still missing.

    loads: readings of a load cell, which determine moments and the magnet's strength together with the field sensors.

    Raises CalibrationError at the first step that fails: completed steps are kept beside `out`, and the same call
    resumes there. The calibration's id is stored in the device, if it has memory for it.
    """
    pace, guide = pace or Pace(), guide or Dialog()
    progress = ProgressFile(out, device, driver.name)
    if restart:
        progress.delete()
    elif progress.left:
        guide.notify(progress.left)
    done = [step.name for step in STEPS if step.name in progress.results]
    if done:
        guide.notify(f"resumed; steps already done: {', '.join(done)} (--restart repeats them)")
    for number, step in enumerate(steps, start=1):
        if step.name in progress.results:
            continue
        missing = [name for name in step.needs if name not in progress.results]
        if missing:
            raise InputError(f"step '{step.name}' needs these steps first: {', '.join(missing)}")
        guide.notify(f"{number}/{len(steps)} {step.title}: {step.instruction}")
        if not guide.prompt(step):
            guide.notify(f"stopped before '{step.name}'; repeat the command to continue here")
            return None
        try:
            progress.store(step.name, _take_step(step, device, driver, pace, guide, progress, effort))
        except (CalibrationError, DriverError) as cause:
            raise type(cause)(
                f"step '{step.name}': {cause}. Then repeat the command: it continues at this step"
            ) from cause
        guide.notify(f"    {step.describe(device, progress.results[step.name])}")
    absent = [name for name in NEEDED if name not in progress.results]
    if absent:
        guide.notify(f"progress stored in {progress.path}; a calibration also needs {', '.join(absent)}")
        return None
    calibration = calibration_of(device, progress.results, driver.simulated, heat)
    if loads is not None:
        calibration, left = calibrate_by_loads(device, calibration, loads)
        assert calibration.strength is not None
        assert calibration.strength_uncertainty is not None
        guide.notify(
            f"loads: {len(loads)} readings, {1e3 * left[0]:.2g} mN and {1e3 * left[1]:.2g} mN·m rms left; the magnet "
            f"has {100 * calibration.strength:.2f} ± {100 * calibration.strength_uncertainty:.2f} % of its remanence "
            "in the device file"
        )
    write_calibration(calibration, out, overwrite=overwrite)
    progress.delete()
    with driver:
        if driver.remember(calibration.id):
            guide.notify(f"the device stores the calibration's id, {calibration.id.hex()}")
    return calibration


def _take_step(
    step: Step,
    device: SphericalElectromagnet,
    driver: Driver,
    pace: Pace,
    guide: Dialog,
    progress: ProgressFile,
    effort: CalibrationEffort,
) -> dict[str, object]:
    hold_tool(driver, device, step.hand)
    schedule = schedule_of(device, effort.levels, effort.repeats)
    with queue_output(), driver:
        blank = StepContext(device, DriverSession(device, driver, pace), driver.field_axes, schedule, effort)
        with guide.bar(step, step.seconds(blank)) as passed:
            session = DriverSession(device, driver, pace, passed)
            bench = StepContext(device, session, driver.field_axes, schedule, effort)
            return step.measure(bench, progress.results)
