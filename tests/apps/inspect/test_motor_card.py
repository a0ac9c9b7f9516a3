"""`haptorb inspect pmsm`: numbers, text and picture."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

import haptorb
from haptorb.apps.cli import main
from haptorb.apps.inspect import card


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
    for part in ("peak", "for ever", "condition", "u12", "+EM1 −EM13", "assumed"):
        assert part in text


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_plot_is_written(made, tmp_path, suffix):
    path = tmp_path / f"card{suffix}"
    made.plot(path)
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
