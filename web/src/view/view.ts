// Timeline page: tells the page of each recording, in an iframe, which time to show.

import { readNumber } from "../entry";
import { at, make, write } from "../panels/dom";
import { coverPage, MISSING_TOKEN } from "../panels/lock";
import { type RenderedQuantity, UnknownToken, token } from "../session";
import { Clock, SPEEDS, formatTime } from "./clock";
import { fetchOverview, type Overview, type Trips } from "./overview";
import type { Recorded, TimelineHandle } from "./played";
import { QUANTITIES, Strip, type Quantity } from "./strip";

const OVERVIEW_DELAY_MS = 600; // so that the first row is loaded before
const POLL_INTERVAL_MS = 700; // of an incomplete overview
const ANNOUNCE_INTERVAL_MS = 150; // of the slider's value for screen readers
const MAX_OFFSET_S = 1e6; // between the starts of two recordings
const PROGRESS_DELAY_MS = 2000; // before progress is shown
const MAX_FRAME_S = 0.25; // by which playback advances per frame

interface Opening {
  version: string;
  started: string;
  recordings: (Recorded & { gives: RenderedQuantity; trips: Trips })[];
  at: number;
  range: [number, number] | null;
  offset: number;
}

class Timeline {
  private readonly clock: Clock;
  private readonly frames: HTMLIFrameElement[] = [];
  private readonly strips: Strip[] = [];
  private readonly overviews: (Overview | null)[] = [];
  private offset: number;
  private last = performance.now();
  private announcedAt = 0;
  private displayedTime = NaN;
  private scrubbing = false;
  private readonly begun = performance.now();

  constructor(private readonly opening: Opening) {
    const { recordings } = opening;
    this.offset = opening.offset;
    this.clock = new Clock(0, 0);
    this.bounds();
    for (const [i, { name, gives }] of recordings.entries()) {
      const frame = make("iframe", { src: `player?recording=${i}${location.search.replace("?", "&")}#${token()}`, title: `Recording ${name}` });
      this.frames.push(frame);
      at("frames").append(frame);
      const strip = new Strip(recordings.length > 1 ? name : "", quantityOf(gives), this.place(i));
      this.strips.push(strip);
      this.overviews.push(null);
      at("strips").append(strip.canvas);
    }
    document.title = `haptorb · ${recordings.map(({ name }) => name).join(" | ")}`;
    this.clock.go(opening.at);
    if (opening.range) {
      this.clock.range = { from: opening.range[0], to: opening.range[1] };
      this.clock.loop = true;
    }
    this.controls();
    this.pointer();
    addEventListener("keydown", (event) => this.key(event));
    window.timeline = this.handle;
    setTimeout(() => recordings.forEach((_, i) => void this.pollOverview(i)), OVERVIEW_DELAY_MS);
    requestAnimationFrame((now) => this.frame(now));
  }

  private get handle(): TimelineHandle {
    const page = this;
    return {
      key: (event) => page.key(event),
      get time() {
        return page.clock.time;
      },
      get playing() {
        return page.clock.playing;
      },
      get speed() {
        return page.clock.speed;
      },
      get loop() {
        return page.clock.loop;
      },
      get marks() {
        return page.marks;
      },
      get overview() {
        return Math.min(...page.overviews.map((one) => one?.done ?? 0));
      },
      go: (t) => page.go(t),
    };
  }

  /** Position of recording `i` on the timeline. */
  private place(i: number): { from: number; seconds: number; begin: number; end: number } {
    const { begin, end } = this.clock;
    return { from: i ? this.offset : 0, seconds: this.opening.recordings[i]!.seconds, begin, end };
  }

  private bounds(): void {
    const spans = this.opening.recordings.map(({ seconds }, i) => [i ? this.offset : 0, (i ? this.offset : 0) + seconds] as const);
    this.clock.begin = Math.min(...spans.map(([from]) => from));
    this.clock.end = Math.max(...spans.map(([, to]) => to));
    const slider = at("slider");
    slider.ariaValueMin = this.clock.begin.toFixed(3);
    slider.ariaValueMax = this.clock.end.toFixed(3);
  }

  private get marks(): { t: number; text: string }[] {
    const all = this.overviews.flatMap((overview, i) => {
      const name = this.frames.length > 1 ? `${i + 1}: ` : "";
      return (overview?.marks ?? []).map(({ t, text }) => ({ t: t + (i ? this.offset : 0), text: name + text }));
    });
    return all.sort((a, b) => a.t - b.t);
  }

  /** Poll the overview of recording `i` until it is complete. */
  private async pollOverview(i: number): Promise<void> {
    const recorded = this.opening.recordings[i]!;
    try {
      const overview = await fetchOverview(i, token(), recorded, recorded.trips);
      this.overviews[i] = overview;
      this.strips[i]!.show(overview);
      this.listMarks();
      this.report();
      if (overview.done < 1 && !overview.trouble) setTimeout(() => void this.pollOverview(i), POLL_INTERVAL_MS);
    } catch {
      setTimeout(() => void this.pollOverview(i), 2 * POLL_INTERVAL_MS); // the server may respond again later
    }
  }

