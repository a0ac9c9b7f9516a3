"""Break the safety code once per rule and check that a test fails.

    python scripts/prove_safety.py [--jobs N] [--skip FILE] [WORD…]

With words: only the rules in whose name, or whose marker or file, one of them stands.
A test that cannot fail proves nothing; a test of the nightly run is no proof. Each line of RULES is the name of a
marker in the code (`# safety: NAME`), the rule that the marked statement keeps, how it is broken (see
`safety_markers.py`) and the tests that must go red; the change is made in a copy of the sources, never in the tree
itself.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

sys.path.insert(0, str(Path(__file__).parent))

from safety_markers import MarkedStatement, MarkerError, break_code, find_marked

from haptorb.cache_folder import cache_folder

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src"

GUIDED_TESTS = "tests/cli/calibrate/test_dialog.py"
POISONED, DATABASES = "tests/contracts/test_poisoned_files.py", "tests/contracts/test_strangers_databases.py"
POISONED_TEST = f"{POISONED}::test_text_of_a_strangers_file_is_shown_and_does_nothing"
KIND_TEST = "tests/contracts/test_file_kinds.py::test_a_file_of_another_kind_is_called_by_its_name[info FILE]"
SCENE_TESTS = "tests/worlds/scene/test_strangers_scenes.py"
OUTSIDE_TEST, ARCHIVE_TEST = "test_no_form_of_a_name_reads_outside", "test_an_archive_is_refused_by_its_content"
COMPILER_TEST = "test_the_compiler_opens_nothing_even_if_the_check_missed_it"
SIZE_TEST = "test_a_scene_asks_for_no_more_than_there_can_be"
TIME_TEST, MEMORY_TEST = "test_a_compiler_that_takes_too_long_is_ended", "test_a_compiler_that_takes_too_much_is_ended"
CACHE_TESTS = "tests/test_cache_folder.py"
CONSOLE_TESTS, PAGES_TESTS = "tests/web/console/test_socket_hub.py", "tests/study/pages/test_pages.py"
MERGE_TESTS = "tests/study/database/test_merge.py"
STOP_TESTS, EXPORT_TESTS = "tests/study/test_stop.py", "tests/study/database/test_export.py"
TERMINAL_TESTS = "tests/study/session/test_terminal_session.py"
HOSTILE, TRACKER_TESTS = "tests/contracts/test_hostile_files.py", "tests/contracts/test_trackers.py"
DRIVE_TESTS, GUARD_TESTS = "tests/control/protection/test_drive.py", "tests/control/protection/test_guard.py"
HEAT_TESTS = "tests/control/protection/test_heat.py"
PASSIVITY_TESTS = "tests/control/protection/test_passivity.py"
WALL_TESTS = "tests/analysis/stability/test_wall.py"
I2C_TESTS, LOCK_TESTS = "tests/runtime/drivers/i2c/test_i2c_faults.py", "tests/runtime/drivers/i2c/test_i2c_lock.py"
SERIAL_TESTS = "tests/runtime/drivers/serial/test_serial_driver.py"
HOSTILE_TESTS = "tests/runtime/test_hostile_worlds.py"
STALLED_TESTS = "tests/runtime/test_stalled_recorder.py"
HAND_TESTS = "tests/runtime/servo/test_hand.py"
LEFTOVER_TESTS = "tests/runtime/linux/test_stale_files.py"
IMPORT_TESTS, END_TESTS = "tests/test_child_process.py", "tests/runtime/servo/test_ends.py"
ASYNC_TESTS = "tests/runtime/servo/test_async.py"
PART_TESTS = "tests/runtime/tick/test_rendered_part.py"
MEMORY_TESTS, TICK_TESTS = "tests/runtime/tick/test_memory.py", "tests/runtime/tick/test_tick.py"
FEED_TESTS, FRAMED_TESTS = "tests/runtime/trackers/test_trackers.py", "tests/runtime/trackers/test_framed_feed.py"
SENDER_TESTS = "tests/runtime/trackers/test_sender_clock.py"
FRAME_TESTS = "tests/estimation/tracker_frame/test_frame_registration.py"
NATIVE_TESTS = "tests/serve/native/test_server.py"
CLIENT_TESTS, GRIPPER_TESTS = "tests/runtime/tick/test_client_force.py", "tests/control/test_gripper_guard.py"
OSC_TESTS = "tests/serve/osc/test_osc_session.py::test_without_the_token_nothing_happens"
SERVED_TESTS, ACCESS_TESTS = "tests/serve/test_served_device.py", "tests/serve/test_server_choice.py"
OSC_LATE_TESTS = "tests/serve/osc/test_osc_session.py::test_what_waited_in_the_socket_is_not_felt_and_changes_no_world"
LSL_TESTS = "tests/runtime/trackers/test_lsl_streams.py"
SECRET_TESTS = "tests/runtime/trackers/test_tracker_accounts.py"
PASS_TESTS, HANDOVER_TESTS = "tests/control/protection/test_pass_over.py", "tests/serve/test_handover.py"
ACCOUNT_TESTS, OWNER_TESTS = "tests/serve/test_other_accounts.py", "tests/runtime/test_socket_owner.py"
FOREIGN = "tests/contracts/test_foreign_recordings.py"
BAD_RECORDINGS = "tests/replay/test_bad_recordings.py"
STARTED_TESTS = "tests/worlds/user_world/test_started_code.py"
REMOTE_TESTS, BLOCK_TESTS = "tests/worlds/test_remote.py", "tests/runtime/shared_memory/test_force_block.py"
ORIENTATION_TESTS = "tests/estimation/motor_orientation/test_least_squares.py"
MAP_TESTS = "tests/estimation/network/test_torque_maps.py"

#: (marker in the code, rule, mutation, tests that must go red)
RULES = [
    (
        "start-hangs",
        "a process that hangs while it starts is refused",
        "replace value by False",
        f"{END_TESTS}::test_a_process_that_hangs_while_it_starts_is_refused_in_time",
    ),
    (
        "start-sends-beside",
        "a process that does not read at its start blocks nobody",
        "replace value by one.process.stdin.write(pack(spec))",
        f"{END_TESTS}::test_a_server_that_hangs_while_it_starts_is_refused_in_time[pmsm]",
    ),
    (
        "regular-file",
        "what is opened is a regular file",
        "never",
        f"{HOSTILE}::test_names_that_no_file_can_have_are_refused",
    ),
    ("file-size", "a file of text has an end", "never", f"{HOSTILE}::test_a_file_of_text_has_an_end"),
    ("text-visible", "text of a file is printed visibly", "replace value by text", f"{POISONED_TEST}[info run.mcap]"),
    (
        "no-formula",
        "a name in a figure is no formula",
        "drop",
        f"{POISONED}::test_a_formula_in_a_name_is_shown_as_it_is_in_every_figure",
    ),
    ("cell-visible", "text of a table's cell is visible", "drop", f"{POISONED_TEST}[study export study.db trials.csv]"),
    (
        "foreign-column",
        "a recording names columns with letters",
        "replace value by world + '.' + field['name']",
        f"{POISONED}::test_heads_of_a_table_and_members_of_an_archive_are_plain",
    ),
    (
        "kind-told",
        "a file of another kind is called by its name",
        "always",
        KIND_TEST,
    ),
    ("named-inside", "a scene reads no file elsewhere", "never", SCENE_TESTS),
    ("scene-checked", "a scene is looked at before MuJoCo sees it", "replace value by {}", SCENE_TESTS),
    ("plain-names", "a name that MuJoCo reads otherwise is refused", "never", f"{SCENE_TESTS}::{OUTSIDE_TEST}"),
    ("no-archive", "an archive in a scene is refused", "never", f"{SCENE_TESTS}::{ARCHIVE_TEST}"),
    ("compiler-opens-nothing", "MuJoCo opens no file while it compiles", "drop", f"{SCENE_TESTS}::{COMPILER_TEST}"),
    ("scene-elements", "a scene has no more elements than there can be", "never", f"{SCENE_TESTS}::{SIZE_TEST}"),
    ("compile-time", "a compiler that takes too long is ended", "drop", f"{SCENE_TESTS}::{TIME_TEST}"),
    ("compile-memory", "a compiler that takes too much memory is ended", "drop", f"{SCENE_TESTS}::{MEMORY_TEST}"),
    ("compiled-apart", "a scene is compiled in a process of its own", "always", f"{SCENE_TESTS}::{MEMORY_TEST}"),
    (
        "database-link",
        "a link beside a database is not obeyed",
        "never",
        f"{DATABASES}::test_files_beside_a_database_do_nothing",
    ),
    (
        "database-journal",
        "a journal beside a database is not obeyed",
        "always",
        f"{DATABASES}::test_files_beside_a_database_do_nothing",
    ),
    (
        "database-lock",
        "a lock file beside a database is empty, with nothing beside it",
        "drop",
        f"{DATABASES}::test_a_lock_file_of_a_stranger_is_not_obeyed",
    ),
    (
        "database-schema",
        "a database computes nothing",
        "never",
        f"{DATABASES}::test_a_schema_that_computes_is_not_opened",
    ),
    ("database-rows", "a value is of its column's type", "never", f"{DATABASES}::test_a_damaged_field_is_one_message"),
    ("results-checked", "results name no file", "drop", f"{DATABASES}::test_results_of_a_stranger_name_no_file"),
    (
        "recording-beside",
        "a recording lies beside its database",
        "replace value by part",
        f"{DATABASES}::test_the_recordings_of_a_database_lie_beside_it",
    ),
    ("cache-own", "a kernel is kept where only its owner writes", "never", CACHE_TESTS),
    ("cache-private", "a cache that others can write is not used", "always", CACHE_TESTS),
    (
        "private-temporary",
        "what is executed lies in no folder that others can rename",
        "always",
        f"{CACHE_TESTS}::test_what_is_executed_lies_in_no_temporary_folder_that_others_may_rename",
    ),
    (
        "no-current-folder",
        "a child imports nothing from the current folder",
        'replace value.elts[1] by "-u"',
        f"{IMPORT_TESTS}::test_a_child_runs_nothing_from_the_current_folder",
    ),
    (
        "isolated-child",
        "a child that needs nothing of the user's is isolated",
        'replace value.elts[1] by "-u"',
        f"{IMPORT_TESTS}::test_an_isolated_child_runs_nothing_from_the_users_path_either",
    ),
    (
        "no-empty-entry",
        "an empty entry of PYTHONPATH is not the current folder",
        'replace value by found["PYTHONPATH"]',
        f"{IMPORT_TESTS}::test_an_empty_entry_of_the_path_is_not_the_current_folder",
    ),
    (
        "folders-last",
        "the folders of the host's modules come last in a child",
        "replace value by sys.path.insert(0, folder)",
        f"{IMPORT_TESTS}::test_what_a_host_sends_hides_nothing",
    ),
    (
        "spawned-without-folder",
        "multiprocessing's children import nothing from the current folder",
        "replace items[0].context_expr by _changing",
        f"{IMPORT_TESTS}::test_a_spawned_worker_runs_nothing_from_the_current_folder",
    ),
    (
        "no-local-numba-settings",
        "numba takes no folder of compiled code from the current folder",
        "drop",
        f"{IMPORT_TESTS}::test_numba_reads_no_settings_from_the_current_folder",
    ),
    (
        "no-local-matplotlibrc",
        "Matplotlib reads no settings from the current folder",
        "drop",
        f"{IMPORT_TESTS}::test_matplotlib_reads_no_settings_from_the_current_folder",
    ),
    (
        "no-local-lsl-settings",
        "streams on the network are configured by no file of the current folder",
        "never",
        "tests/study/session/test_lsl_streams.py::test_the_network_is_configured_by_no_file_of_the_current_folder",
    ),
    (
        "stop-first",
        "every end of a run begins with coils off",
        "drop",
        f"{END_TESTS}::test_leaving_the_block_switches_off_first",
    ),
    (
        "async-stop-first",
        "every end of a run in an event loop begins with coils off",
        "drop",
        f"{ASYNC_TESTS}::test_the_coils_are_off_before_anything_else_ends",
    ),
    (
        "console-loop-first",
        "an end of the console's server waits for no thread with the coils on",
        "drop",
        "tests/web/console/test_console.py::test_whatever_ends_the_server_the_coils_are_off_before_its_threads_end",
    ),
    (
        "output-queued",
        "a terminal that does not read delays no end",
        "replace value by self._stream.write(text) and self._stream.flush()",
        f"{END_TESTS}::test_a_terminal_that_does_not_read_delays_no_end",
    ),
    (
        "signal-stop",
        "a signal is a Stop in the middle of other code",
        "replace value by -1",
        f"{END_TESTS}::test_a_signal_in_the_middle_of_other_code_is_a_stop_within_ticks",
    ),
    (
        "signal-sides",
        "a signal that comes while others are read is not lost",
        "drop",
        f"{END_TESTS}::test_ctrl_c_beside_other_signals_is_not_lost",
    ),
    (
        "no-password-in-words",
        "an address with a password is refused",
        "never",
        "tests/cli/test_passwords.py",
    ),
    (
        "signal-read",
        "the loop obeys a signal of its host",
        "never",
        f"{END_TESTS}::test_a_signal_in_the_middle_of_code_that_lets_no_thread_run_is_a_stop",
    ),
    (
        "absence-trips",
        "a loop that was absent for half a second trips",
        "replace value by False",
        f"{GUARD_TESTS}::test_a_loop_that_was_absent_for_half_a_second_waits_for_a_person",
    ),
    (
        "unit-read",
        "units are read and not evaluated",
        "replace value by _registry().parse_units(name)",
        f"{HOSTILE}::test_a_unit_is_read_and_not_evaluated",
    ),
    (
        "list-no-number",
        "a list is no number of a world",
        "only 2",
        f"{HOSTILE}::test_a_number_is_a_number_wherever_a_world_is_changed",
    ),
    (
        "chunk-size",
        "a chunk of a recording is asked for its size before it is made",
        "never",
        f"{HOSTILE}::test_a_chunk_that_says_it_is_a_gigabyte_is_refused_before_it_is_made",
    ),
    (
        "repair-keeps-input",
        "a repaired recording is never written over the damaged one",
        "never",
        "tests/recording/test_damaged_recordings.py::test_a_repaired_file_is_whole_for_the_makers_reader",
    ),
    (
        "resumed-resistance",
        "an unfinished calibration with a resistance that no coil has is not continued",
        "never",
        "tests/cli/calibrate/test_progress_file.py",
    ),
    (
        "main-ended",
        "a loop does not outlive the main thread that opened it",
        "never",
        f"{END_TESTS}::test_the_end_of_the_main_thread_is_the_end_of_the_loop_though_other_threads_go_on",
    ),
    (
        "output-not-linked",
        "a link beside a stranger's database does not choose where a command writes",
        "never",
        "tests/contracts/test_strangers_databases.py::test_the_links_beside_a_database_are_not_written_through",
    ),
    (
        "port-not-replaced",
        "an emulated port takes the place of no other file",
        "never",
        "tests/cli/test_hardware.py::test_an_emulated_port_replaces_no_file_and_no_other_link",
    ),
    (
        "black-box-own",
        "only files that a black box wrote make room for newer ones",
        "replace value by path.suffix == '.mcap'",
        "tests/runtime/test_black_box.py::test_a_persons_own_recordings_in_the_folder_stay",
    ),
    (
        "recording-mode",
        "a recording is as open as the umask says",
        "only 1 of value.args[1].orelse",
        f"{HOSTILE}::test_a_recording_is_as_open_as_its_owner_wants_files",
    ),
    ("eeprom-kept", "an id is kept when the EEPROM has it", "replace test.values[1] by False", SERIAL_TESTS),
    (
        "pointer-bridged",
        "a page that stutters for too long loses the mover",
        "always",
        "tests/web/console/test_pointer_relay.py",
    ),
    ("cool-simulated", "real coils stay as warm as they are", "always", "tests/runtime/tick/test_cooling.py"),
    ("excuse-simulated", "a real device trips on a busy computer", "always", "tests/runtime/test_loop.py"),
    ("host-silent", "a silent host is dead", "never", "tests/runtime/test_loop.py"),
    ("host-stopped", "a stopped host is dead within 100 ms", "never", "tests/runtime/test_liveness.py"),
    (
        "host-computing",
        "a host that computes is not taken for dead",
        "always",
        "tests/runtime/test_liveness.py",
    ),
    ("host-starved", "a host that waits for ever is dead", "never", "tests/runtime/test_liveness.py"),
    (
        "host-starved-real",
        "real coils do not wait for a busy host",
        "replace value by True",
        "tests/runtime/test_loop.py",
    ),
    ("world-hung", "a world that hears nothing is told", "drop", HOSTILE_TESTS),
    ("servo-hung", "a servo that hangs ends without its host", "replace value.keywords[0].value by 28", HOSTILE_TESTS),
    ("world-forked", "a forked world is no second loop", "drop", HOSTILE_TESTS),
    ("world-children", "what a world started ends with it", "drop", HOSTILE_TESTS),
    ("recorder-stalled", "a stalled recorder is told", "never", STALLED_TESTS),
    ("leftovers-swept", "what dead programs left is removed", "drop", LEFTOVER_TESTS),
    (
        "few-connections",
        "connections that ask for something are few",
        "never",
        "tests/web/console/test_hostile.py",
    ),
    ("living-files", "the living keep their files", "drop", LEFTOVER_TESTS),
    (
        "engage-void",
        "an engage that was asked for before a stop is void",
        "always",
        "tests/runtime/test_loop.py",
    ),
    (
        "simulated-watchdog",
        "a silent loop finds the simulated coils off",
        "never",
        f"{TICK_TESTS}::test_after_a_pause_of_the_computer_the_force_comes_back_from_zero",
    ),
    (
        "prepared-dropped",
        "what was prepared is not handed over once the driver is closed",
        "drop",
        "tests/runtime/drivers/test_sim_driver.py",
    ),
    ("client-silence-fades", "a client that falls silent leaves no force", "without 1", REMOTE_TESTS),
    ("client-loss-fades", "a client whose connection is lost leaves no force", "without 2", REMOTE_TESTS),
    ("client-force-finite", "a client's force that is no number is none", "always", REMOTE_TESTS),
    ("client-force-limit", "no force of a client is greater than the world's limit", "only 1 of value", REMOTE_TESTS),
    ("client-torque-finite", "a client's torque that is no number is none", "always", REMOTE_TESTS),
    ("client-gripper-finite", "nor is its gripper force", "always", REMOTE_TESTS),
    ("client-gripper-limit", "nor is it greater than the world's limit", "replace value by fade * force", REMOTE_TESTS),
    (
        "client-fades-from-limit",
        "a client's force above the device's is gone in the same time",
        "replace value by (100.0, 10.0)",
        CLIENT_TESTS,
    ),
    ("gripper-off-with-coils", "the gripper's force is off with the coils", "never", GRIPPER_TESTS),
    ("gripper-clamped", "it is no greater than the gripper's", "replace value.body by wanted", GRIPPER_TESTS),
    ("gripper-force-rate", "and changes at its rate", "replace value by goal - self._force", GRIPPER_TESTS),
    ("gripper-closed", "a closed driver squeezes nothing", "replace value by True", CLIENT_TESTS),
    ("gripper-off-in-silence", "nor does one that was not read", "never", CLIENT_TESTS),
    ("clients-pass-zero", "another client or mapping is felt after zero", "replace value.test by True", PASS_TESTS),
    ("client-force-rate", "a client's force changes at the device's rate", "replace value.args[3] by 1e9", PASS_TESTS),
    ("client-torque-rate", "so does the torque that it causes", "replace value.args[3] by 1e9", PASS_TESTS),
    ("clients-flow-at-their-rate", "coils held back make up for it at the same rate", "drop", PASS_TESTS),
    ("fades-are-free", "a fade after a trip is not held back", "without 2", PASS_TESTS),
    ("contacts-are-free", "a world's own contact has no rate limit", "never", PASS_TESTS),
    ("worlds-pass-zero", "another world is felt after zero", "replace value by False", PASS_TESTS),
    (
        "another-of-a-class",
        "another world of the same class is felt after zero",
        "replace value by False",
        f"{TICK_TESTS}::test_another_world_of_the_same_class_is_felt_when_the_force_of_this_one_is_zero",
    ),
    ("waited-is-stale", "a command that waited for its server is not felt", "never", HANDOVER_TESTS),
    ("late-messages", "what waited for long changes nothing", "replace value by False", HANDOVER_TESTS),
    ("late-requests", "an OSC request that waited for long changes no world", "replace value by False", OSC_LATE_TESTS),
    ("holder-maps", "only the holder changes its mapping", "never", HANDOVER_TESTS),
    ("mapping-counts", "the loop knows of another mapping", "drop", HANDOVER_TESTS),
    (
        "clock-step",
        "a datagram is not newer because the computer's clock was set",
        "never",
        "tests/runtime/test_arrival_time.py::test_a_clock_that_was_set_meanwhile_makes_nothing_new",
    ),
    ("own-account", "another account is not this one", "replace value by True", OWNER_TESTS),
    ("orphaned-socket", "a connection that no program has is nobody's", "replace value by True", OWNER_TESTS),
    ("one-owner", "a port of two accounts is nobody's", "replace value.test by True", OWNER_TESTS),
    ("port-not-shared", "a port that others may bind is nobody's", "never", OWNER_TESTS),
    ("serve-account", "another account or computer uses no server without the token", "always", ACCESS_TESTS),
    ("osc-account", "another account sends no OSC message", "never", ACCOUNT_TESTS),
    (
        "osc-port-of-account",
        "another account binds the OSC server's port at no time",
        "replace value.args[1] by socket.SO_REUSEADDR",
        f"{ACCOUNT_TESTS}::test_the_port_of_osc_is_never_another_accounts",
    ),
    (
        "osc-holder-stays",
        "the holder stays known to the OSC server while other programs come and go",
        "replace value.generators[0].ifs[0] by True",
        "tests/serve/osc/test_osc_session.py::test_the_holder_stays_while_programs_of_this_account_come_and_go",
    ),
    ("osc-reader-account", "a port that passed to another account is sent no rows", "never", ACCOUNT_TESTS),
    ("tracker-account", "another account says not where the tool is", "never", ACCOUNT_TESTS),
    ("natnet-account", "a server of another account says not where the tool is", "never", SECRET_TESTS),
    ("lsl-waited", "what waited in an LSL stream is not newer than it is", "never", SENDER_TESTS),
    ("one-stream", "of two streams of one name none is a tracker until it is chosen", "never", LSL_TESTS),
    (
        "stream-account",
        "a stream of another account says not where the tool is",
        "replace value.generators[0].ifs[0] by True",
        SECRET_TESTS,
    ),
    (
        "secret-by-pipe",
        "no token stands in the process list",
        "replace value by start_module({value.args[0]}, spec, errors=self._errors, stdin=subprocess.PIPE, "
        "descriptor=descriptor)",
        SECRET_TESTS,
    ),
    ("one-client-holds", "one server's client holds the device until its force has faded", "always", BLOCK_TESTS),
    ("watcher-commands-nothing", "a client that watches commands nothing", "never", SERVED_TESTS),
    ("served-force-finite", "a command that is no force goes nowhere", "never", SERVED_TESTS),
    ("lost-client-told", "the loop is told of a lost connection", "drop", SERVED_TESTS),
    ("native-commander-exists", "a claim of no process commands nothing", "always", NATIVE_TESTS),
    ("native-exit-told", "the loop is told of a program's end", "never", NATIVE_TESTS),
    ("native-own-commands-only", "a command under another claim is none", "never", NATIVE_TESTS),
    ("serve-origin", "pages of other sites command no device", "never", ACCESS_TESTS),
    (
        "file-page-token",
        "a page from a file sees the live view with the token only",
        "replace value by True",
        "tests/serve/foxglove/test_viewer_connection.py",
    ),
    ("serve-host", "a name that is not this computer's reaches no server", "never", ACCESS_TESTS),
    ("osc-finite", "an OSC message's numbers are finite", "never", "tests/serve/osc/test_requests.py"),
    ("osc-token", "an OSC message from beyond this computer needs the token", "never", OSC_TESTS),
    ("recordings-run-no-code", "what a recording names runs only if it is on the own list", "never", STARTED_TESTS),
    ("own-list-only", "a list that others may write is not believed", "replace value by True", STARTED_TESTS),
    ("noted-arrays-are-numbers", "an array in a world's note is one of numbers", "never", STARTED_TESTS),
    ("noted-fields", "a world of a note has values of its fields' types", "never", STARTED_TESTS),
    ("recordings-open-no-file", "no file is opened because a recording names it", "never", STARTED_TESTS),
    ("recordings-open-no-scene", "no scene is opened because a recording names it", "never", STARTED_TESTS),
    ("imports-have-an-end", "modules beside a world have an end", "replace value.args[1] by 2**40", STARTED_TESTS),
    ("imports-end-together", "all modules beside a world have an end", "never", STARTED_TESTS),
    ("path-shapes", "compiled code has a tangent for each place of a path", "never", STARTED_TESTS),
    ("path-spacing", "the search along a path has few steps", "never", STARTED_TESTS),
    ("listed-once", "a record listed again is not made again", "never", HOSTILE),
    ("memory-columns", "worlds have no more memory than rows", "never", HOSTILE),
    ("recording-own-name", "a withdrawal deletes recordings of haptorb only", "always", DATABASES),
    ("no-strange-host", "a withdrawal connects to no server that a file names", "never", DATABASES),
    ("same-person", "a withdrawal follows the same person into other databases only", "never", DATABASES),
    (
        "withdrawn-own-export",
        "a withdrawal replaces exports of this version of the study only",
        "never",
        f"{DATABASES}::test_a_withdrawal_replaces_exports_of_its_own_study_only",
    ),
    (
        "withdrawn-own-columns",
        "a withdrawal replaces tables with the columns of an export only",
        "never",
        f"{DATABASES}::test_a_withdrawal_replaces_exports_of_its_own_study_only",
    ),
    (
        "withdrawn-export-inside",
        "a withdrawal replaces exports in the folder of the database only",
        "never",
        f"{DATABASES}::test_a_withdrawal_replaces_exports_of_its_own_study_only",
    ),
    (
        "export-own-companion",
        "an export removes no file of somebody else",
        "never",
        f"{DATABASES}::test_an_export_is_written_over_no_file_of_somebody_else",
    ),
    (
        "stored-device",
        "a database names a device of the catalogue, or one beside it",
        "always",
        f"{DATABASES}::test_a_database_names_a_device_of_the_catalogue_or_beside_it_only",
    ),
    (
        "feel-link",
        "a rating is written through no link",
        "never",
        "tests/study/feel/test_design_session.py::test_a_link_in_the_folder_of_ratings_is_not_followed",
    ),
    (
        "withdrawn-names",
        "the name of a study is no pattern",
        "replace iter.args[0].values[0].value by name",
        DATABASES,
    ),
    ("code-is-announced", "code is named before it runs", "drop", "tests/cli/test_own_code.py"),
    ("state-types", "a state in a recording is arrays of numbers", "never", BAD_RECORDINGS),
    ("commands-are-flags", "commands in a row are a sum of flags", "never", FOREIGN),
    ("changes-are-counted", "a row with any number of changes of its world ends a replay", "never", FOREIGN),
    ("state-length", "a state has all of its numbers and no more", "never", BAD_RECORDINGS),
    ("state-shapes", "a state of another chain is refused", "never", BAD_RECORDINGS),
    ("memory-length", "a recorded world's memory fits into rows", "never", BAD_RECORDINGS),
    ("report-token", "no token, no recording", "never", "tests/study/pages/test_trial_viewers.py"),
    ("dead-sensors", "dead sensors are no weak magnets", "never", ORIENTATION_TESTS),
    ("readings-possible", "readings that cannot be are left out", "always", MAP_TESTS),
    ("network-device", "networks of another device are refused", "never", MAP_TESTS),
    ("start-explained", "a field that nothing explains is no start", "only 1", ORIENTATION_TESTS),
    ("field-explained", "a field that nothing explains ends the tracking", "without 3", ORIENTATION_TESTS),
    ("pose-finite", "poses that are not finite are refused", "never", TRACKER_TESTS),
    ("pose-millimetres", "poses in millimetres are refused", "never", TRACKER_TESTS),
    ("jumped-lost", "a pose that jumped is lost", "drop", FEED_TESTS),
    ("jump-seen", "a jump is seen", "only 2", FEED_TESTS),
    ("one-sender", "one sender per tracker", "never", FEED_TESTS),
    ("sender-replaced", "another sender comes through a loss", "never", FEED_TESTS),
    ("pose-late", "poses that come late are refused", "never", TRACKER_TESTS),
    ("tool-lost", "a tracker that lost the tool says so", "drop", TRACKER_TESTS),
    ("prediction-end", "prediction has an end", "only 1", TRACKER_TESTS),
    ("prediction-age", "a predicted pose does not grow younger", "only 2", TRACKER_TESTS),
    ("stamp-before-arrival", "no pose was measured after it came", "only 1", SENDER_TESTS),
    ("sender-time", "a sender's number that tells no time is not believed", "never", SENDER_TESTS),
    ("sender-token", "a sender beyond this computer needs the token", "never", FEED_TESTS),
    ("replay-real", "a replay never moves a real device", "never", FEED_TESTS),
    (
        "hand-file-real",
        "a hand from a file moves no real tool",
        "never",
        "tests/runtime/test_hand_file.py::test_a_real_device_and_a_tracker_refuse_it",
    ),
    (
        "hold-real",
        "a pose that nobody measures is not held on a real device",
        "never",
        f"{HAND_TESTS}::test_no_pose_is_held_that_a_tracker_should_measure",
    ),
    ("left-handed", "a left-handed tracker is refused", "never", FRAME_TESTS),
    ("frame-scale", "a tracker in millimetres is no frame", "always", FRAME_TESTS),
    ("frame-rehearsed", "a rehearsed frame moves no real device", "never", FRAMED_TESTS),
    ("frame-tracker", "a frame is of one tracker", "never", FRAMED_TESTS),
    ("board-axes", "a board whose sensors have one axis cannot steer by the field", "never", SERIAL_TESTS),
    (
        "chip-axes",
        "chips whose sensors have one axis cannot steer by the field",
        "never",
        "tests/runtime/drivers/i2c/test_i2c_driver.py",
    ),
    ("rest-asked", "at rest the device is asked and never set", "replace value.args[0] by (0, 0, 0)", SERIAL_TESTS),
    (
        "plan-awaited",
        "a servo that waits for its plan ends with its host",
        "replace . by while {test}: pass",
        "tests/runtime/test_prestart.py",
    ),
    (
        "tool-carried",
        "a tool that is only carried on is lost soon",
        "without 3",
        "tests/estimation/hall_tracker/test_tool_position.py",
    ),
    ("waiting-heard", "who waits for an answer is not silent", "drop", SERIAL_TESTS),
    (
        "silence-forgiven",
        "only this computer's silence is forgiven while a coil is heated",
        "replace type by Exception",
        "tests/cli/calibrate/test_heating.py",
    ),
    ("heating-end", "a heated coil is not engaged again for ever", "never", "tests/cli/calibrate/test_heating.py"),
    (
        "firmware-trip",
        "a firmware's trip latches in the driver",
        "replace . by {targets[0]}, {targets[1]} = True, False",
        SERIAL_TESTS,
    ),
    ("firmware-restarted", "a firmware that restarted is not driven on", "never", SERIAL_TESTS),
    ("frame-damaged", "a damaged frame is none", "never", "tests/runtime/drivers/serial/test_frames.py"),
    ("calibration-step", "a calibration does not go on behind a failed step", "never", GUIDED_TESTS),
    ("tool-reversed", "a tool whose magnet is reversed is refused", "never", GUIDED_TESTS),
    ("participant-steers", "a participant's page cannot steer", "always", PAGES_TESTS),
    ("study-token", "a study's page needs its token, the participant's too", "never", PAGES_TESTS),
    ("participant-gone", "a participant's page that goes away pauses", "never", PAGES_TESTS),
    (
        "study-pause",
        "a pause in a study switches the coils off",
        "drop",
        "tests/study/session/test_terminal_session.py",
    ),
    ("study-stop-first", "a study's Stop waits for no queue and no database", "never", STOP_TESTS),
    ("study-pause-first", "an experimenter's Stop and pause wait for no queue and no database", "never", STOP_TESTS),
    ("study-end-first", "ending a study session waits for no database with the coils on", "never", STOP_TESTS),
    (
        "study-message",
        "no message of a study page takes Stop from it",
        "uncaught",
        f"{STOP_TESTS}::test_a_fault_that_a_message_meets_takes_no_stop_from_its_page",
    ),
    (
        "web-message",
        "a message that is no JSON is refused in a sentence",
        "uncaught",
        "tests/web/server/test_hostile_messages.py",
    ),
    ("study-answer-off", "no answer counts while the device is off", "never", TERMINAL_TESTS),
    ("export-own-folder", "an export replaces no folder but an earlier export", "never", EXPORT_TESTS),
    ("export-own-study", "an export replaces no folder of another study or version", "never", EXPORT_TESTS),
    ("export-own-table", "an export replaces no table of another study", "never", EXPORT_TESTS),
    (
        "study-one-kind",
        "a study's database holds one kind of data: real, pilot or simulated",
        "never",
        "tests/study/database/test_contents.py",
    ),
    ("study-withdrawn", "a code that was withdrawn does not return", "never", MERGE_TESTS),
    ("study-merge-kind", "real, pilot and simulated data are never merged", "never", MERGE_TESTS),
    ("study-merge-digest", "different studies or versions are never merged", "never", MERGE_TESTS),
    ("study-asked-before", "what was asked for in a study before a Stop is dropped, and told", "never", STOP_TESTS),
    (
        "study-stop-engaging",
        "a Stop that comes while a study switches on holds",
        "without 1",
        "tests/study/test_interleavings.py",
    ),
    ("study-stop-starting", "a Stop while a study's device starts holds", "never", STOP_TESTS),
    (
        "study-fault",
        "a study's thread outlives a fault, with the coils off",
        "uncaught",
        f"{STOP_TESTS}::test_the_thread_outlives_a_fault_that_nobody_foresaw",
    ),
    ("terminal-stop", "a key at the terminal stops while the session waits", "drop", STOP_TESTS),
    (
        "start-stop",
        "a stop while the servo starts counts",
        "replace value by 1",
        "tests/runtime/servo/test_servo.py::test_a_stop_that_is_given_before_or_while_the_servo_starts_holds",
    ),
    ("console-token", "console: no token, no entry", "never", "tests/web/server/test_token.py"),
    ("console-engage-stops", "console: a stop takes an engage back", "replace value.args[3] by None", CONSOLE_TESTS),
    ("console-stop-cancels", "console: a stop cancels what waits", "drop", CONSOLE_TESTS),
    ("console-stop-first", "console: a stop before any check", "never", CONSOLE_TESTS),
    ("i2c-reading-off", "i2c: reading tries to switch off until the chip confirms it", "never", I2C_TESTS),
    ("i2c-writing-off", "i2c: writing tries to switch off until the chip confirms it", "never", I2C_TESTS),
    ("i2c-off-unsaid", "i2c: off is not said before the chip confirms it", "drop", I2C_TESTS),
    ("i2c-obeyed", "i2c: a chip that does not obey is not called off", "only 1", I2C_TESTS),
    ("i2c-set-up", "i2c: a chip that lost its supply is set up before it is believed", "only 2", I2C_TESTS),
    ("i2c-engage-off", "i2c: nobody engages before off is confirmed", "never", I2C_TESTS),
    ("i2c-closing", "i2c: closing without a confirmation complains", "always", I2C_TESTS),
    ("i2c-zero-off", "i2c: zero duties are confirmed as off", "never", I2C_TESTS),
    ("guardian-tries", "i2c: the guardian tries until the chip confirms it", "return", I2C_TESTS),
    ("guardian-answers", "i2c: the guardian answers", "drop", I2C_TESTS),
    ("guardian-silent", "i2c: a guardian that does not answer trips", "never", I2C_TESTS),
    ("i2c-monostable", "i2c: without a monostable nothing opens", "never", I2C_TESTS),
    ("i2c-monostable-bridged", "i2c: a monostable that was bridged is noticed when engaging", "never", I2C_TESTS),
    ("i2c-trigger-edge", "i2c: every trigger is an edge", "without 2 of value", I2C_TESTS),
    ("i2c-lock", "i2c: a second program is refused", "drop", LOCK_TESTS),
    ("i2c-lock-named", "i2c: a lock without a name excludes nobody", "always", LOCK_TESTS),
    ("probe-off", "i2c: probing switches off before it enables the outputs", "drop", "tests/cli/test_hardware.py"),
    ("serial-unknown", "serial: a board that does not answer leaves the coils' state unknown", "drop", SERIAL_TESTS),
    ("off-by-default", "off is the default", "replace value by type({value}).RUNNING", GUARD_TESTS),
    ("nan-wrench-trips", "NaN wrench trips", "never", GUARD_TESTS),
    ("nan-currents-trip", "NaN currents trip", "never", GUARD_TESTS),
    ("nan-readings-trip", "NaN readings trip", "never", GUARD_TESTS),
    ("force-is-clamped", "force is clamped", "always", GUARD_TESTS),
    ("torque-is-clamped", "torque is clamped", "always", GUARD_TESTS),
    ("current-is-clamped", "current is clamped", "never", GUARD_TESTS),
    ("current-slews", "current slews", "always", GUARD_TESTS),
    ("stale-poses-trip", "stale poses trip", "only 1", GUARD_TESTS),
    ("lost-poses-trip", "lost poses trip", "only 2", GUARD_TESTS),
    ("trips-latch", "trips latch", "drop", GUARD_TESTS),
    ("engaging-ramps-from-zero", "engaging ramps from zero", "replace value by 1.0", GUARD_TESTS),
    ("engaging-blind-is-refused", "engaging blind is refused", "without 1", GUARD_TESTS),
    ("warm-coils-are-derated", "warm coils are derated", "replace value.args[3] by 1.0", GUARD_TESTS),
    ("supply-power-is-kept", "the supply gives no more than its power", "never", GUARD_TESTS),
    *(
        (
            f"supply-power-of-{what}",
            f"allocated {what} take no more than the supply's power",
            "replace value by 1.0",
            "tests/control/allocation/test_supply_power.py",
        )
        for what in ("forces", "motors", "wrenches")
    ),
    (
        "heat-is-an-upper-bound",
        "no winding is hotter than it is taken for, however the values are off",
        "replace value by (1.0, 1.0)",
        HEAT_TESTS,
    ),
    ("coils-warm-each-other", "coils warm each other", "replace value by 0.0", HEAT_TESTS),
    ("hot-coils-trip", "hot coils trip", "never", GUARD_TESTS),
    ("overcurrent-trips", "overcurrent trips", "never", GUARD_TESTS),
    ("resistance-is-bounded", "resistance is bounded", "replace value by {value.args[0].args[0]}", DRIVE_TESTS),
    ("reversed-magnet-trips", "a reversed magnet trips", "never", "tests/runtime/tick/test_hall_loop.py"),
    ("damping-brakes", "damping brakes", "replace . by {target} += {value}", PASSIVITY_TESTS),
    ("damping-brakes-turns", "damping brakes turns", "replace . by {target} += {value}", PART_TESTS),
    ("turns-are-counted", "the energy of a rendered torque is counted", "drop", PART_TESTS),
    (
        "accompanying-force-is-limited",
        "the accompanying force of a torque is limited as a commanded one",
        "never",
        "tests/control/allocation/test_whole_wrench.py",
    ),
    ("damping-is-bounded", "damping is bounded", "replace value by 1e3 * {value.args[0]}", PASSIVITY_TESTS),
    (
        "no-credit-in-free-flight",
        "damping of the hand in free flight is no credit",
        "replace value by {value.body}",
        PASSIVITY_TESTS,
    ),
    ("lasting-oscillation-is-softened", "an oscillation that lasts softens the world", "never", WALL_TESTS),
    ("stiffness-returns-in-free-space", "the stiffness returns in free space", "never", WALL_TESTS),
    ("active-worlds-are-left-alone", "active worlds are left alone", "without 1", PASSIVITY_TESTS),
    (
        "late-poses-meet-their-forces",
        "late poses meet the forces of their time",
        "replace value by {value.func}({value.args[0]}, {value.args[1].left} + late, {value.args[2].left} + late)",
        PASSIVITY_TESTS,
    ),
    ("duties-are-bounded", "duties are bounded", "never", DRIVE_TESTS),
    ("world-exit-trips", "a world that leaves by sys.exit trips", "replace type by Exception", TICK_TESTS),
    (
        "a-stop-before-the-first-pose-stands",
        "what stopped before the first pose is not cleared by the tracker",
        "replace test by self.gain == 0.0",
        TICK_TESTS,
    ),
    ("missed-deadlines-trip", "missed deadlines trip", "never", TICK_TESTS),
    ("ramp-after-silence", "after a silence the ramp begins again", "never", TICK_TESTS),
    (
        "windings-heat-by-the-clock",
        "windings heat by the clock",
        "replace value.args[2] by {value.args[2].value}.period",
        TICK_TESTS,
    ),
    ("current-mismatch-trips", "a sensor that lies trips", "never", TICK_TESTS),
    (
        "low-sensor-is-found",
        "a sensor that reads too little is found by the resistance that it makes",
        "without 2 of test.operand",
        "tests/control/protection/test_current_check.py",
    ),
    (
        "alternating-currents-are-followed",
        "a sensor that reads too little of an alternating current is found",
        "never",
        "tests/control/protection/test_current_check.py",
    ),
    ("world-failure-trips", "a world that fails trips", "drop", TICK_TESTS),
    ("memory-finite", "a memory that is not finite trips", "never", MEMORY_TESTS),
    ("failed-memory-restarts", "a memory that failed begins anew when somebody engages", "never", MEMORY_TESTS),
    ("half-a-step", "after a step that failed a world is not called any more", "drop", MEMORY_TESTS),
    ("memory-stands-still", "without a pose a memory stands still", "drop", MEMORY_TESTS),
    (
        "overrun-sheds-detail",
        "a world that takes too much of a tick does less",
        "drop",
        "tests/runtime/tick/test_world_budget.py",
    ),
    (
        "stiffer-from-the-tank",
        "a stretched coupling becomes stiffer only by the energy that its damper took",
        "never",
        "tests/worlds/scene/test_scene.py",
    ),
    (
        "memory-energy-counted",
        "energy that a world's time step makes is counted",
        "replace value by 0.0",
        MEMORY_TESTS,
    ),
    ("driver-failure-trips", "a driver that fails trips", "drop", TICK_TESTS),
    (
        "preparing-ends-no-loop",
        "a driver that fails while preparing trips in the tick, and does not end the loop",
        "replace items[0].context_expr by {items[0].context_expr.func}()",
        TICK_TESTS,
    ),
    ("allocation-failure-trips", "an allocation that fails trips", "drop", TICK_TESTS),
    ("off-means-zero-duties", "off means zero duties", "always", TICK_TESTS),
]

RED, GREEN, ANYWAY = "red, as it must be", "STILL GREEN", "RED ANYWAY"
_LIMIT = "timeout=1500"  # the first test of a run compiles kernels, and that must not be what makes it red


@dataclass(frozen=True)
class Proof:
    """One rule, and what shows that it is kept."""

    rule: str
    marker: str
    path: Path
    tests: str
    broken: str  # the file's text without what keeps the rule


def collect_proofs(rules: list[tuple[str, str, str, str]], marked: dict[str, MarkedStatement]) -> list[Proof]:
    """A proof per rule; MarkerError unless each rule has its marker and each marker its rule."""
    names = [name for name, *_ in rules]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise MarkerError(f"more than one rule has the marker {', '.join(twice)}")
    if lost := sorted({*names} - {*marked}):
        raise MarkerError(f"no statement in {PACKAGE} is marked `# safety: {', '.join(lost)}`")
    if unknown := sorted({*marked} - {*names}):
        places = ", ".join(f"{name} ({marked[name].path})" for name in unknown)
        raise MarkerError(f"these markers have no rule in {__file__}: {places}")
    return [Proof(rule, m, marked[m].path, tests, break_code(marked[m], how)) for m, rule, how, tests in rules]


def try_tests(proof: Proof, folder: Path) -> str:
    """What becomes of the tests of `proof` when its rule is not kept: RED, GREEN, or ANYWAY.

    `folder` holds a copy of the sources and what is compiled of it: a kernel is compiled again where what it stands on
    has changed (see `haptorb.compiled`), all others are there from the proofs before.
    """
    path, copy = folder / "src" / proof.path.relative_to(ROOT / "src"), folder / "kept"
    shutil.copy2(path, copy)
    path.write_text(proof.broken, encoding="utf-8")
    try:
        broken = _run_tests(proof.tests, folder, "--cache-clear")
    finally:
        shutil.copy2(copy, path)
    if broken != 1:
        return GREEN
    return ANYWAY if _run_tests(proof.tests, folder, "--last-failed") else RED  # what was red is tried as it is


def _run_tests(tests: str, folder: Path, which: str) -> int:
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "XDG_CACHE_HOME": str(folder / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)
    once = ["-p", "no:rerunfailures"] if which == "--cache-clear" else []  # what is broken stays so
    run = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-x", "-m", "not slow", which),
            *("-o", f"cache_dir={folder / 'tests'}", "-o", _LIMIT, *once, tests),
        ],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return run.returncode


def _line(outcome: str, proof: Proof) -> str:
    return f"{outcome:>20}  {proof.marker or '-'}: {proof.rule}"


def make_folder(folder: Path) -> Path:
    """A copy of the sources in `folder`, with the kernels that this account has compiled of them."""
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "native", folder / "native")
    kernels = cache_folder() / "kernels"
    if kernels.is_dir():
        shutil.copytree(kernels, folder / "cache" / "haptorb" / "kernels", ignore_dangling_symlinks=True)
    return folder


def main() -> int:
    """Prove every chosen rule; the exit code is the number of rules that no test keeps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="of a rule, a marker or a file; all rules without one")
    parser.add_argument("--jobs", type=int, default=1, help="rules at a time")
    parser.add_argument("--skip", type=Path, help="file with the output of an earlier run: rules that were red there")
    options = parser.parse_args()
    words, unproved = options.words, 0
    try:
        proofs = collect_proofs(RULES, find_marked(PACKAGE))
    except MarkerError as mistake:
        sys.exit(str(mistake))
    named = [(proof, f"{proof.rule} {proof.marker} {proof.path.relative_to(PACKAGE)}") for proof in proofs]
    chosen = [proof for proof, name in named if not words or any(word in name for word in words)]
    if options.skip:
        before = options.skip.read_text(encoding="utf-8").splitlines()
        chosen = [one for one in chosen if not any(line.strip() == _line(RED, one).strip() for line in before)]
    if not chosen:
        sys.exit(f"no rule, and no marker or file of one, has {' or '.join(repr(word) for word in words)} in its name")
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(options.jobs) as workers:
        free: Queue[Path] = Queue()
        for number in range(options.jobs):
            free.put(make_folder(Path(name, str(number))))

        def prove(proof: Proof) -> str:
            folder = free.get()
            try:
                return try_tests(proof, folder)
            finally:
                free.put(folder)

        for proof, outcome in zip(chosen, workers.map(prove, chosen), strict=True):
            unproved += outcome != RED
            print(_line(outcome, proof), flush=True)
    print(f"{len(chosen) - unproved} of {len(chosen)} rules are kept by a test")
    return unproved


if __name__ == "__main__":
    sys.exit(main())
