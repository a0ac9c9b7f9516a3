// Player of one recording in the console's document: 3D view, plots and readouts of the row that the timeline requests.

import { History } from "../history";
import { fillDialogs, placeDialogBelowAlert } from "../panels/dialogs";
import { at, write } from "../panels/dom";
import { Header } from "../panels/header";
import { Legend } from "../panels/legend";
import { coverPage, MISSING_TOKEN } from "../panels/lock";
import { ModePanel } from "../panels/modes";
import { ModelPanel } from "../panels/model";
import { Plots } from "../panels/plots";
import { WorldPanel } from "../panels/world";
import { Sample } from "../sample";
import type { DeviceScene, ReadoutPanel } from "../scene/device_scene";
import { requestedLevel, DETAIL, DetailControl } from "../scene/detail";
import { isDrawnInSoftware } from "../scene/graphics";
import { Drag } from "../scene/drag";
import { Orbit } from "../scene/orbit";
import { sceneOf } from "../scene/scenes";
import { Shapes } from "../scene/shapes";
import { Stage } from "../scene/stage";
import type { DeviceDrawing } from "../scene/device_drawing";
import { ObjectPane } from "../scene/object_pane";
import { listenToViewButtons } from "../scene/view_buttons";
import { UnknownToken, token, type Session, type Shape, type ObjectScene, type Values } from "../session";
import { status, type LinkState } from "../status";
import type { ForceMap, Mesh, Rows } from "../wire";
import { loopHealth } from "./loop_health";
import { KEYS, type PlayerHandle, type Recorded } from "./played";
import { hideControls } from "./recorded_page";
import { BLOCK_ROWS, RowSource, type RowLocation } from "./row_source";
import { WindowRows } from "./window_rows";
import { socketAddress } from "../address";

const READOUT_INTERVAL_MS = 100;
const ANNOUNCE_INTERVAL_MS = 4000; // of the readouts for screen readers
const SCRUB_SETTLING_MS = 120; // without another request, before the plots are filled
const PREFETCH_S = 1.5; // of playback
const MAX_PREFETCH_BLOCKS = 20;
const LOADING_NOTE_DELAY_MS = 700; // before "reading …" is shown
const MAX_PLOT_ROWS = 60_000;
const MAX_TIMINGS = 500; // kept of each kind

type PlayedSession = Session & { played: Recorded };

class Player {
  private readonly sample: Sample;
  private readonly history: History;
  private readonly window: WindowRows;
  private readonly source: RowSource;
  private readonly detailControl: DetailControl;
  private readonly stage: Stage;
  private readonly orbit: Orbit;
  private readonly scene: DeviceScene;
  private readonly drawing: DeviceDrawing;
  private readonly header: Header;
  private readonly world: WorldPanel;
  private readonly readouts: ReadoutPanel;
  private readonly legend: Legend;
  private readonly model: ModelPanel;
  private readonly modes: ModePanel | null = null;
  private readonly objectPane: ObjectPane | null = null;
  private readonly shapes: Shapes;
  private readonly plots: Plots;
  private readonly linkState: LinkState = { disconnected: true, serverEnded: false, servoEnded: false, stale: false, coils: NaN, missingPose: "", tripProgram: "" };
  private readonly costs: { scene: number[]; plots: number[] } = { scene: [], plots: [] };
  private requested = { t: 0, speed: 0, at: 0 };
  private shown = { t: 0, tick: NaN, row: -1, drawn: 0 };
  private place: RowLocation | null = null;
  private fresh = false;
  private plotsStale = false; // the plots do not show the samples before the row
  private worldKey = "";
  private readAt = 0;
  private announcedAt = 0;
  private blockAt = 0;

