"""Layout checks of all pages at every size: STOP fully visible, no overlapping text, no horizontal overflow."""

from __future__ import annotations

from typing import Any

#: 1280×800 at 200 % zoom is 640×400; telephones upright and across, tablets, laptops, projectors
SIZES = [
    (640, 400), (844, 390), (390, 844), (820, 1180), (900, 700), (1024, 768), (1100, 800), (1280, 800), (1440, 900),
    (1920, 1080),
]  # fmt: skip

#: (STOP's faults, pairs of texts that lie over one another, texts that are cut off at the screen's side)
_LOOK = """(arrange) => {
  if (arrange) for (const [id, text] of Object.entries(arrange)) {
    const element = document.getElementById(id);
    element.hidden = false;
    if (text) element.textContent = text;
  }
  const stop = document.getElementById("stop"), faults = [];
  const look = (when) => {
    const { left, top, right, bottom } = stop.getBoundingClientRect();
    const box = `${left.toFixed(0)} ${top.toFixed(0)} to ${right.toFixed(0)} ${bottom.toFixed(0)}`;
    if (left < 0 || top < 0 || right > innerWidth || bottom > innerHeight || right - left < 80 || bottom - top < 40)
      faults.push(`${when}: STOP at ${box} is not whole on the screen`);
    const inset = 6; // the corners are round
    for (const [x, y] of [[left + inset, top + inset], [right - inset, top + inset], [left + inset, bottom - inset],
                          [right - inset, bottom - inset], [(left + right) / 2, (top + bottom) / 2]]) {
      const over = document.elementFromPoint(x, y);
      if (over === null || over.closest("#stop") === null)
        faults.push(`${when}: at ${x.toFixed(0)} ${y.toFixed(0)} is ${over && (over.id || over.tagName)} and not STOP`);
    }
  };
  const all = [...document.querySelectorAll("*")], was = all.map((element) => element.scrollTop);
  const put = (places) => all.forEach((element, n) => {
    if (element.scrollTop !== places[n]) element.scrollTop = places[n];
  });
  put(all.map((element) => Math.max(0, element.scrollHeight - element.clientHeight)));
  look("scrolled down");
  put(was);
  look("as it is");
  put(all.map(() => 0));

  const clip = (element, box) => {
    for (let up = element; up && up !== document.body; up = up.parentElement) {
      const { overflowX, overflowY, position } = getComputedStyle(up);
      if (overflowX === "visible" && overflowY === "visible") { if (position === "fixed") break; continue; }
      const frame = up.getBoundingClientRect();
      box = [Math.max(box[0], frame.left), Math.max(box[1], frame.top),
             Math.min(box[2], frame.right), Math.min(box[3], frame.bottom)];
      if (position === "fixed") break;
    }
    return box;
  };
  const boxes = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode()); ) {
    const element = node.parentElement, words = node.textContent.trim();
    const seen = { opacityProperty: true, visibilityProperty: true, contentVisibilityAuto: true };
    if (!words || element.closest(".sr, option, script, noscript") || !element.checkVisibility(seen)) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const { left, top, right, bottom } of range.getClientRects()) {
      const air = 0.18 * (bottom - top); // a line is higher than its letters
      const box = clip(element, [left + 0.5, top + air, right - 0.5, bottom - air]);
      if (box[2] - box[0] > 1 && box[3] - box[1] > 1) boxes.push([words.slice(0, 40), element, box]);
    }
  }
  for (const control of document.querySelectorAll("select, input, textarea, progress, meter, .camera button, #bar")) {
    if (!control.checkVisibility({ visibilityProperty: true })) continue;
    const { left, top, right, bottom } = control.getBoundingClientRect();
    const box = clip(control, [left, top, right, bottom]);
    const name = control.id || control.title || control.tagName;
    if (box[2] - box[0] > 1 && box[3] - box[1] > 1) boxes.push([name, control, box]);
  }
  const pairs = [];
  boxes.forEach(([one, here, a], n) => {
    for (const [other, there, b] of boxes.slice(n + 1)) {
      if (here.contains(there) || there.contains(here)) continue;
      const [wide, high] = [Math.min(a[2], b[2]) - Math.max(a[0], b[0]), Math.min(a[3], b[3]) - Math.max(a[1], b[1])];
      if (wide > 1 && high > 1) pairs.push(`"${one}" over "${other}" by ${wide.toFixed(0)} x ${high.toFixed(0)} px`);
    }
  });
  const cut = boxes.filter(([, , [left, , right]]) => left < -1 || right > innerWidth + 1)
    .map(([words, , [left, , right]]) => `"${words}" from ${left.toFixed(0)} to ${right.toFixed(0)} px`);
  put(was);
  return { faults, pairs, cut };
}"""


def find_faults(
    page: Any, arrange: dict[str, str] | None = None, sizes: list[tuple[int, int]] = SIZES, settle: int = 150
) -> list[str]:
    """Every fault of the page at every size, in words; the viewport is then as before.

    `arrange` shows hidden elements (id → text) at the instant of each look: badges and notes that come and go.
    """
    before, faults = page.viewport_size, []
    for width, height in sizes:
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(settle)
        seen = page.evaluate(_LOOK, arrange)
        faults += [f"{width}×{height}: {kind}: {fault}" for kind in seen for fault in seen[kind]]
    page.set_viewport_size(before)
    return faults
