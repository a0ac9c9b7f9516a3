"""Field names from before 0.2.0: in old recordings, exports, layouts, rows and tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from haptorb import Recording
from haptorb.devices.loader import load
from haptorb.recording.export import Export
from haptorb.recording.row import EARLIER_NAMES, LatestRow, RowLayout

OLDER = Path(__file__).parents[1] / "contracts" / "older"


def test_every_earlier_name_leads_to_a_field_and_hides_none() -> None:
    known = {field.name for field in RowLayout.of(load("pmsm")).fields}
    assert set(EARLIER_NAMES.values()) <= known
    assert not set(EARLIER_NAMES) & known


@pytest.mark.filterwarnings("ignore::haptorb.RecordingWarning")
def test_a_recording_of_that_time_has_todays_names_and_its_own() -> None:
    path = next(iter(sorted(OLDER.glob("omni*.mcap"))))
    with path.open("rb") as file:  # by another reader: the file's own schema has the earlier names
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert any(b"float64[6] asked " in schema.data for schema in summary.schemas.values())
    recording = Recording(path)
    names = {field.name for field in recording.fields}
    assert {"wrench_commanded", "wrench_actual", "current_measured", "duty_applied", "hand_goal"} <= names
    for earlier, now in EARLIER_NAMES.items():
        if now in names:
            with pytest.warns(FutureWarning, match=f"'{earlier}' is now called '{now}'"):
                found = recording[earlier]
            np.testing.assert_array_equal(found, recording[now])


@pytest.mark.filterwarnings("ignore::haptorb.RecordingWarning")
def test_exports_and_ranges_accept_them(tmp_path: Path) -> None:
    recording = Recording(next(iter(sorted(OLDER.glob("omni*.mcap")))))
    with pytest.warns(FutureWarning, match="wrench_commanded"):
        Export.of(recording, "csv", ["t", "asked"]).write(tmp_path / "csv")
    assert (tmp_path / "csv").read_text(encoding="utf-8").startswith("t [s],wrench_commanded[0] [N],")
    with pytest.warns(FutureWarning, match="duty_applied"):
        assert recording.read(0, 2, ["duties"]).shape == (min(2, len(recording)), 3)


def test_a_row_and_its_layout_accept_them() -> None:
    layout = RowLayout(channels=3, sensors=0)
    row = LatestRow(layout, np.arange(float(layout.width)))
    for earlier, now in EARLIER_NAMES.items():
        with pytest.warns(FutureWarning, match=now):
            assert layout[earlier] == layout[now]
        with pytest.warns(FutureWarning, match=now):
            assert np.array_equal(getattr(row, earlier), row[now])
    with pytest.raises(KeyError):
        layout["askd"]
