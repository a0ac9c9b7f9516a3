// One recording in the console's page: the picture, plots and numbers of the row that the timeline asks for.

import { History } from "../history";
import { fill, uncover } from "../panels/dialogs";
import { at, write } from "../panels/dom";
import { Header } from "../panels/header";
import { Legend } from "../panels/legend";
import { cover, UNKNOWN } from "../panels/lock";
import { ModePanel } from "../panels/modes";
import { ModelPanel } from "../panels/model";
import { Plots } from "../panels/plots";
import { WorldPanel } from "../panels/world";
import { Sample } from "../sample";
import type { DeviceScene, Readings } from "../scene/device_scene";
import { requestedLevel, DETAIL, DetailControl } from "../scene/detail";
import { isDrawnInSoftware } from "../scene/graphics";
import { Drag } from "../scene/drag";
import { Orbit } from "../scene/orbit";
import { sceneOf } from "../scene/scenes";
import { Shapes } from "../scene/shapes";
import { Stage } from "../scene/stage";
import type { Subject } from "../scene/subject";
import { TargetPane } from "../scene/target_pane";
import { listenToViewButtons } from "../scene/view_buttons";
import { UnknownToken, token, type Session, type Shape, type TargetScene, type Values } from "../session";
import { status, type Silence } from "../status";
import type { ForceMap, Mesh, Rows } from "../wire";
import { loopHealth } from "./loop_health";
import { KEYS, type PlayerHandle, type Recorded } from "./played";
import { hideControls } from "./recorded_page";
import { BLOCK, RowSource, type Place } from "./row_source";
import { WindowRows } from "./window_rows";
import { socketAddress } from "../address";

