"""Messages of a servo's threads: shown on standard error; a missing one does not end a thread."""

from __future__ import annotations

import errno
import io
import sys

import pytest

from haptorb.runtime.world_output import show


class _GoneTerminal(io.StringIO):
    def write(self, text: str) -> int:
        raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize("kind", ["none", "closed", "terminal gone"])
def test_a_program_without_standard_error_goes_on(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stream: io.TextIOBase | None = None
    if kind == "closed":
        stream = io.StringIO()
        stream.close()
    elif kind == "terminal gone":
        stream = _GoneTerminal()
    monkeypatch.setattr(sys, "stderr", stream)
    show("world 'groove' was loaded again\n")


def test_a_message_arrives(capsys: pytest.CaptureFixture[str]) -> None:
    show("world 'groove' was loaded again\n")
    assert capsys.readouterr().err == "world 'groove' was loaded again\n"


def test_a_message_does_nothing_to_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """A body's name in a scene that was saved again is in MuJoCo's message."""
    show("scene.xml, line 2: body '\x9b2J\x1b]52;c;cm0=\x07\u202e' repeated\r\n\tnext\n")
    shown = r"scene.xml, line 2: body '\x9b2J\x1b]52;c;cm0=\x07\u202e' repeated"
    assert capsys.readouterr().err == f"{shown}\n\tnext\n"