  constructor(
    private readonly session: PlayedSession,
    recording: string,
  ) {
    this.sample = new Sample(session.columns);
    this.history = new History(session.columns);
    const wanted = requestedLevel();
    this.detailControl = new DetailControl(wanted ?? (isDrawnInSoftware() ? "layered" : "full"), wanted !== null);
    this.stage = new Stage(at<HTMLCanvasElement>("scene"), this.detailControl.best);
    this.scene = sceneOf(session);
    this.orbit = new Orbit(this.stage.camera, () => this.viewMoved(), this.scene.home(session));
    this.legend = this.scene.colours === "force" ? new Legend() : new Legend(["", ""]);
    this.header = new Header(session, () => undefined);
    this.world = new WorldPanel(session, () => undefined);
    this.readouts = this.scene.readouts(session);
    this.model = new ModelPanel(session.models, () => undefined);
    if (session.modes.length) {
      this.modes = new ModePanel(() => undefined);
      this.objectPane = new ObjectPane(session.world.scene, session.world.shapes, this.detailControl.best);
    }
    this.plots = new Plots(this.history, session, this.scene);
    this.drawing = this.scene.drawing(this.stage, session);
    this.shapes = this.objectPane?.shapes ?? new Shapes(this.stage, 1000, session.world.shapes, at("arrows"));
    if (this.scene.colours === "currents") this.legend.coils(this.drawing.range, session.scene.gives);
    this.legend.arrows(); // a world whose code is missing has no force map, but arrows
    this.legend.device(session.scene);
    new Drag(this.stage.canvas, this.drawing, this.orbit, () => undefined).enabled = false;
    fillDialogs(session, this.scene, [], KEYS);
    hideControls(session.played);
    this.freezePanels();
    this.detail();
    this.buttons();
    const url = socketAddress(`ws?recording=${recording}`);
    this.source = new RowSource(url, token(), session.played.rows, session.played.start, {
      onOpen: () => this.onOpen(),
      onClose: () => this.onClose(),
      row: (frame, row) => this.setRow({ frame, index: 0, row }),
      block: (number) => this.onBlock(number),
      picture: (frame) => this.picture(frame),
      event: (event) => this.event(event),
    });
    this.window = new WindowRows(this.history, this.source);
    requestAnimationFrame((now) => this.frame(now));
  }

  /** Interface for the timeline. */
  get handle(): PlayerHandle {
    const page = this;
    return {
      show: (t, speed) => page.show(t, speed),
      neighbour: (steps) => page.neighbour(steps),
      help: () => at("ask").click(),
      get shown() {
        const { t, tick, drawn } = page.shown;
        return { t, tick, drawn, settled: page.settled };
      },
      value: (name) => Array.from(page.sample.list(name)),
      get status() {
        return page.state.word;
      },
      get samples() {
        return page.plots.samples;
      },
      get costs() {
        return { scene: median(page.costs.scene), plots: median(page.costs.plots), level: page.detailControl.level };
      },
      get heap() {
        return (performance as { memory?: { usedJSHeapSize: number } }).memory?.usedJSHeapSize ?? NaN;
      },
      shapes: () => page.shapes.places,
      forceAt: (direction) => page.drawing.forceAt(direction).force,
    };
  }

  private get state() {
    const now = status(this.sample, this.session, this.linkState);
    if (this.linkState.disconnected) {
      return { ...now, reason: "The viewer's server does not respond; this page reconnects by itself. If the server has ended, start `haptorb view` again." };
    }
    return now.reason ? { ...now, reason: `As recorded: ${now.reason}`, engageable: false } : { ...now, engageable: false };
  }

  private get rate(): number {
    const { rows, seconds } = this.session.played;
    return seconds > 0 ? (rows - 1) / seconds : 1000;
  }

  /** Number of samples that the plots show before the row. */
  private get plotRows(): number {
    const span = Number(at<HTMLSelectElement>("span").value);
    return Math.min(Math.ceil(span * this.rate) + 2, MAX_PLOT_ROWS);
  }

  private get settled(): boolean {
    return this.place !== null && !this.plotsStale && this.requestedRow === this.shown.row;
  }

  private get requestedRow(): number {
    return this.source.find(this.requested.t)?.row ?? -1;
  }

  private show(t: number, speed: number): void {
    const { seconds } = this.session.played;
    const clipped = Math.min(Math.max(t, 0), seconds);
    if (clipped === this.requested.t && speed === this.requested.speed && this.place) return;
    this.requested = { t: clipped, speed, at: performance.now() };
    if (this.plots.paused) this.plots.pause(false);
    this.update();
  }

  /** Show the requested row if it is loaded; otherwise request it. */
  private update(): void {
    const place = this.source.find(this.requested.t);
    if (place) this.setRow(place);
    else this.source.requestRow(this.requested.t);
    if (this.requested.speed > 0) this.requestBlocks();
  }

