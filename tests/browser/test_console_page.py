"""The console's page: keys and pointers, messages about the server, and accessibility."""

from __future__ import annotations

import http.server
import threading
import time

import numpy as np
import pytest

from haptorb.control.trip_reasons import CoilState, GuardState, Trip

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


def test_coils_whose_state_is_not_known_are_said_to_be_loudly(staged, fake):
    """Whatever the guard says, and also when the servo has ended and no row comes any more."""
    screen = staged()
    page = screen.page
    screen.until("haptorb.status === 'running'")
    assert page.locator("#unknown").is_hidden()
    fake.guard, fake.trip, fake.coils = GuardState.TRIPPED, Trip.DRIVER_FAILED, CoilState.UNKNOWN
    screen.until("haptorb.status === 'coil state unknown'")
    page.wait_for_timeout(60)
    assert page.locator("#unknown").inner_text() == "COIL STATE UNKNOWN"
    assert "supply" in page.locator("#alert").inner_text()
    assert page.get_by_role("button", name="Re-engage").count() == 0
    fake.silent, fake.alive = True, False
    screen.until("haptorb.status !== 'coil state unknown' || Number.isNaN(haptorb.value('guard')[0])", 5.0)
    assert screen.tell("haptorb.status") == "coil state unknown"
    assert page.locator("#unknown").is_visible()


def test_keys_move_the_stylus_along_the_dome(staged, fake):
    screen = staged()
    screen.until("haptorb.control")
    screen.page.locator("#scene").focus()
    start = fake.target.copy()
    screen.page.keyboard.press("ArrowRight")
    screen.until("haptorb.value('hand_goal')[0] !== 0")
    screen.page.wait_for_timeout(150)
    first = fake.target.copy()
    angle = np.degrees(np.arccos(start @ first / np.linalg.norm(start) / np.linalg.norm(first)))
    assert angle == pytest.approx(1.0, abs=0.02)
    assert np.linalg.norm(first) == pytest.approx(np.linalg.norm(start))
    screen.page.keyboard.press("+")
    screen.page.wait_for_timeout(150)
    assert np.linalg.norm(fake.target) == pytest.approx(np.linalg.norm(start) + 1e-3, abs=1e-6)
    for _ in range(20):
        screen.page.keyboard.press("Shift+ArrowRight")
    screen.page.wait_for_timeout(200)
    tilt = np.degrees(np.arccos(fake.target[2] / np.linalg.norm(fake.target)))
    assert tilt == pytest.approx(60.0, abs=0.1), "it stays inside the workspace"


def test_drag_and_wheel_move_the_hand_and_letting_go_leaves_it_there(staged, fake):
    screen = staged()
    screen.until("haptorb.control")
    page = screen.page
    x, y = screen.hold()
    page.mouse.move(x + 50, y, steps=6)
    page.wait_for_timeout(150)
    held = fake.target.copy()
    assert np.linalg.norm(held - fake.at(24.0, -50.0, 0.048)) > 0.004
    page.mouse.wheel(0, -100)
    page.wait_for_timeout(150)
    assert np.linalg.norm(fake.target) == pytest.approx(np.linalg.norm(held) + 1e-3, abs=1e-6)
    page.mouse.up()
    page.wait_for_timeout(100)
    rest = fake.target.copy()
    before = fake.count("point")
    page.wait_for_timeout(300)
    assert fake.count("point") > before + 10, "the server keeps a resting hand fresh"
    assert (fake.target == rest).all()


def test_hand_that_holds_survives_a_silence_of_the_server(staged, fake):
    screen = staged()
    screen.until("haptorb.control && haptorb.status === 'running'")
    page = screen.page
    x, y = screen.hold()
    page.mouse.move(x + 20, y)
    fake.silent = True
    screen.until("haptorb.status === 'waiting'")
    screen.wait_for(lambda: page.locator("#asked").inner_text() == "–")
    fake.silent = False
    screen.until("haptorb.status === 'running'")
    before = fake.target.copy()
    page.mouse.move(x + 70, y, steps=6)
    page.wait_for_timeout(150)
    assert np.linalg.norm(fake.target - before) > 0.004
    page.mouse.up()


def test_word_of_the_server_leaves_what_is_being_typed(staged, fake):
    screen = staged()
    screen.until("haptorb.control && haptorb.status === 'running'")
    tilt, moment = (screen.page.get_by_role("textbox", name=name) for name in ("summit tilt", "moment"))
    tilt.fill("30")  # not in effect before Enter
    fake.set_world("dome", {"moment": 1.0})
    end = time.monotonic() + 10
    while moment.input_value() != "1":
        assert time.monotonic() < end
        screen.page.wait_for_timeout(50)
    assert tilt.input_value() == "30"
    tilt.press("Enter")
    while fake.world[1]["summit"][2] != pytest.approx(0.75**0.5, abs=1e-3):
        assert time.monotonic() < end + 10, fake.world
        screen.page.wait_for_timeout(50)


def test_drag_beside_the_stylus_turns_the_view_only(staged, fake):
    screen = staged()
    screen.until("haptorb.control")
    before = screen.tell("haptorb.stylus()")
    box = screen.page.locator("#scene").bounding_box()
    screen.page.mouse.move(box["x"] + 300, box["y"] + 300)
    screen.page.mouse.down()
    screen.page.mouse.move(box["x"] + 420, box["y"] + 320, steps=5)
    screen.page.mouse.up()
    assert fake.count("point") == 0
    assert screen.tell("haptorb.stylus()") != before
    screen.page.get_by_role("button", name="Reset the view").click()
    assert screen.tell("haptorb.stylus()[0].x") == pytest.approx(before[0]["x"], abs=1.0)


