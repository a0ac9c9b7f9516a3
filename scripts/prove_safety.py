"""Break the safety code once per rule and see that a test goes red: `python scripts/prove_safety.py [WORD…]`.

With words: only the rules in whose name, or whose code's file, one of them stands.
A test that cannot fail proves nothing. Each line of PROOFS is one rule, the code that keeps it, and what it looks like
without it; the change is made in a copy of the sources, never in the tree itself.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

GUARD, GUARD_TESTS = "control/protection/guard.py", "tests/control/protection/test_guard.py"
STATE, PROTECTION = "control/protection/state.py", "control/protection/protection.py"
PROTECT = "control/protection/protect.py"
DRIVE, DRIVE_TESTS = "control/protection/drive.py", "tests/control/protection/test_drive.py"
PASSIVITY, PASSIVITY_TESTS = "control/protection/passivity.py", "tests/control/protection/test_passivity.py"
TICK, TICK_TESTS = "runtime/tick/tick.py", "tests/runtime/tick/test_tick.py"
TRACKER_TESTS, FEED_TESTS = "tests/contracts/test_trackers.py", "tests/runtime/trackers/test_trackers.py"
SENDER, SENDER_TESTS = "runtime/trackers/sender_clock.py", "tests/runtime/trackers/test_sender_clock.py"
SERIAL, SERIAL_TESTS = "runtime/drivers/serial/serial_driver.py", "tests/runtime/drivers/serial/test_serial_driver.py"
GUIDED_TESTS = "tests/apps/calibrate/test_guided.py"
FRAME_TESTS, FRAMED_TESTS = (
    "tests/sensing/frame/test_frame_registration.py",
    "tests/runtime/trackers/test_framed_feed.py",
)

ORIENTATION_TESTS, MAP_TESTS = (
    "tests/sensing/orientation/test_least_squares.py",
    "tests/sensing/torque_maps/test_torque_maps.py",
)

SWITCH, GUARDIAN, I2C = (
    "runtime/drivers/i2c/coil_switch.py",
    "runtime/drivers/i2c/i2c_guardian.py",
    "runtime/drivers/i2c/i2c_driver.py",
)
I2C_TESTS, LOCK_TESTS = "tests/runtime/drivers/i2c/test_i2c_faults.py", "tests/runtime/drivers/i2c/test_i2c_lock.py"
HOSTILE = "tests/contracts/test_hostile_files.py"
PAGES, PAGES_TESTS = "apps/study/pages/room.py", "tests/apps/study/test_pages.py"
HALT, STOP_TESTS = "apps/study/session/halt.py", "tests/apps/study/test_stop.py"
CONSOLE, CONSOLE_TESTS = "apps/console/room.py", "tests/apps/console/test_room.py"

CHILDREN, HOSTILE_TESTS = "runtime/servo/process_group.py", "tests/runtime/processes/test_hostile_worlds.py"
STALLED_TESTS, LEFTOVER_TESTS = (
    "tests/runtime/processes/test_stalled_recorder.py",
    "tests/runtime/realtime/test_stale_files.py",
)

#: (rule, file in the package, code that keeps it, code without it, tests that must go red)
PROOFS = [
    ("off is the default", STATE, "= GuardState.OFF", "= GuardState.RUNNING", GUARD_TESTS),
    (
        "units are read and not evaluated",
        "devices/schema/quantity.py",
        "_registry().Quantity(number, _unit(name))",
        "_registry().Quantity(number, name or 'dimensionless')",
        f"{HOSTILE}::test_a_unit_is_read_and_not_evaluated",
    ),
    (
        "a list is no number of a world",
        "worlds/parameter.py",
        "several is not isinstance(known.default, tuple) or (several and len(value) != known.size)",
        "several and len(value) != known.size",
        f"{HOSTILE}::test_a_number_is_a_number_wherever_a_world_is_changed",
    ),
    (
        "a chunk of a recording is asked for its size before it is made",
        "runtime/recording/mcap_rows.py",
        "if max(told) > min(_CHUNK, room):",
        "if False:",
        f"{HOSTILE}::test_a_chunk_that_says_it_is_a_gigabyte_is_refused_before_it_is_made",
    ),
    (
        "a recording is as open as the umask says",
        "runtime/recording/recording_file.py",
        "0o666 & ~mask",
        "0o644",
        f"{HOSTILE}::test_a_recording_is_as_open_as_its_owner_wants_files",
    ),
    (
        "an id is kept when the EEPROM has it",
        "runtime/drivers/serial/board.py",
        ").refusal is Refusal.WRITING and",
        ").refusal is None and",
        SERIAL_TESTS,
    ),
    ("NaN wrench trips", GUARD, "if not np.isfinite(force + torque):", "if False:", GUARD_TESTS),
    ("NaN currents trip", GUARD, "if not np.isfinite(wanted[j]):", "if False:", GUARD_TESTS),
    ("NaN readings trip", GUARD, "if not np.isfinite(total):", "if False:", GUARD_TESTS),
    ("force is clamped", GUARD, "if force <= g.force", "if True", GUARD_TESTS),
    ("torque is clamped", GUARD, "if torque <= g.torque", "if True", GUARD_TESTS),
    ("current is clamped", GUARD, "if abs(wanted[j]) * scale > coils[j].limit:", "if False:", GUARD_TESTS),
    ("current slews", GUARD, "1.0 if largest <= step else step / largest", "1.0", GUARD_TESTS),
    (
        "stale poses trip",
        GUARD,
        "valid and age <= g.expiry",
        "valid",
        GUARD_TESTS,
    ),
    ("lost poses trip", GUARD, "valid and age <=", "age <=", GUARD_TESTS),
    ("trips latch", GUARD, "g.state = _TRIPPED  #", "pass  #", GUARD_TESTS),
    (
        "engaging ramps from zero",
        PROTECTION,
        'g["gain"] = 0.0',
        'g["gain"] = 1.0',
        GUARD_TESTS,
    ),
    ("engaging blind is refused", PROTECTION, 'if not g["fresh"][0] or', "if", GUARD_TESTS),
    ("warm coils are derated", GUARD, "_hold(coils, wanted, share,", "_hold(coils, wanted, 1.0,", GUARD_TESTS),
    ("hot coils trip", GUARD, "if not hottest < heat.stop:", "if False:", GUARD_TESTS),
    ("overcurrent trips", GUARD, "return _OVERCURRENT if beyond else _NONE", "return _NONE", GUARD_TESTS),
    (
        "resistance is bounded",
        DRIVE,
        "min(max(c.volts / c.squares, c.least), c.greatest)",
        "c.volts / c.squares",
        DRIVE_TESTS,
    ),
    ("a reversed magnet trips", GUARD, "if reversed:", "if False:", "tests/runtime/tick/test_hall_loop.py"),
    ("damping brakes", PASSIVITY, "out[i] -= q.damping *", "out[i] += q.damping *", PASSIVITY_TESTS),
    ("damping is bounded", PASSIVITY, "min(most, -balance * passed / square)", "1e3 * most", PASSIVITY_TESTS),
    ("active worlds are left alone", PASSIVITY, "if q.passive and balance < 0.0", "if balance < 0.0", PASSIVITY_TESTS),
    (
        "late poses meet the forces of their time",
        PASSIVITY,
        "_average(q, q.stamp - q.lag, stamp - q.lag)",
        "_average(q, q.stamp + late, stamp + late)",
        PASSIVITY_TESTS,
    ),
    ("duties are bounded", DRIVE, "if largest > 1.0:", "if False:", DRIVE_TESTS),
    (
        "a silent host is dead",
        "runtime/processes/loop.py",
        "if silence > _LATE:",
        "if False:",
        "tests/runtime/processes/test_loop.py",
    ),
    (
        "a stopped host is dead within 100 ms",
        "runtime/realtime/host_heartbeat.py",
        'if self._state() in ("T", "t"):',
        "if False:",
        "tests/runtime/realtime/test_host_heartbeat.py",
    ),
    (
        "a host that computes is not taken for dead",
        "runtime/realtime/host_heartbeat.py",
        'if self._state() in ("T", "t"):',
        "if True:",
        "tests/runtime/realtime/test_host_heartbeat.py",
    ),
    (
        "a world that hears nothing is told",
        CHILDREN,
        "self._hang = _HANG.format(world, still)",
        "pass",
        HOSTILE_TESTS,
    ),
    (
        "a servo that hangs ends without its host",
        "runtime/realtime/kill_timer.py",
        "signal=int(signal.SIGKILL)",
        "signal=int(signal.SIGWINCH)",
        HOSTILE_TESTS,
    ),
    (
        "a forked world is no second loop",
        "runtime/processes/servo_process.py",
        "partial(os._exit, _FORKED)",
        "int",
        HOSTILE_TESTS,
    ),
    (
        "what a world started ends with it",
        CHILDREN,
        "os.killpg(self._servo.pid, signal.SIGKILL)",
        "pass",
        HOSTILE_TESTS,
    ),
    (
        "a world that leaves by sys.exit trips",
        TICK,
        "except BaseException as cause:  # a world",
        "except Exception as cause:  # a world",
        TICK_TESTS,
    ),
    ("a stalled recorder is told", CHILDREN, "if writing and still > _STALLED else", "if False else", STALLED_TESTS),
    (
        "the living keep their files",
        "runtime/realtime/stale_files.py",
        "fcntl.LOCK_EX | fcntl.LOCK_NB",
        "fcntl.LOCK_UN",
        LEFTOVER_TESTS,
    ),
    (
        "an engage that was asked for before a stop is void",
        "runtime/processes/loop.py",
        "if engage_stops(engage) == stops & 0xFFFF_FFFF:",
        "if True:",
        "tests/runtime/processes/test_loop.py",
    ),
    (
        "what stopped before the first pose is not cleared by the tracker",
        PROTECTION,
        "if self._state[0] == _OFF:",
        "if self.gain == 0.0:",
        TICK_TESTS,
    ),
    ("missed deadlines trip", GUARD, "if clock.overrun:", "if False:", TICK_TESTS),
    ("after a silence the ramp begins again", GUARD, "elif clock.restart:", "elif False:", TICK_TESTS),
    (
        "windings heat by the clock",
        PROTECT,
        "observe_heat(heat, coils, clock.elapsed)",
        "observe_heat(heat, coils, clock.period)",
        TICK_TESTS,
    ),
    ("a sensor that lies trips", PROTECT, "elif not plausible:", "elif False:", TICK_TESTS),
    (
        "a sensor that reads too little is found by the resistance that it makes",
        "control/protection/current_check.py",
        " and _LOWEST <= c.ratio <= _HIGHEST",
        "",
        "tests/control/protection/test_current_check.py",
    ),
    (
        "a silent loop finds the simulated coils off",
        "runtime/drivers/simulated.py",
        "if passed > self._silence + 1e-9:",
        "if False:",
        TICK_TESTS,
    ),
    ("a world that fails trips", TICK, "self._failed(Trip.WORLD_FAILED, cause)", "pass", TICK_TESTS),
    (
        "a driver that fails trips",
        TICK,
        "self._failed(Trip.DRIVER_FAILED, cause)\n            self._off",
        "self._off",
        TICK_TESTS,
    ),
    (
        "a driver that fails while preparing trips in the tick, and does not end the loop",
        TICK,
        "with suppress(HaptorbError):  # `read`",
        "if True:  # `read`",
        TICK_TESTS,
    ),
    (
        "what was prepared is not handed over once the driver is closed",
        "runtime/drivers/simulated.py",
        "self._ready = None\n        self._open = False",
        "self._open = False",
        "tests/runtime/drivers/test_simulated.py",
    ),
    ("an allocation that fails trips", TICK, "self._failed(Trip.CURRENTS_NOT_FINITE, cause)", "pass", TICK_TESTS),
    (
        "off means zero duties",
        PROTECT,
        "if g.gain > 0.0:",
        "if True:",
        TICK_TESTS,
    ),
    (
        "dead sensors are no weak magnets",
        "sensing/orientation/gauss_newton.py",
        "if wanted != strength:",
        "if False:",
        ORIENTATION_TESTS,
    ),
    (
        "readings that cannot be are left out",
        "sensing/orientation/readings.py",
        "if square <= limit * limit and np.isfinite(total):",
        "if True:",
        MAP_TESTS,
    ),
    (
        "networks of another device are refused",
        "sensing/torque_maps/network.py",
        "if self.digest != motor.digest:",
        "if False:",
        MAP_TESTS,
    ),
    (
        "a field that nothing explains is no start",
        "sensing/orientation/cold_start.py",
        "residual <= _POOR * rms and 2 * outliers <= count",
        "True",
        ORIENTATION_TESTS,
    ),
    (
        "a field that nothing explains ends the tracking",
        "sensing/orientation/least_squares.py",
        "or not rms * rms <= _POOR * _POOR * square / (3.0 * count)",
        "",
        ORIENTATION_TESTS,
    ),
    (
        "poses that are not finite are refused",
        "runtime/trackers/pose_filter.py",
        "if not isfinite(sum(map(abs, heard.p)) + sum(map(abs, heard.q))):",
        "if False:",
        TRACKER_TESTS,
    ),
    (
        "poses in millimetres are refused",
        "runtime/trackers/pose_filter.py",
        "if sqrt(sum(x * x for x in heard.p)) > _REACH:",
        "if False:",
        TRACKER_TESTS,
    ),
    (
        "a pose that jumped is lost",
        "runtime/trackers/pose_filter.py",
        "self._block.write(self._last._replace(valid=False, stamp=pose.stamp))",
        "pass",
        FEED_TESTS,
    ),
    (
        "a jump is seen",
        "runtime/trackers/pose_filter.py",
        "float(way @ way) > (_FASTEST * passed) ** 2",
        "False",
        FEED_TESTS,
    ),
    ("one sender per tracker", "runtime/trackers/osc_feed.py", "if sender != self._sender:", "if False:", FEED_TESTS),
    (
        "another sender comes through a loss",
        "runtime/trackers/osc_feed.py",
        "if arrival < self._heard_from:",
        "if False:",
        FEED_TESTS,
    ),
    (
        "poses that come late are refused",
        "runtime/trackers/pose_filter.py",
        "not heard.stamp > self._stamp",
        "False",
        TRACKER_TESTS,
    ),
    (
        "a tracker that lost the tool says so",
        "runtime/trackers/pose_filter.py",
        "self._block.write(before._replace(valid=False, stamp=heard.stamp))",
        "pass",
        TRACKER_TESTS,
    ),
    (
        "prediction has an end",
        "runtime/trackers/fed_tracker.py",
        "min(max(age, 0.0), self._prediction)",
        "max(age, 0.0)",
        TRACKER_TESTS,
    ),
    (
        "a predicted pose does not grow younger",
        "runtime/trackers/fed_tracker.py",
        "return min(stamp, now)",
        "return now",
        TRACKER_TESTS,
    ),
    (
        "no pose was measured after it came",
        SENDER,
        "return min(sent + min(self._least, self._before), arrival)",
        "return sent + min(self._least, self._before)",
        SENDER_TESTS,
    ),
    (
        "a sender's number that tells no time is not believed",
        SENDER,
        "if ulp(sent) > _COARSEST:",
        "if False:",
        SENDER_TESTS,
    ),
    (
        "a sender beyond this computer needs the token",
        "runtime/trackers/osc_feed.py",
        "if self._token:",
        "if False:",
        FEED_TESTS,
    ),
    (
        "a replay never moves a real device",
        "runtime/trackers/tracker_registry.py",
        "if kind is _Replay and is_real(driver):",
        "if False:",
        FEED_TESTS,
    ),
    (
        "a left-handed tracker is refused",
        "sensing/frame/frame_checks.py",
        "if right > _APART / 2 and left < 0.3 * right:",
        "if False:",
        FRAME_TESTS,
    ),
    (
        "a tracker in millimetres is no frame",
        "sensing/frame/frame_checks.py",
        "if abs(scale - 1.0) <= _SCALE:",
        "if True:",
        FRAME_TESTS,
    ),
    (
        "a rehearsed frame moves no real device",
        "runtime/trackers/tracker_registry.py",
        "if frame.simulated and is_real(driver):",
        "if False:",
        FRAMED_TESTS,
    ),
    (
        "a frame is of one tracker",
        "sensing/frame/tracker_frame.py",
        "if self.tracker != tracker:",
        "if False:",
        FRAMED_TESTS,
    ),
    (
        "a board whose sensors have one axis cannot steer by the field",
        SERIAL,
        "if identity.hall_axes < self._hall_axes:",
        "if False:",
        SERIAL_TESTS,
    ),
    (
        "chips whose sensors have one axis cannot steer by the field",
        "runtime/drivers/i2c/i2c_driver.py",
        "if axes < needed:",
        "if False:",
        "tests/runtime/drivers/i2c/test_i2c_driver.py",
    ),
    (
        "at rest the device is asked and never set",
        SERIAL,
        "board.post(None)  # so that the next tick need not wait for all of the answer",
        "board.post(self._steps)",
        SERIAL_TESTS,
    ),
    (
        "a servo that waits for its plan ends with its host",
        "runtime/processes/servo_process.py",
        "    if not told:\n",
        "    while not told:\n        pass\n    if False:\n",
        "tests/runtime/processes/test_prestart.py",
    ),
    (
        "a tool that is only carried on is lost soon",
        "sensing/tool/tool_position.py",
        "self._found and sample.t - self._t <= _CARRIED",
        "self._found",
        "tests/sensing/tool/test_tool_position.py",
    ),
    (
        "who waits for an answer is not silent",
        SERIAL,
        "            board.repeat(self._steps if self._engaged else None)",
        "            pass",
        SERIAL_TESTS,
    ),
    (
        "only this computer's silence is forgiven while a coil is heated",
        "apps/calibrate/heating.py",
        "except HostSilent as cause:",
        "except Exception as cause:",
        "tests/apps/calibrate/test_heating.py",
    ),
    (
        "a heated coil is not engaged again for ever",
        "apps/calibrate/heating.py",
        "if lost > _LOST * (hot + cool):",
        "if False:",
        "tests/apps/calibrate/test_heating.py",
    ),
    (
        "a firmware's trip latches in the driver",
        SERIAL,
        "self._armed = self._engaged = False",
        "self._armed, self._engaged = True, False",
        SERIAL_TESTS,
    ),
    (
        "a firmware that restarted is not driven on",
        "runtime/drivers/serial/messages.py",
        "if engaged and reading.standing is Standing.OFF:",
        "if False:",
        SERIAL_TESTS,
    ),
    (
        "a damaged frame is none",
        "runtime/drivers/serial/frames.py",
        "if _check(line, at + 2, last) != line[last] | line[last + 1] << 8:",
        "if False:",
        "tests/runtime/drivers/serial/test_frames.py",
    ),
    (
        "a calibration does not go on behind a failed step",
        "apps/calibrate/measure.py",
        "if not 1 / _FACTOR < ratio < _FACTOR:",
        "if False:",
        GUIDED_TESTS,
    ),
    (
        "a tool whose magnet is reversed is refused",
        "apps/calibrate/steps.py",
        "if likeness < 0.0:",
        "if False:",
        GUIDED_TESTS,
    ),
    (
        "a participant's page cannot steer",
        PAGES,
        "elif do in _PARTICIPANT:",
        "elif True:",
        PAGES_TESTS,
    ),
    (
        "an experimenter's page needs the token",
        PAGES,
        'if not secrets.compare_digest(given.encode("utf-8", "replace"), self._token.encode()):',
        "if False:",
        PAGES_TESTS,
    ),
    (
        "a participant's page that goes away pauses",
        PAGES,
        "if page.participant and self._participants[0] is page:",
        "if False:",
        PAGES_TESTS,
    ),
    (
        "a pause in a study switches the coils off",
        "apps/study/session/trial_runner.py",
        "self.halt.stop(why)",
        "pass",
        "tests/apps/study/session/test_terminal_session.py",
    ),
    ("a study's Stop waits for no queue and no database", PAGES, "if asks_to_stop(text):", "if False:", STOP_TESTS),
    (
        "ending a study session waits for no database with the coils on",
        PAGES,
        "elif found := _STOPS.search(text):",
        "elif found := None:",
        STOP_TESTS,
    ),
    (
        "no message of a study page takes Stop from it",
        PAGES,
        "except Exception as fault:  # whatever it holds",
        "except KeyError as fault:  # whatever it holds",
        STOP_TESTS,
    ),
    (
        "what was asked for in a study before a Stop is dropped, and told",
        HALT,
        "if asked.number != self._last:",
        "if False:",
        STOP_TESTS,
    ),
    (
        "a Stop that comes while a study switches on holds",
        HALT,
        "servo.engage(asked.stops)",
        "servo.engage()",
        "tests/apps/study/test_interleavings.py",
    ),
    (
        "a Stop while a study's device starts holds",
        HALT,
        "        if self.stands:\n            servo.stop()",
        "        if False:\n            servo.stop()",
        STOP_TESTS,
    ),
    (
        "a study's thread outlives a fault, with the coils off",
        "apps/study/pages/reception.py",
        "except BaseException as fault:\n            # Nobody",
        "except KeyboardInterrupt as fault:\n            # Nobody",
        STOP_TESTS,
    ),
    (
        "a key at the terminal stops while the session waits",
        "apps/study/session/keys.py",
        'self._halt.stop("at the terminal")',
        "pass",
        STOP_TESTS,
    ),
    (
        "a stop while the servo starts counts",
        "runtime/processes/loop.py",
        "self._stopped = 0  #",
        "self._stopped = shared.words[Word.STOP]  #",
        "tests/runtime/servo/test_servo.py",
    ),
    (
        "console: no token, no entry",
        "apps/web/gate.py",
        "not knows(headers, self._token)",
        "False",
        "tests/apps/web/test_token.py",
    ),
    ("console: a stop takes an engage back", CONSOLE, "page, self._servo.stops)", "page, None)", CONSOLE_TESTS),
    (
        "console: a stop cancels what waits",
        CONSOLE,
        "self._servo.stop()\n        self._do_not_engage()",
        "self._servo.stop()",
        CONSOLE_TESTS,
    ),
    ("console: a stop before any check", CONSOLE, "if asks_to_stop(text):", "if False:", CONSOLE_TESTS),
    (
        "i2c: reading tries to switch off until the chip confirms it",
        SWITCH,
        "        if self.state is not CoilState.OFF:\n            self.off()\n        elif",
        "        if",
        I2C_TESTS,
    ),
    (
        "i2c: writing tries to switch off until the chip confirms it",
        I2C,
        "if self._fault and switch.state is not CoilState.OFF:",
        "if False:",
        I2C_TESTS,
    ),
    (
        "i2c: off is not said before the chip confirms it",
        SWITCH,
        "        self.state = CoilState.UNKNOWN\n        with suppress",
        "        self.state = CoilState.OFF\n        with suppress",
        I2C_TESTS,
    ),
    (
        "i2c: a chip that does not obey is not called off",
        "runtime/drivers/i2c/pca9685.py",
        "as_set_up and all(high & _FULL for high in block[_OFF_HIGH])",
        "as_set_up",
        I2C_TESTS,
    ),
    (
        "i2c: a chip that lost its supply is set up before it is believed",
        "runtime/drivers/i2c/pca9685.py",
        "return as_set_up and all(",
        "return all(",
        I2C_TESTS,
    ),
    (
        "i2c: nobody engages before off is confirmed",
        SWITCH,
        "if self.state is not CoilState.OFF and not self.off():",
        "if False:",
        I2C_TESTS,
    ),
    (
        "i2c: closing without a confirmation complains",
        SWITCH,
        "        if self.state is CoilState.OFF:\n            if watcher",
        "        if True:\n            if watcher",
        I2C_TESTS,
    ),
    ("i2c: zero duties are confirmed as off", I2C, "self._clock() - self._idle > _IDLE", "False", I2C_TESTS),
    (
        "i2c: the guardian tries until the chip confirms it",
        GUARDIAN,
        "        wait(_AGAIN)",
        "        return",
        I2C_TESTS,
    ),
    ("i2c: the guardian answers", GUARDIAN, 'os.write(answers, b".")', "pass", I2C_TESTS),
    (
        "i2c: a guardian that does not answer trips",
        GUARDIAN,
        "if engaged and now - self._heard > ANSWER:",
        "if False:",
        I2C_TESTS,
    ),
    (
        "i2c: without a monostable nothing opens",
        I2C,
        "            if self._watchdog:\n                output_enable.pulse",
        "            if False:\n                output_enable.pulse",
        I2C_TESTS,
    ),
    (
        "i2c: a monostable that was bridged is noticed when engaging",
        I2C,
        "            if self._watchdog:\n                output_enable.ready",
        "            if False:\n                output_enable.ready",
        I2C_TESTS,
    ),
    (
        "i2c: every trigger is an edge",
        "runtime/drivers/i2c/tca9534.py",
        "bytes((_OUTPUT, axis, axis | _TRIGGER))",
        "bytes((_OUTPUT, axis | _TRIGGER))",
        I2C_TESTS,
    ),
    (
        "i2c: a second program is refused",
        "runtime/drivers/i2c/i2c_lock.py",
        "fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)",
        "pass",
        LOCK_TESTS,
    ),
    (
        "i2c: a lock without a name excludes nobody",
        "runtime/drivers/i2c/i2c_lock.py",
        "if os.path.samestat(os.stat(self._path), os.fstat(descriptor)):",
        "if True:",
        LOCK_TESTS,
    ),
    (
        "i2c: probing switches off before it enables the outputs",
        "apps/hardware/probe.py",
        "Pca9685(bus).setup()",
        "pass",
        "tests/apps/test_hardware.py",
    ),
    (
        "serial: a board that does not answer leaves the coils' state unknown",
        SERIAL,
        "            self._coils = CoilState.UNKNOWN\n            if board",
        "            if board",
        SERIAL_TESTS,
    ),
]


def proved(file: str, kept: str, broken: str, tests: str) -> bool:
    """Whether `tests` go red when `kept` is replaced by `broken` in `file`."""
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "src"
        shutil.copytree(ROOT / "src", sources, ignore=shutil.ignore_patterns("__pycache__"))
        path = sources / "haptorb" / file
        text = path.read_text(encoding="utf-8")
        if text.count(kept) < 1:
            raise SystemExit(f"{file} no longer has the code that keeps this rule: {kept!r}")
        path.write_text(text.replace(kept, broken, 1), encoding="utf-8")
        environment = {**os.environ, "PYTHONPATH": str(sources), "NUMBA_CACHE_DIR": str(Path(folder) / "cache")}
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", tests],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return run.returncode == 1


def main() -> int:
    """Prove every chosen rule; the exit code is the number of rules that no test keeps."""
    words, unproved = sys.argv[1:], 0
    chosen = [proof for proof in PROOFS if not words or any(word in proof[0] or word in proof[1] for word in words)]
    if not chosen:
        sys.exit(f"no rule, and no file of one, has {' or '.join(repr(word) for word in words)} in its name")
    for rule, *proof in chosen:
        red = proved(*proof)
        unproved += not red
        print(f"{'red, as it must be' if red else 'STILL GREEN':>20}  {rule}", flush=True)
    print(f"{len(chosen) - unproved} of {len(chosen)} rules are kept by a test")
    return unproved


if __name__ == "__main__":
    sys.exit(main())