  private neighbour(steps: number): number {
    const place = this.source.row(Math.min(Math.max(this.shown.row + steps, 0), this.session.played.rows - 1));
    if (!place) return this.shown.t + steps / this.rate;
    return place.frame.t0 + place.frame.data[place.index * place.frame.width]! - this.session.played.start;
  }

  /** Show this row in the next frame. */
  private setRow(place: RowLocation): void {
    const { frame, index, row } = place;
    this.place = place;
    if (row === this.shown.row && !Number.isNaN(this.shown.tick)) return;
    this.sample.row.set(frame.data.subarray(index * frame.width, (index + 1) * frame.width));
    this.sample.t = frame.t0 + frame.data[index * frame.width]!;
    this.linkState.coils = this.sample.number("coil_state");
    this.shown.t = this.sample.t - this.session.played.start;
    this.shown.tick = frame.tick0 + this.sample.number("tick");
    this.shown.row = row;
    this.fresh = true;
    this.plotsStale = true;
    this.changeWorld();
  }

  /** Request blocks: first for the shown row and the next ones, then for the plots. */
  private requestBlocks(): void {
    const { row } = this.shown;
    if (row < 0) return;
    const now = Math.floor(row / BLOCK_ROWS);
    const wanted = [now];
    const ahead = this.requested.speed > 0 ? Math.ceil((PREFETCH_S * this.requested.speed * this.rate) / BLOCK_ROWS) : 1;
    for (let k = 1; k <= Math.min(ahead, MAX_PREFETCH_BLOCKS); k++) wanted.push(now + k);
    const first = Math.floor(Math.max(0, row - this.plotRows) / BLOCK_ROWS);
    for (let k = now - 1; k >= first; k--) wanted.push(k);
    this.source.requestBlocks(wanted);
  }

  private onBlock(number: number): void {
    this.plotsStale = true;
    // The shown row may have been received alone, before its block.
    if (number === Math.floor(this.shown.row / BLOCK_ROWS)) this.update();
  }

  private changeWorld(): void {
    const change = this.sample.number("world");
    const index = this.sample.number("model");
    const model = this.session.models[index] ?? this.session.world.model;
    const key = `${Number.isFinite(change) ? change : 0} ${model}`;
    if (key === this.worldKey) return;
    this.worldKey = key;
    this.source.world(Number.isFinite(change) ? change : 0, model);
  }

  private event(event: Record<string, unknown> & { event: string }): void {
    switch (event.event) {
      case "world":
        this.world.show(event["name"] as string, event["values"] as Values);
        this.world.remark((event["remarks"] ?? []) as string[]);
        this.model.show(event["model"] as string);
        this.shapes.build((event["shapes"] ?? []) as Shape[]);
        this.objectPane?.build((event["scene"] ?? null) as ObjectScene | null);
        this.freezePanels();
        // Hide the force map of the previous world until that of this one arrives.
        if (this.scene.colours === "force") this.drawing.forget();
        this.fresh = true;
        break;
      case "unpainted":
      case "mistake":
        this.showMistake(String(event["text"]));
    }
  }

  private picture(frame: Mesh | ForceMap | Rows): void {
    if (frame.kind === "mesh") this.drawing.shape(frame);
    else if (frame.kind === "force map") {
      this.drawing.paint(frame);
      this.legend.scale(this.drawing.range);
    }
  }

  /** Disable all settings: a recording cannot be changed. */
  private freezePanels(): void {
    this.world.enable(false);
    this.model.enable(false);
    this.modes?.enable(false);
  }

  private onOpen(): void {
    this.linkState.disconnected = false;
    this.worldKey = "";
    this.plots.freeze(false);
    at("view").classList.remove("dead");
    coverPage(null);
    if (this.shown.row >= 0) this.changeWorld();
    this.update();
  }

  /** Rows that are loaded stay available without a connection. */
  private onClose(): void {
    if (this.linkState.disconnected) return;
    this.linkState.disconnected = this.linkState.serverEnded = true;
    at("view").classList.add("dead");
    this.plots.freeze(true);
  }

