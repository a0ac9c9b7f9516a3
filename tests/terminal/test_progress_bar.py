"""Progress bars are drawn in terminals only: a pipe or a file receives nothing, not even an empty line."""

import pytest

from haptorb.terminal import make_progress, show_status


@pytest.mark.parametrize("show", [True, False])
def test_nothing_is_drawn_where_that_is_no_terminal(capsys, show):
    with make_progress(show=show) as bar:
        bar.update(bar.add_task("computing", total=2), advance=1)
    with show_status("measuring"):
        pass
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_the_bar(capsys, monkeypatch):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with make_progress() as bar:
        bar.update(bar.add_task("computing", total=2), advance=1)
        bar.refresh()
    assert "computing" in capsys.readouterr().err
