"""The command line: output, errors and exit codes."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager
from importlib.resources import files

import pytest

import haptorb
from haptorb.cli import main
from haptorb.runtime.linux import Termination
from oracles import groove
from oracles.command import run_command

DESIGNS = str(files("haptorb_study.feel") / "example.toml")


def test_devices_and_worlds_are_one_line_each(capsys):
    code, out, _ = run_command(capsys, "devices")
    assert code == 0
    assert any(line.startswith("omni ") for line in out.splitlines())
    code, out, _ = run_command(capsys, "worlds")
    assert code == 0
    assert any(line.startswith("dome ") for line in out.splitlines())


def test_lists_as_json(capsys):
    assert "omni" in json.loads(run_command(capsys, "devices", "--json")[1])
    assert "dome" in json.loads(run_command(capsys, "worlds", "--json")[1])
    names = [item["name"] for item in json.loads(run_command(capsys, "worlds", "dome", "--json")[1])]
    assert names == ["summit", "half_width_deg", "cut_off_deg", "moment"]


def test_a_world_shows_its_parameters(capsys):
    code, out, _ = run_command(capsys, "worlds", "dome")
    assert code == 0
    assert "half_width_deg" in out
    assert "5 … 90 deg" in out


def test_the_card_of_omni_in_numbers(capsys):
    card = json.loads(run_command(capsys, "inspect", "omni", "--json")[1])
    contact = card["layers"][0]
    assert contact["distance_m"] == pytest.approx(0.050)
    assert contact["dipole_error"] == pytest.approx(0.156, abs=5e-4)  # E16
    assert contact["passive_pull_n"] == pytest.approx(0.0529, abs=5e-5)  # E18
    assert contact["continuous_radial_n"] < contact["peak_radial_n"]
    assert card["actuated_dof"] == 3
    assert card["endurance"][0]["seconds"] < card["endurance"][-1]["seconds"]


def test_the_card_of_omni_for_people(capsys):
    code, out, _ = run_command(capsys, "inspect", "omni")
    assert code == 0
    assert "assumed: " in out
    assert "15.6" in out


def test_what_is_assumed_is_listed_with_reasons(capsys):
    _, out, _ = run_command(capsys, "inspect", "omni", "--assumed")
    assert "tool.mass " in out


def test_the_card_as_a_picture(capsys, tmp_path):
    code, _, _ = run_command(capsys, "inspect", "omni", "--plot", str(tmp_path / "card.pdf"))
    assert code == 0
    assert (tmp_path / "card.pdf").stat().st_size > 5000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["inspect", "omi"], "did you mean 'omni'"),
        (["inspect", "no/such/file.toml"], "cannot be read"),
        (["inspect", "omni", "--plot", "card.jpg"], "must be a .png, .svg or .pdf file"),
        (["inspect", "omni", "--plot", "/no/such/folder/card.png"], "does not exist"),
        (["inspect", "omni", "--plot", "/proc/card.png"], "--plot: cannot write '/proc/card.png'"),
        (
            ["feel", DESIGNS, "--plot", "/proc/card.svg"],
            "--plot: cannot write '/proc/card.svg'",
        ),
        (["check", "--world", "dome", "--plot", "/proc/card.svg"], "--plot: cannot write '/proc/card.svg'"),
        (["estimators", "--plot", "/proc/card.svg"], "--plot: cannot write '/proc/card.svg'"),
        (["fit-multipole", "--plot", "/proc/card.svg"], "--plot: cannot write '/proc/card.svg'"),
        (["bench", "magnetics", "--plot", "/proc/card.svg"], "--plot: cannot write '/proc/card.svg'"),
        (["inspect", "pmsm-printed"], "`haptorb inspect DEVICE --override`"),
        (["worlds", "doom"], "did you mean 'dome'"),
        (["run", "omi"], "did you mean 'omni'"),
        (["run", "--world", "doom"], "did you mean 'dome'"),
        (["run", "--set", "momnt=1"], "did you mean 'moment'"),
        (["run", "--set", "moment=9"], "between -4 and 4"),
        (["run", "--set", "moment=nan"], "finite"),
        (["run", "--set", "moment"], "NAME=VALUE"),
        (["run", "--set", "moment=a"], "NAME=VALUE"),
        (["run", "--set", "summit=0,0,0"], "zero vector"),
        (["run", "--set", "moment=2 N"], "must be a value in A·m²"),
        (["run", "--set", "moment=9 A·m²"], "between -4 and 4"),
        (["run", "--world", "no/such/groove.py:Groove"], "groove.py: cannot be read"),
        (["check", "--world", "no/such/groove.py:Groove"], "groove.py: cannot be read"),
        (["run", "--headless", "--rate", "10"], "rate"),
        (["run", "--headless", "--rate", "nan"], "rate"),
        (["run", "--headless", "--duration", "-1"], "--duration"),
        (["run", "--headless", "--duration", "nan"], "--duration"),
        (["run", "--headless", "--driver", "simm"], "did you mean 'sim'"),
        (["run", "--headless", "--model", "publishd"], "did you mean 'published'"),
        (["run", "--headless", "--seed", "-3"], "seed"),
        (["run", "--headless", "--estimator", "network"], "estimator of device 'omni'"),
        (["run", "pmsm", "--headless", "--estimator", "least-square"], "did you mean 'least-squares'"),
        (["run", "pmsm", "--headless", "--world", "dome"], "tool over a sphere"),
        (["run", "pmsm", "--set", "moment=1"], "parameter of Outlet"),
        (["run", "--headless", "--duration", "1", "--record", "/no/such/folder/a.mcap"], "folder"),
        (["run", "--port", "70000"], "port"),
        (["run", "omni", "--grip", "firm"], "--scene"),
        (["run", "omni", "--world", "wall", "--latency", "5"], "--scene"),
        (["train", "omni"], "`haptorb train` works for spherical motors"),
    ],
)
def test_a_mistake_is_one_message(capsys, words, said):
    code, out, err = run_command(capsys, *words)
    assert code == 2
    assert said in err
    assert "=True" not in err  # which is Python's way to say it
    assert not out


def test_the_version(capsys):
    code, out, _ = run_command(capsys, "--version")
    assert (code, out) == (0, f"haptorb {haptorb.__version__}\n")


@pytest.mark.parametrize("words", [["--device", "arm"], ["--device=arm"]])
def test_exec_gives_its_device_to_the_run_and_not_to_the_program(capsys, monkeypatch, words):
    """There `--device` is an option: what stands behind `--` is the program's."""
    from haptorb.cli import execute

    given = []

    class Run:
        def execute(self, command, kit):
            given.append(command)
            return 0

    @contextmanager
    def open_run(options):
        given.append(options)
        yield Run()

    monkeypatch.setattr(execute, "_open_run", open_run)
    run_command(capsys, "exec", *words, "--headless", "--", "/bin/true", "--device", "mine")
    assert given[0][:2] == ["run", "arm"]
    assert given[1] == ["/bin/true", "--device", "mine"]


