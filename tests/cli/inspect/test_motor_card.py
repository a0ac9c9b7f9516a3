"""`haptorb inspect pmsm`: numbers, text and picture."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

import haptorb
from haptorb.cli import main
from haptorb.cli.cards import card


@pytest.fixture(scope="module")
def made():
    return card(haptorb.load("pmsm"))


def test_numbers_are_plain_json_and_complete(made):
    numbers = json.loads(json.dumps(made.numbers()))
    assert numbers["name"] == "pmsm"
    assert np.shape(numbers["peak_torque_nm"])[2] == 3
    assert np.array(numbers["continuous_torque_nm"]).min() > 0.1
    assert set(numbers["channel_shares_of_power"]) == {"X", "Y", "Z"}
    assert numbers["table_error"]["torque"] < 1e-6
    assert numbers["endurance"][-1]["seconds"] is None


def test_text_names_axes_channels_and_coils(made):
    console = Console(file=io.StringIO(), width=100)
    made.show(console)
    text = console.file.getvalue()
    for part in ("peak", "continuous", "condition", "u12", "+EM1 −EM13", "assumed"):
        assert part in text


def test_plot_is_written(made, tmp_path):
    figure = made.draw()
    for suffix in (".png", ".svg"):
        path = tmp_path / f"card{suffix}"
        figure.savefig(path)
        assert path.stat().st_size > 10_000


def test_the_command_refuses_the_printed_layout_unless_overridden(capsys):
    assert main(["inspect", "pmsm-printed"]) == 2
    error = capsys.readouterr().err
    assert "EM1 and EM17" in error
    assert "Traceback" not in error
    with pytest.raises(SystemExit) as done:
        main(["inspect", "pmsm-printed", "--override", "--assumed"])
    assert done.value.code == 0
    assert "rotor.mass" in capsys.readouterr().out


def test_what_holds_the_rotor_upright_is_told(made):
    """The regulator against its exact rings, the weight against its lever; the sum is what must be compensated."""
    upright = {key: np.array(values) for key, values in made.numbers()["upright"].items()}
    device = haptorb.load("pmsm")
    tilt = upright["tilt_rad"]
    assert upright["weight_nm"] == pytest.approx(-1.3 * 9.80665 * 0.017 * np.sin(tilt))
    assert upright["regulator_nm"][-1] == pytest.approx(device.regulator.torque(float(tilt[-1])), rel=1e-4)
    assert (upright["regulator_nm"][1:] > 0).all()
    assert upright["sum_nm"] == pytest.approx(upright["regulator_nm"] + upright["weight_nm"], abs=1e-12)
    assert np.abs(upright["sum_nm"]).max() < 0.2 * np.abs(upright["weight_nm"]).max()