  private report(): void {
    const done = Math.min(...this.overviews.map((one) => one?.done ?? 0));
    const trouble = this.overviews.map((one) => one?.trouble ?? "").find(Boolean) ?? "";
    const progress = at("progress");
    progress.hidden = !trouble && (done >= 1 || performance.now() - this.begun < PROGRESS_DELAY_MS);
    write(progress, trouble ? `overview: ${trouble}` : `overview: ${Math.floor(100 * done)} % read; the rest is coarse`);
  }

  private listMarks(): void {
    const select = at<HTMLSelectElement>("marks");
    if (document.activeElement === select) return;
    const { marks } = this;
    const labels = marks.map(({ t, text }) => `${formatTime(t)}  ${text}`);
    if (labels.join() === [...select.options].slice(1).map(({ text }) => text).join()) return;
    const head = make("option", { value: "" }, marks.length ? `${marks.length} marks` : "none");
    select.replaceChildren(head, ...marks.map(({ t }, i) => make("option", { value: String(t) }, labels[i]!)));
  }

  private go(time: number): void {
    this.clock.go(time);
    this.displayedTime = NaN;
  }

  private jump(direction: 1 | -1): void {
    const { time } = this.clock;
    const { marks } = this;
    const next = direction > 0 ? marks.find(({ t }) => t > time + 1e-4) : marks.filter(({ t }) => t < time - 1e-4).at(-1);
    write(at("polite"), next ? `${next.text}, ${formatTime(next.t)}` : "No other mark.");
    if (next) this.go(next.t);
  }

  private step(ticks: number): void {
    this.clock.play(false);
    const player = this.frames[0]!.contentWindow?.player;
    // Step through the ticks of the first recording, or of the second where the first has none.
    const { seconds } = this.opening.recordings[0]!;
    const inside = this.clock.time >= 0 && this.clock.time <= seconds;
    if (player && inside) return this.go(player.neighbour(ticks));
    const other = this.frames[1]?.contentWindow?.player;
    this.go(other ? other.neighbour(ticks) + this.offset : this.clock.time + ticks / 1000);
  }

  /** Handle a key; returns whether the timeline uses it. */
  key(event: KeyboardEvent): boolean {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    if (target.closest("input, select, textarea, dialog[open]")) return false;
    if (event.key === " " && target.closest("button, summary, a")) return false;
    const act = this.action(event);
    if (!act) return false;
    act();
    event.preventDefault();
    return true;
  }

  private action({ key, shiftKey }: KeyboardEvent): (() => void) | null {
    const { clock } = this;
    const move = (seconds: number) => (): void => this.go(clock.time + seconds);
    switch (key) {
      case " ":
      case "k":
      case "K":
        return () => this.play(!clock.playing);
      case "ArrowLeft":
        return shiftKey ? move(-0.1) : () => this.step(-1);
      case "ArrowRight":
        return shiftKey ? move(0.1) : () => this.step(1);
      case "ArrowUp":
        return move(0.1);
      case "ArrowDown":
        return move(-0.1);
      case "PageUp":
        return move(10);
      case "PageDown":
        return move(-10);
      case "Home":
        return () => this.go(clock.begin);
      case "End":
        return () => this.go(clock.end);
      case "[":
        return () => this.jump(-1);
      case "]":
        return () => this.jump(1);
      case "-":
        return () => this.faster(-1);
      case "+":
      case "=":
        return () => this.faster(1);
      case "l":
      case "L":
        return () => this.repeat();
      case "i":
      case "I":
        return () => this.mark("from");
      case "o":
      case "O":
        return () => this.mark("to");
      case "?":
        return () => this.frames[0]!.contentWindow?.player?.help();
    }
    return null;
  }

  private play(yes: boolean): void {
    this.clock.play(yes);
    this.show();
  }

  private faster(steps: number): void {
    this.clock.faster(steps);
    this.show();
    write(at("polite"), `Speed ${this.clock.speed}.`);
  }

  private repeat(): void {
    this.clock.loop = !this.clock.loop;
    if (!this.clock.loop) this.clock.range = null;
    this.show();
  }

  private mark(end: "from" | "to"): void {
    this.clock.mark(end);
    this.show();
  }