@pytest.mark.parametrize("words", [["--device", "omi"], ["--device=omi"], ["omi"]])
@pytest.mark.parametrize(
    "command", ["run", "inspect", "show", "check --world dome", "calibrate", "train", "hardware emulate",
                "hardware jog x --driver serial:nowhere", "bench magnetics --plot a.png", "feel {designs} --headless"],
)  # fmt: skip
def test_a_device_is_an_argument_and_the_earlier_option_works(capsys, tmp_path, monkeypatch, command, words):
    monkeypatch.chdir(tmp_path)
    designs = files("haptorb_study.feel") / "example.toml"
    code, _, err = run_command(capsys, *(word.format(designs=designs) for word in command.split()), *words)
    assert code == 2
    assert "'omi'" in err


def test_no_command_has_an_option_for_its_device():
    import typer

    from haptorb.cli.program import app

    def leaves(command):
        inner = getattr(command, "commands", {})
        return [leaf for one in inner.values() for leaf in leaves(one)] if inner else [command]

    # Of `exec` the argument is the program.

    options = [opt for leaf in leaves(typer.main.get_command(app)) if leaf.name != "exec" for parameter in leaf.params
               for opt in parameter.opts if parameter.param_type_name == "option"]  # fmt: skip
    assert "--device" not in options


