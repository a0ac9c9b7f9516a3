"""Only a regular file is ever replaced."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from haptorb.files import replace_file, replace_files


def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)  # as /dev/null is no file, either: root may replace that, too
    with pytest.raises(OSError, match="not a regular file"), replace_file(pipe) as part:
        part.write_text("lost")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]
    link, file = tmp_path / "link", tmp_path / "file"
    file.write_text("old")
    link.symlink_to(file)
    with replace_file(link) as part:
        part.write_text("new")
    assert link.read_text() == "new"


def test_of_several_files_none_is_replaced_if_one_is_a_folder_and_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    (tmp_path / "report.html" / "inside").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "report.html" / "inside")
    with pytest.raises(OSError, match="not a regular file"):  # noqa: SIM117 (the block must not be entered)
        with replace_files([tmp_path / "link", tmp_path / "report.html"]):
            pytest.fail("it began to write")
    assert (tmp_path / "link").read_text() == "precious"
    with replace_files([tmp_path / "link"]) as (part,):
        part.write_text("new")
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "report.html" / "inside").read_text() == "precious"