def test_touch_drags_too(staged, fake):
    screen = staged(820, 1180, has_touch=True)
    screen.until("haptorb.control")
    tip = screen.tell("haptorb.stylus()[1]")
    client = screen.page.context.new_cdp_session(screen.page)
    for kind, dx in (("touchStart", 0), ("touchMove", 20), ("touchMove", 45)):
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": tip["x"] + dx, "y": tip["y"]}]})
        screen.page.wait_for_timeout(60)
    assert np.linalg.norm(fake.target - fake.at(24.0, -50.0, 0.048)) > 0.003
    client.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_watcher_is_told_and_cannot_move_but_can_stop(staged, fake):
    first = staged()
    first.until("haptorb.control")
    second = staged()
    second.until("!document.getElementById('watching').hidden")
    assert not second.tell("haptorb.control")
    second.hold()
    second.page.mouse.move(400, 400)
    second.page.mouse.up()
    assert fake.count("point") == 0
    assert second.page.get_by_role("combobox", name="World").is_disabled()
    second.page.get_by_role("button", name="STOP").click()
    second.until("haptorb.status === 'stopped'")
    assert second.page.get_by_role("button", name="Re-engage").count() == 0
    first.page.close()
    second.until("haptorb.control")


def test_gone_server_is_said_and_nothing_stale_is_shown(staged, fake):
    screen = staged()
    screen.until("haptorb.control && haptorb.status === 'running'")
    screen.hold()
    staged.console.close()
    screen.until("haptorb.status === 'disconnected'")
    page = screen.page
    screen.until("document.querySelector('#scene.holding') === null")  # nobody is there to follow the hand
    assert "nothing here is live" in page.locator("#alert").inner_text()
    for cell in ("#asked", "#given", "#tilt", "#distance", "#coils td", "#remaining"):
        assert page.locator(cell).first.inner_text() == "–"
    assert page.locator("#loop").inner_text() == ""
    assert not screen.tell("haptorb.arrow")
    assert "dead" in page.locator("#view").get_attribute("class")
    assert page.get_by_role("combobox", name="World").is_disabled()


def test_page_of_another_origin_gets_no_socket(staged, browser):
    screen = staged()

    class Evil(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(b"<title>evil</title>")

        def log_message(self, *words: object) -> None:
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Evil) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        try:
            page = browser.new_page()
            page.goto(f"http://127.0.0.1:{server.server_port}/")
            outcome = page.evaluate(
                """([url, token]) => new Promise(done => {
                    const socket = new WebSocket(url, ["haptorb", "token." + token]);
                    socket.onopen = () => done("open");
                    socket.onerror = () => done("refused");
                })""",
                [screen.url.replace("http", "ws") + "ws", screen.token],
            )
            page.close()
        finally:
            server.shutdown()
            serving.join()
    assert outcome == "refused"


def test_plots_show_every_sample_hold_still_and_export(staged, tmp_path):
    screen = staged()
    page = screen.page
    screen.until("haptorb.samples > 1500")
    page.get_by_role("button", name="pause").click()
    page.wait_for_timeout(200)
    held = screen.tell("haptorb.samples")
    page.wait_for_timeout(300)
    assert screen.tell("haptorb.samples") == held
    with page.expect_download() as coming:
        page.get_by_role("button", name="CSV").click()
    lines = coming.value.path().read_text(encoding="utf-8").splitlines()
    heading = lines[0].split(",")
    assert heading[:2] == ["t [s]", "tick"]
    assert {"p[2] [m]", "wrench_commanded[0] [N]", "wrench_commanded[3] [N·m]", "winding[0] [K]"} <= set(heading)
    assert len(lines) - 1 == held
    ticks = [int(line.split(",")[1]) for line in lines[1:]]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
    plot = page.locator(".plot .u-over").first.bounding_box()
    y = plot["y"] + 40
    page.mouse.move(plot["x"] + 0.9 * plot["width"], y)
    page.mouse.down()
    page.mouse.move(plot["x"] + 0.97 * plot["width"], y, steps=4)
    page.mouse.up()
    screen.until(f"haptorb.samples < {held} && haptorb.samples > 100")
    page.get_by_role("button", name="full window").click()
    screen.until(f"haptorb.samples === {held}")
    page.keyboard.press("p")
    screen.until(f"haptorb.samples > {held}")


@pytest.mark.slow
def test_memory_does_not_grow(staged, fake):
    """Five minutes' worth of samples in seconds: the page keeps one minute, whatever comes."""
    screen = staged()
    client = screen.page.context.new_cdp_session(screen.page)

    def heap() -> float:
        client.send("HeapProfiler.collectGarbage")
        return client.send("Runtime.getHeapUsage")["usedSize"]

    for _ in range(3):
        fake._start -= 2.0
        screen.page.wait_for_timeout(150)
    before = heap()
    for _ in range(40):
        fake._start -= 2.0
        screen.page.wait_for_timeout(60)
    screen.page.wait_for_timeout(300)
    assert heap() < before + 3e6


@pytest.mark.parametrize("lost", ["**/api/session", "**/static/socket.js"])
def test_a_connection_that_is_lost_while_the_page_loads_is_made_again(browser, staged, lost):
    asked = []

    def lose_first(route):
        asked.append(route.request.url)
        route.abort() if len(asked) == 1 else route.continue_()

    with browser.new_context() as context:
        context.route(lost, lose_first)
        screen = staged(context=context)
        assert len(asked) >= 2
        assert screen.page.locator("#lock").is_hidden()