@pytest.mark.parametrize("words", [["fly"], ["run", "--hadless"], ["inspect"], ["run", "--rate", "fast"]])
def test_a_wrong_command_line(capsys, words):
    code, _, err = run_command(capsys, *words)
    assert code == 2
    assert err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "omni", "--rate", "fast"], "'--rate': must be a number; got 'fast'"),
        (["run", "--port=x"], "'--port': must be a whole number; got 'x'"),
        (["run", "--set", "a=1", "--seed", "1.5"], "'--seed': must be a whole number; got '1.5'"),
    ],
)
def test_a_wrong_number_says_what_was_expected_and_given(capsys, words, said):
    code, _, err = run_command(capsys, *words)
    assert code == 2
    assert said in " ".join(err.split())


def test_a_recording_is_not_overwritten(capsys, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    code, _, err = run_command(capsys, "run", "--headless", "--duration", "1", "--record", str(path))
    assert code == 2
    assert "--force" in err
    assert path.read_text() == "precious"


def test_help_is_light():
    """`haptorb --help` answers at once because it loads neither numpy nor a compiler nor the server."""
    heavy = "[m for m in ('numpy', 'numba', 'scipy', 'matplotlib', 'pint', 'starlette') if m in sys.modules]"
    program = f"import sys; from haptorb.cli import program; print({heavy})"
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_a_full_disk_is_one_message(capsys, monkeypatch):
    with open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(["devices"]) == 2
    assert capsys.readouterr().err == "haptorb: cannot write the output: No space left on device\n"


def test_no_output_at_all(monkeypatch):
    """As in `haptorb devices >&-`, and without a console under Windows."""
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(SystemExit) as end:
        main(["devices"])
    assert not end.value.code
    sys.stdout.close()


def test_a_world_of_the_user_s_own_is_checked_with_values_in_any_unit(capsys):
    world = ("check", "--world", f"{groove.__file__}:Groove", "--json")
    code, out, _ = run_command(capsys, *world, "--set", "stiffness=0.05 N/mm")
    assert code == 0
    assert json.loads(out)["steepest"] == pytest.approx(50.0, rel=1e-3)
    code, _, err = run_command(capsys, *world, "--set", "stifness=1")
    assert code == 2
    assert "did you mean 'stiffness'" in err


@pytest.mark.parametrize(("interruption", "code"), [(KeyboardInterrupt(), 130), (Termination(signal.SIGTERM), 143)])
def test_a_signal_while_a_library_is_loaded_ends_the_command_silently(interruption, code, monkeypatch, capsys):
    """pybind11 turns an exception that comes while it loads a library into an ImportError, with that one as its cause.
    scipy's HiGHS is such a library."""

    def load(_):
        try:
            raise interruption
        except BaseException as cause:
            raise ImportError("initialization failed") from cause

    monkeypatch.setattr("haptorb.cli.program.main", load)
    assert main(["devices"]) == code
    assert capsys.readouterr() == ("", "")


def test_a_library_that_cannot_be_loaded_is_no_interruption(monkeypatch):
    def load(_):
        raise ImportError("libgomp.so.1: cannot open shared object file") from OSError("missing")

    monkeypatch.setattr("haptorb.cli.program.main", load)
    with pytest.raises(ImportError, match="libgomp"):
        main(["devices"])