const READ = 100; // ms between two readings of the numbers
const SAY = 4000; // ms between two sentences for those who listen
const REST = 120; // ms without another wish after which the plots are filled
const AHEAD = 1.5; // s of playing that are fetched before they are needed
const WAITS = 700; // ms for a row after which the page says that it waits

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
  private readonly subject: Subject;
  private readonly header: Header;
  private readonly world: WorldPanel;
  private readonly readouts: Readings;
  private readonly legend: Legend;
  private readonly model: ModelPanel;
  private readonly modes: ModePanel | null = null;
  private readonly target: TargetPane | null = null;
  private readonly shapes: Shapes;
  private readonly plots: Plots;
  private readonly silence: Silence = { disconnected: true, gone: false, servoEnded: false, stale: false, coils: NaN, missingPose: "", tripProgram: "" };
  private readonly costs: { scene: number[]; plots: number[] } = { scene: [], plots: [] };
  private wish = { t: 0, speed: 0, at: 0 };
  private shown = { t: 0, tick: NaN, row: -1, drawn: 0 };
  private place: Place | null = null;
  private fresh = false;
  private spoilt = false; // the plots' samples are not those before the row
  private worldKey = "";
  private readAt = 0;
  private saidAt = 0;
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
    this.readouts = this.scene.readings(session);
    this.model = new ModelPanel(session.models, () => undefined);
    if (session.modes.length) {
      this.modes = new ModePanel(() => undefined);
      this.target = new TargetPane(session.world.scene, session.world.shapes, this.detailControl.best);
    }
    this.plots = new Plots(this.history, session, this.scene);
    this.subject = this.scene.subject(this.stage, session);
    this.shapes = this.target?.shapes ?? new Shapes(this.stage, 1000, session.world.shapes, at("arrows"));
    if (this.scene.colours === "currents") this.legend.coils(this.subject.range, session.scene.gives);
    this.legend.arrows(); // a world whose code is not here has no colours, but its force is drawn
    this.legend.device(session.scene);
    new Drag(this.stage.canvas, this.subject, this.orbit, () => undefined).enabled = false;
    fill(session, this.scene, [], KEYS);
    hideControls(session.played);
    this.freezePanels();
    this.detail();
    this.buttons();
    const url = socketAddress(`ws?recording=${recording}`);
    this.source = new RowSource(url, token(), session.played.rows, session.played.start, {
      onOpen: () => this.onOpen(),
      onClose: () => this.onClose(),
      row: (frame, row) => this.take({ frame, index: 0, row }),
      block: (number) => this.come(number),
      picture: (frame) => this.picture(frame),
      event: (event) => this.event(event),
    });
    this.window = new WindowRows(this.history, this.source);
    requestAnimationFrame((now) => this.frame(now));
  }

  /** What the timeline may ask. */
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
      forceAt: (direction) => page.subject.forceAt(direction).force,
    };
  }

  private get state() {
    const now = status(this.sample, this.session, this.silence);
    if (this.silence.disconnected) {
      return { ...now, reason: "The viewer's server does not answer; this page comes back by itself when it does. If it has ended, start `haptorb view` again." };
    }
    return now.reason ? { ...now, reason: `As recorded: ${now.reason}`, engageable: false } : { ...now, engageable: false };
  }

  private get rate(): number {
    const { rows, seconds } = this.session.played;
    return seconds > 0 ? (rows - 1) / seconds : 1000;
  }

  /** Samples that the plots can show before the row. */
  private get reach(): number {
    const span = Number(at<HTMLSelectElement>("span").value);
    return Math.min(Math.ceil(span * this.rate) + 2, 60_000);
  }

  private get settled(): boolean {
    return this.place !== null && !this.spoilt && this.wishedRow === this.shown.row;
  }

  private get wishedRow(): number {
    return this.source.find(this.wish.t)?.row ?? -1;
  }

  private show(t: number, speed: number): void {
    const { seconds } = this.session.played;
    const clipped = Math.min(Math.max(t, 0), seconds);
    if (clipped === this.wish.t && speed === this.wish.speed && this.place) return;
    this.wish = { t: clipped, speed, at: performance.now() };
    if (this.plots.paused) this.plots.pause(false);
    this.look();
  }

  /** The wished row, if it is here; else it is asked for. */
  private look(): void {
    const place = this.source.find(this.wish.t);
    if (place) this.take(place);
    else this.source.at(this.wish.t);
    if (this.wish.speed > 0) this.fetch();
  }

  private neighbour(steps: number): number {
    const place = this.source.row(Math.min(Math.max(this.shown.row + steps, 0), this.session.played.rows - 1));
    if (!place) return this.shown.t + steps / this.rate;
    return place.frame.t0 + place.frame.data[place.index * place.frame.width]! - this.session.played.start;
  }

  /** Show this row at the next frame. */
  private take(place: Place): void {
    const { frame, index, row } = place;
    this.place = place;
    if (row === this.shown.row && !Number.isNaN(this.shown.tick)) return;
    this.sample.row.set(frame.data.subarray(index * frame.width, (index + 1) * frame.width));
    this.sample.t = frame.t0 + frame.data[index * frame.width]!;
    this.silence.coils = this.sample.number("coil_state");
    this.shown.t = this.sample.t - this.session.played.start;
    this.shown.tick = frame.tick0 + this.sample.number("tick");
    this.shown.row = row;
    this.fresh = true;
    this.spoilt = true;
    this.changeWorld();
  }

  /** Blocks that are needed: what is shown and comes next, then what the plots show. */
  private fetch(): void {
    const { row } = this.shown;
    if (row < 0) return;
    const now = Math.floor(row / BLOCK);
    const wanted = [now];
    const ahead = this.wish.speed > 0 ? Math.ceil((AHEAD * this.wish.speed * this.rate) / BLOCK) : 1;
    for (let k = 1; k <= Math.min(ahead, 20); k++) wanted.push(now + k);
    const first = Math.floor(Math.max(0, row - this.reach) / BLOCK);
    for (let k = now - 1; k >= first; k--) wanted.push(k);
    this.source.want(wanted);
  }

  private come(number: number): void {
    this.spoilt = true;
    // A single row was shown while its block was on its way.
    if (number === Math.floor(this.shown.row / BLOCK)) this.look();
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
        this.target?.build((event["scene"] ?? null) as TargetScene | null);
        this.freezePanels();
        // The map of another world must not stand under this one's numbers until its own has come.
        if (this.scene.colours === "force") this.subject.forget();
        this.fresh = true;
        break;
      case "unpainted":
      case "mistake":
        this.showMistake(String(event["text"]));
    }
  }

  private picture(frame: Mesh | ForceMap | Rows): void {
    if (frame.kind === "mesh") this.subject.shape(frame);
    else if (frame.kind === "force map") {
      this.subject.paint(frame);
      this.legend.scale(this.subject.range);
    }
  }

  /** Nothing here can be set: a recording is as it is. */
  private freezePanels(): void {
    this.world.enable(false);
    this.model.enable(false);
    this.modes?.enable(false);
  }

  private onOpen(): void {
    this.silence.disconnected = false;
    this.worldKey = "";
    this.plots.freeze(false);
    at("view").classList.remove("dead");
    cover(null);
    if (this.shown.row >= 0) this.changeWorld();
    this.look();
  }

  /** What is here can still be looked at. */
  private onClose(): void {
    if (this.silence.disconnected) return;
    this.silence.disconnected = this.silence.gone = true;
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
      this.subject.show(this.sample);
      this.target?.show(this.sample);
      this.shapes.show(this.sample);
      this.legend.show(this.sample);
      this.shown.drawn++;
    }
    const begun = performance.now();
    if (this.stage.draw(now)) {
      if (this.detailControl.frame(now)) this.detail();
      keep(this.costs.scene, performance.now() - begun);
    }
    this.target?.draw(now);
    this.plot(now);
    this.updateText(now);
  }

  /** The plots follow the row, as far as their samples are here; while it is scrubbed they wait. */
  private plot(now: number): void {
    const begun = performance.now();
    const rested = begun - this.wish.at > REST;
    let changed = false;
    if (this.place && this.spoilt && (this.wish.speed > 0 || rested)) {
      changed = this.window.fill(this.place, this.reach);
      if (this.window.reaches(this.shown.row, this.reach)) this.spoilt = false;
      else if (begun - this.blockAt > REST) {
        this.blockAt = begun;
        if (!changed) changed = this.window.renew(this.shown.row, this.reach);
        this.fetch();
      }
    }
    if (this.plots.draw(now, changed) && changed) keep(this.costs.plots, performance.now() - begun);
  }

  private updateText(now: number): void {
    if (now - this.readAt < READ) return;
    this.readAt = now;
    this.header.status(this.state, false);
    if (this.shown.row >= 0) {
      this.readouts.show(this.sample);
      this.modes?.show(this.sample);
      this.header.loop(loopHealth(this.history));
    }
    uncover();
    const waits = this.shown.row < 0 || (this.place === null && performance.now() - this.wish.at > WAITS);
    const note = at("dropped");
    note.hidden = !waits;
    if (waits) write(note, "reading …");
    if (this.wish.speed > 0 || now - this.saidAt < SAY || this.shown.row < 0) return;
    this.saidAt = now;
    write(at("polite"), [this.readouts.sentence(this.sample), this.modes?.sentence(this.sample) ?? ""].filter(Boolean).join("; "));
  }

  private detail(): void {
    const { level } = this.detailControl;
    this.stage.level = level;
    if (this.target) this.target.level = level;
    this.plots.every = DETAIL[level].plots;
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
      this.spoilt = true;
      this.window.forget();
    });
    new ResizeObserver(() => this.viewMoved()).observe(at("view"));
    // The keys are the timeline's, wherever the focus is; those of this page come after them.
    addEventListener("keydown", (event) => {
      if (parent.timeline?.key(event)) return;
      if (event.ctrlKey || event.metaKey || event.altKey || (event.target as HTMLElement).closest("input, select")) return;
      if (event.key === "0") this.orbit.reset();
      else if (event.key === "?") at("ask").click();
    });
  }
}

/** The last few hundred numbers of a kind. */
function keep(list: number[], value: number): void {
  list.push(value);
  if (list.length > 500) list.shift();
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
  cover(
    mistake instanceof UnknownToken
      ? UNKNOWN
      : { title: "This recording cannot be shown", text: `${mistake instanceof Error ? mistake.message : mistake}. If \`haptorb view\` still runs, load this page again.` },
  ),
);

