"""Files named by users and files: regular ones only, without blocking."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from haptorb.errors import InputError
from haptorb.files import open_regular, read_bytes
from haptorb.recording.recording import Recording, RecordingError

WAITS = Path("/proc/kmsg")  #: the kernel's log: it is a regular file, and who has read it all waits for more


@pytest.mark.skipif(not os.access(WAITS, os.R_OK), reason=f"{WAITS} is not readable here")
def test_a_regular_file_that_has_nothing_to_read_is_not_waited_for() -> None:
    with pytest.raises(InputError, match="nothing to read"):
        [read_bytes(WAITS, 1 << 24, "file", InputError) for _ in range(2)]
    with pytest.raises(RecordingError):
        Recording(WAITS)


def test_what_is_read_is_what_is_there(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(range(256)) * 1000)
    with open_regular(path, "file", InputError) as file:
        assert file.read(10) == bytes(range(10))
        assert len(file.read()) == 256_000 - 10
        file.seek(255)
        assert file.read(2) == b"\xff\0"
        assert file.name == path
