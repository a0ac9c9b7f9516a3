"""Level of detail: reduced where drawing is slow, with the same picture and a notice."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = [pytest.mark.browser, pytest.mark.realtime]

#: frames told to come `pace` milliseconds after one another, however fast this machine is; in each the view turns
PACED = """
  window.pace = 18; let now = 0; const real = requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (then) => real(() => {
    document.querySelector("[data-view=right]")?.click();
    then(now += window.pace);
  });
"""


@pytest.fixture
def find_levels(tmp_path):
    """A function from the times between frames [ms] to the level after each of them: the page's own control."""
    web = Path(__file__).parents[2] / "web"
    tool = shutil.which("node")
    if tool is None or not (web / "node_modules").exists():
        pytest.skip("no node on this machine, or the pages were built elsewhere")
    bundle = tmp_path / "detail.mjs"
    options = {"entryPoints": ["src/scene/detail.ts"], "format": "esm", "outfile": str(bundle)}
    make = f"import {{ build }} from 'esbuild'; await build({json.dumps(options)})"
    subprocess.run([tool, "--input-type=module", "-e", make], cwd=web, check=True, timeout=60)

    def measure_levels(paces: list[int]) -> list[str]:
        ask = (
            f"import {{ DetailControl }} from {json.dumps(bundle.as_uri())};"
            f"const control = new DetailControl('full', false); let now = 0; control.frame(now);"
            f"console.log(JSON.stringify({paces}.map((ms) => (control.frame((now += ms)), control.level))))"
        )
        run = subprocess.run([tool, "--input-type=module", "-e", ask], check=True, timeout=60, capture_output=True)
        return json.loads(run.stdout)

    return measure_levels


def move_until(screen, fake, wanted: str, most: int = 1500) -> int:
    """Move the stylus until `wanted` is true on the page; how many places that took."""
    for k in range(most):
        fake.target = fake.at(20 + 10 * np.sin(k / 5), -50.0, 0.048)
        screen.page.wait_for_timeout(17)
        if k % 10 == 9 and screen.tell(wanted):
            return k
    raise AssertionError(f"never came true: {wanted}; level {screen.tell('haptorb.level')}")


def view_pixels(screen) -> np.ndarray:
    """The view's pixels (height, width, 3), without the note."""
    screen.tell("['hint', 'detail'].forEach((id) => (document.getElementById(id).style.visibility = 'hidden'))")
    picture = screen.page.locator("#view").screenshot()
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=float)


def test_late_frames_lower_the_level_and_brisk_ones_raise_it(staged, browser):
    context = browser.new_context(viewport={"width": 600, "height": 640})
    context.add_init_script(PACED)
    screen = staged(context=context, every_frame=True)
    screen.until("haptorb.status === 'running'")
    best = screen.tell("haptorb.level")
    assert best in ("full", "layered")  # as this machine has a graphics processor or not
    assert screen.page.locator("#detail").is_hidden() == (best == "full")
    screen.tell("window.pace = 90")
    screen.until("haptorb.level === 'least'")
    assert "less detail" in screen.page.locator("#detail").inner_text()
    screen.tell("window.pace = 18")
    frames = screen.tell("haptorb.drawn")
    screen.until("haptorb.level === 'layered'")
    assert screen.tell("haptorb.drawn") - frames > 200, "one quick moment is no reason to draw more"
    assert not screen.troubles
    context.close()


def test_what_was_tried_and_failed_is_not_tried_again_soon(find_levels):
    late, brisk = [90] * 40, [18] * 400
    told = find_levels([*late, *brisk, *late, *brisk, *brisk])
    steps = [(k, level) for k, (level, before) in enumerate(zip(told[1:], told, strict=False), 1) if level != before]
    assert [level for _, level in steps] == ["layered", "least", "layered", "least", "layered"]
    down, up, again, later = (k for k, _ in steps[1:])
    assert up - down > 200
    assert later - again > 1.7 * (up - down)
    assert set(find_levels([600] * 300)) == {"full"}, "a picture that did not move says nothing about speed"
    assert set(find_levels([33] * 600)) == {"full"}, "thirty frames a second are a screen's own pace"


def test_what_stands_still_is_kept_while_the_stylus_moves(staged, fake):
    screen = staged(query="?detail=layered", every_frame=True)
    screen.until("haptorb.status === 'running' && haptorb.forceAt([0, 0, 1]).force !== 0")
    move_until(screen, fake, "haptorb.kept > 0")
    kept, drawn = screen.tell("[haptorb.kept, haptorb.drawn]")
    move_until(screen, fake, f"haptorb.drawn > {drawn + 60}")
    still = screen.tell("haptorb.kept") - kept  # the coils' glow, every three seconds
    assert still < 20
    # What is drawn anew is the stylus and its arrows, not the whole view.
    tip, magnet, end = screen.tell("haptorb.stylus()")
    box = screen.page.locator("canvas.patch").bounding_box()
    view = screen.page.locator("#view").bounding_box()
    assert 0 < box["width"] * box["height"] < 0.5 * view["width"] * view["height"]
    for place in (tip, magnet, end):
        assert box["x"] <= place["x"] <= box["x"] + box["width"]
        assert box["y"] <= place["y"] <= box["y"] + box["height"]
    # Turned, the old picture holds no more; at rest a new one is made.
    screen.page.get_by_role("button", name="Turn the view right").click()
    kept = screen.tell("haptorb.kept")
    move_until(screen, fake, f"haptorb.kept > {kept}")


def test_drawn_in_layers_it_is_the_same_picture(staged, fake):
    pictures = []
    for level in ("full", "layered"):
        screen = staged(query=f"?detail={level}", every_frame=True)
        screen.until("haptorb.status === 'running' && haptorb.forceAt([0, 0, 1]).force !== 0")
        if level == "layered":
            move_until(screen, fake, "haptorb.kept > 0")
        fake.target = fake.at(24.0, -50.0, 0.048)
        for _ in range(20):  # a busy machine shows late what it was told
            screen.page.wait_for_timeout(500)
            picture = view_pixels(screen)
            if pictures and np.abs(picture - pictures[-1]).mean() < (0.2 if level == "full" else 1.0):
                break
            if level == "full":
                pictures.append(picture)
        else:
            raise AssertionError(f"{level}: {np.abs(picture - pictures[-1]).mean():.2f} from the whole picture")
        screen.page.close()