  private controls(): void {
    const speed = at<HTMLSelectElement>("speed");
    speed.append(...SPEEDS.map((one) => make("option", { value: String(one) }, `${one} ×`)));
    speed.addEventListener("change", () => {
      this.clock.speed = Number(speed.value);
    });
    const quantity = at<HTMLSelectElement>("quantity");
    quantity.append(...QUANTITIES.map(({ name }) => make("option", { value: name }, name)));
    quantity.value = this.opening.recordings[0]!.gives;
    quantity.addEventListener("change", () => {
      for (const strip of this.strips) strip.choose(quantityOf(quantity.value));
    });
    const marks = at<HTMLSelectElement>("marks");
    marks.addEventListener("change", () => {
      if (marks.value) this.go(Number(marks.value));
      marks.value = "";
    });
    const actions: Record<string, () => void> = {
      before: () => this.jump(-1),
      back: () => this.step(-1),
      play: () => this.play(!this.clock.playing),
      on: () => this.step(1),
      after: () => this.jump(1),
      loop: () => this.repeat(),
      from: () => this.mark("from"),
      to: () => this.mark("to"),
    };
    for (const [id, act] of Object.entries(actions)) at(id).addEventListener("click", act);
    const offset = at<HTMLInputElement>("offset");
    at("offset-row").hidden = this.frames.length < 2;
    offset.value = String(this.offset);
    offset.addEventListener("input", () => offset.removeAttribute("aria-invalid"));
    offset.addEventListener("change", () => {
      const value = readNumber(offset.value);
      const refused = value === null || Math.abs(value) > MAX_OFFSET_S;
      write(at("offset-mistake"), refused ? `“${offset.value}” is not used: a number of seconds up to ${MAX_OFFSET_S}, such as 0.25` : "");
      at("offset-mistake").hidden = !refused;
      offset.setAttribute("aria-invalid", String(refused));
      if (refused) {
        offset.value = String(this.offset);
        return;
      }
      this.offset = value;
      this.bounds();
      this.strips.forEach((strip, i) => strip.layOut(this.place(i)));
      this.listMarks();
      this.go(this.clock.time);
    });
    this.show();
  }

  /** Scrub by dragging on the strips. */
  private pointer(): void {
    const slider = at("slider");
    const move = (event: PointerEvent): void => {
      const { left, width } = slider.getBoundingClientRect();
      const share = (event.clientX - left) / Math.max(width, 1);
      this.go(this.clock.begin + share * (this.clock.end - this.clock.begin));
    };
    slider.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      slider.setPointerCapture(event.pointerId);
      slider.focus({ preventScroll: true });
      this.scrubbing = true;
      move(event);
      event.preventDefault();
    });
    slider.addEventListener("pointermove", (event) => this.scrubbing && move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      slider.addEventListener(kind, () => (this.scrubbing = false));
    }
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    const passed = Math.min((now - this.last) / 1000, MAX_FRAME_S);
    this.last = now;
    const { clock } = this;
    const was = clock.playing;
    if (!this.scrubbing) clock.advance(passed);
    if (was !== clock.playing) this.show();
    const speed = clock.playing && !this.scrubbing ? clock.speed : 0;
    this.frames.forEach((frame, i) => frame.contentWindow?.player?.show(clock.time - (i ? this.offset : 0), speed));
    for (const strip of this.strips) strip.draw();
    this.updateTime(now);
  }

  /** Update the playhead, the displayed time and the slider's value. */
  private updateTime(now: number): void {
    const { time, begin, end } = this.clock;
    if (time !== this.displayedTime) {
      const share = (time - begin) / Math.max(end - begin, 1e-9);
      at("head").style.transform = `translateX(${(share * at("strips").clientWidth).toFixed(1)}px)`;
      write(at("now"), formatTime(time));
      this.displayedTime = time;
    }
    if (now - this.announcedAt < ANNOUNCE_INTERVAL_MS) return;
    this.announcedAt = now;
    const shown = this.frames[0]!.contentWindow?.player?.shown;
    const tick = shown && Number.isFinite(shown.tick) ? `, tick ${shown.tick.toFixed(0)}` : "";
    write(at("of"), `of ${formatTime(end, 1)}${tick}`);
    const slider = at("slider");
    const value = time.toFixed(3);
    if (slider.ariaValueNow === value) return;
    slider.ariaValueNow = value;
    slider.ariaValueText = `${formatTime(time)} of ${formatTime(end)}${tick}`;
  }

  /** Update the buttons and the looped range. */
  private show(): void {
    const { playing, speed, loop, range, begin, end } = this.clock;
    write(at("play"), playing ? "‖ pause" : "▶ play");
    at("play").ariaPressed = String(playing);
    at("loop").ariaPressed = String(loop);
    at<HTMLSelectElement>("speed").value = String(speed);
    const box = at("range");
    box.hidden = !range;
    if (!range) return;
    const part = (time: number): string => `${((100 * (time - begin)) / Math.max(end - begin, 1e-9)).toFixed(3)}%`;
    box.style.left = part(range.from);
    box.style.width = `calc(${part(range.to)} - ${part(range.from)})`;
  }
}

const quantityOf = (name: string): Quantity => QUANTITIES.find((one) => one.name === name) ?? QUANTITIES[0]!;

async function begin(): Promise<void> {
  const answer = await fetch("api/view", { headers: { authorization: `Bearer ${token()}` } });
  if (answer.status === 403) throw new UnknownToken(await answer.text());
  if (!answer.ok) throw new Error(`the server responded with ${answer.status} to /api/view`);
  new Timeline((await answer.json()) as Opening);
}

addEventListener("hashchange", () => location.reload());

const NO_RESPONSE = { title: "The program does not respond", text: "Start `haptorb view FILE`, and open the address that it prints." };

if (!token()) coverPage(MISSING_TOKEN);
else begin().catch((mistake: unknown) => coverPage(mistake instanceof UnknownToken ? MISSING_TOKEN : NO_RESPONSE));