  private showMistake(text: string): void {
    const box = at("mistake");
    write(box, text);
    box.hidden = false;
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    const fresh = this.fresh;
    this.fresh = false;
    if (fresh) {
      this.drawing.show(this.sample);
      this.objectPane?.show(this.sample);
      this.shapes.show(this.sample);
      this.legend.show(this.sample);
      this.shown.drawn++;
    }
    const begun = performance.now();
    if (this.stage.draw(now)) {
      if (this.detailControl.frame(now)) this.detail();
      pushTiming(this.costs.scene, performance.now() - begun);
    }
    this.objectPane?.draw(now);
    this.plot(now);
    this.updateText(now);
  }

  /** Update the plots to the shown row, as far as its samples are loaded; not while scrubbing. */
  private plot(now: number): void {
    const begun = performance.now();
    const settled = begun - this.requested.at > SCRUB_SETTLING_MS;
    let changed = false;
    if (this.place && this.plotsStale && (this.requested.speed > 0 || settled)) {
      changed = this.window.fill(this.place, this.plotRows);
      if (this.window.reaches(this.shown.row, this.plotRows)) this.plotsStale = false;
      else if (begun - this.blockAt > SCRUB_SETTLING_MS) {
        this.blockAt = begun;
        if (!changed) changed = this.window.renew(this.shown.row, this.plotRows);
        this.requestBlocks();
      }
    }
    if (this.plots.draw(now, changed) && changed) pushTiming(this.costs.plots, performance.now() - begun);
  }

  private updateText(now: number): void {
    if (now - this.readAt < READOUT_INTERVAL_MS) return;
    this.readAt = now;
    this.header.status(this.state, false);
    if (this.shown.row >= 0) {
      this.readouts.show(this.sample);
      this.modes?.show(this.sample);
      this.header.loop(loopHealth(this.history));
    }
    placeDialogBelowAlert();
    const waits = this.shown.row < 0 || (this.place === null && performance.now() - this.requested.at > LOADING_NOTE_DELAY_MS);
    const note = at("dropped");
    note.hidden = !waits;
    if (waits) write(note, "reading …");
    if (this.requested.speed > 0 || now - this.announcedAt < ANNOUNCE_INTERVAL_MS || this.shown.row < 0) return;
    this.announcedAt = now;
    write(at("polite"), [this.readouts.sentence(this.sample), this.modes?.sentence(this.sample) ?? ""].filter(Boolean).join("; "));
  }

  private detail(): void {
    const { level } = this.detailControl;
    this.stage.level = level;
    if (this.objectPane) this.objectPane.level = level;
    this.plots.interval = DETAIL[level].plotInterval;
    const note = at("detail");
    note.hidden = level === "full";
    write(note, this.detailControl.best === "full" ? "less detail: drawing was slow" : "less detail: no graphics processor");
  }

  private viewMoved(): void {
    this.stage.touch();
    this.legend.length(this.stage.scale(this.orbit.distance));
  }

  private buttons(): void {
    listenToViewButtons(this.orbit);
    at("span").addEventListener("change", () => {
      this.plotsStale = true;
      this.window.forget();
    });
    new ResizeObserver(() => this.viewMoved()).observe(at("view"));
    // The timeline handles keys first, wherever the focus is; the rest belongs to this page.
    addEventListener("keydown", (event) => {
      if (parent.timeline?.key(event)) return;
      if (event.ctrlKey || event.metaKey || event.altKey || (event.target as HTMLElement).closest("input, select")) return;
      if (event.key === "0") this.orbit.reset();
      else if (event.key === "?") at("ask").click();
    });
  }
}

/** Append `value`, and drop the oldest beyond MAX_TIMINGS. */
function pushTiming(list: number[], value: number): void {
  list.push(value);
  if (list.length > MAX_TIMINGS) list.shift();
}

const median = (list: number[]): number => [...list].sort((a, b) => a - b)[list.length >> 1] ?? NaN;

async function begin(): Promise<void> {
  const recording = new URLSearchParams(location.search).get("recording") ?? "0";
  const answer = await fetch(`api/session?recording=${recording}`, { headers: { authorization: `Bearer ${token()}` } });
  if (answer.status === 403) throw new UnknownToken(await answer.text());
  const { handle } = new Player((await answer.json()) as PlayedSession, recording);
  window.player = handle;
}

begin().catch((mistake: unknown) =>
  coverPage(
    mistake instanceof UnknownToken
      ? MISSING_TOKEN
      : { title: "This recording cannot be shown", text: `${mistake instanceof Error ? mistake.message : mistake}. If \`haptorb view\` still runs, load this page again.` },
  ),
);

