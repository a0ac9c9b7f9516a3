"""Only a regular file is ever replaced."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from haptorb.files import replace_file


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
