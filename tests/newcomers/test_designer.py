"""First hour of a designer: two snap-fits in a file, felt blind in the console, rated, and the report."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import Any

import pytest

from haptorb.cli import main
from newcomers.newcomer_shell import ENVIRONMENT, HAPTORB

DESIGNS = """
title = "Battery door"
world = "snap_fit"

[common]
material = "ABS"
friction = 0.3
width = "6 mm"
thickness = "1.5 mm"
base_length = "15 mm"
peak = "18.5 mm"
height = "1.5 mm"
top = "flat"

[design.easy]
title = "easy to open"
retention = "45 deg"

[design.tight]
title = "hard to open"
retention = "60 deg"
"""


class Session:
    """`haptorb feel` in a process, its terminal and its page."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.process = subprocess.Popen(
            [*HAPTORB, "feel", "door.toml", "--port", "0", *words], cwd=folder, text=True, bufsize=1,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=ENVIRONMENT,
        )  # fmt: skip
        self.said = ""
        self._lines: Queue[str] = Queue()
        Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def until(self, pattern: str, seconds: float = 100.0) -> str:
        """What the first group of `pattern` is once the terminal has said it."""
        end = time.monotonic() + seconds
        while not (found := re.search(pattern, self.said)):
            assert time.monotonic() < end, f"'{pattern}' was never said; said: {self.said}"
            try:
                self.said += self._lines.get(timeout=0.2)
            except Empty:
                assert self.process.poll() is None or not self._lines.empty(), self.said
        return found.group(1)

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "door.toml").write_text(DESIGNS)
    return tmp_path


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 900, "height": 700})
    page = context.new_page()
    page.set_default_timeout(120_000)  # without a graphics processor, on a busy machine, a picture takes long
    yield page
    context.close()


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    def run(*words: str) -> tuple[int, str]:
        try:
            code = main(["feel", *words])
        except SystemExit as end:
            code = int(end.code or 0)
        said = "".join(capsys.readouterr())
        assert "Traceback" not in said
        return code, said

    return run


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["door.toml", "--rate", "easy=8"], "from 1 to 7"),
        (["door.toml", "--only", "esy"], "easy, tight"),
        (["dor.toml"], "dor.toml"),
        ([], "designs.toml"),
        (["door.toml", "--device", "omni"], "spherical motor"),
        (["--world", "groove.py:Groove"], "groove.py"),
    ],
)
def test_her_mistakes_are_one_message(folder: Path, shell: Any, words: list[str], said: str) -> None:
    code, text = shell(*words)
    assert code == 2
    assert said in text
    assert not (folder / "door-session").exists()


@pytest.mark.slow  # the panel, the ratings and the report have tests of their own
@pytest.mark.browser
@pytest.mark.realtime
def test_she_feels_two_designs_blind_rates_them_and_reads_the_report(folder: Path, page: Any) -> None:
    session = Session(folder, "--blind", "--person", "P1")
    try:
        assert session.until(r"1 N at the part is (\S+) N in the hand") == "0.2"
        page.goto(session.until(r"Open (\S+) in"))
        feel = page.locator("#feel")
        feel.get_by_text("0 of 2 rated by P1").wait_for()
        feel.locator("#feel-scores button:enabled").first.wait_for()
        for name in ("easy", "tight", "hard"):
            assert name not in page.locator("body").inner_text()
        assert not page.locator("#target-scene").is_visible()
        page.keyboard.press("8")  # no score, and no harm
        page.keyboard.press("5")
        feel.get_by_text("1 of 2 rated by P1").wait_for()
        assert page.get_by_role("button", name="5", exact=True).get_attribute("aria-pressed") == "true"
        page.keyboard.press("n")
        session.until(r"rated 5 by P1\n(?s:.*)(now: )")
        session.type("8")
        session.until("(Rate again)")
        session.type("2")
        feel.get_by_text("2 of 2 rated by P1").wait_for()
        page.locator("#feel-person").fill("P2")
        page.get_by_role("button", name="set", exact=True).click()
        feel.get_by_text("0 of 2 rated by P2").wait_for()
        page.get_by_role("checkbox", name="hide names").uncheck()
        page.locator("#feel-now", has_text="to open").wait_for()
        page.keyboard.press("7")
        feel.get_by_text("1 of 2 rated by P2").wait_for()
        page.keyboard.press("b")
        page.locator("#feel-b[aria-pressed=true]").wait_for()
        page.get_by_role("button", name="Finish and report").click()
        report = folder / session.until(r"report: (\S+)")
        session.process.wait(60)
    finally:
        session.process.kill()
        session.process.communicate()
    records = [json.loads(line) for line in (folder / "door-session" / "ratings.jsonl").read_text().splitlines()]
    ratings = [(one["person"], one["score"], one["blind"]) for one in records if one["kind"] == "rating"]
    assert ratings == [("P1", 5, True), ("P1", 2, True), ("P2", 7, False)]
    assert {one["design"] for one in records if one["kind"] == "feeling"} == {"easy", "tight"}
    page.goto(report.as_uri())
    text = page.locator("body").inner_text()
    for words in (
        "easy to open",
        "hard to open",
        "P1",
        "P2",
        "5 (blind)",
        "yield strength of ABS (44 MPa)",
        "Simulated device",
    ):
        assert words in text
