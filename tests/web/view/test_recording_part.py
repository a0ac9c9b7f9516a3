"""FILE#t=FROM,TO, the form in which studies store a trial."""

from __future__ import annotations

from pathlib import Path

import pytest

from haptorb.errors import InputError
from haptorb.web.view import parse_part


def test_a_part_and_a_file_that_is_called_like_one(tmp_path):
    assert parse_part("session-1-1.mcap#t=12.250,15.000") == (Path("session-1-1.mcap"), (12.25, 15.0))
    odd = tmp_path / "odd#t=1,2"
    odd.write_bytes(b"")
    assert parse_part(str(odd)) == (odd, None)


@pytest.mark.parametrize("text", ["a#t=", "a#t=1", "a#t=2,1", "a#t=x,y", "a#t=1,2,3", "a#t=0,1e999", "#t=1,2"])
def test_times_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="FILE#t=FROM,TO"):
        parse_part(text)
