// The console: joins the socket, the picture, the panels and the keys. One loop, drawn once per frame.

import { History } from "./history";
import { listen } from "./keys";
import { Link } from "./link";
import { fill, uncover } from "./panels/dialogs";
import { at, write } from "./panels/dom";
import { Header, type Health } from "./panels/header";
import { Legend } from "./panels/legend";
import { cover, full, UNKNOWN, UNREACHED } from "./panels/lock";
import { FeelPanel } from "./panels/feel";
import { ModelPanel } from "./panels/model";
import { ModePanel } from "./panels/modes";
import { Plots } from "./panels/plots";
import { WorldPanel } from "./panels/world";
import { expose } from "./probe";
import { dot, norm, Sample } from "./sample";
import { firstOf, type DeviceScene, type Readings } from "./scene/device_scene";
import { requestedLevel, DETAIL, DetailControl } from "./scene/detail";
import { isDrawnInSoftware } from "./scene/graphics";
import { Drag } from "./scene/drag";
import { Orbit } from "./scene/orbit";
import { sceneOf } from "./scene/scenes";
import { Shapes } from "./scene/shapes";
import { Stage } from "./scene/stage";
import type { Subject, Wish } from "./scene/subject";
import { TargetPane } from "./scene/target_pane";
import { listenToViewButtons } from "./scene/view_buttons";
import { Rumble } from "./senses/rumble";
import { Sound } from "./senses/sound";
import { session as fetchSession, UnknownToken, token, type FeelState, type Session, type Shape, type TargetScene, type Values, type World } from "./session";
import { status, type Silence } from "./status";
import { Vector3 } from "three";
import type { Rows } from "./wire";

const READ = 100; // ms between two readings of the numbers
const SAY = 4000; // ms between two sentences for those who listen
const NOTED = 8000; // ms for which a note stands that nobody must act upon
const FULL = 1013; // the server's word for too many pages
const STALE = 500; // ms without a sample after which nothing is live
const RETRY = 1000; // ms until the server is asked again who it is

class Console {
  private readonly sample: Sample;
  private readonly history: History;
  private readonly detailControl: DetailControl;
  private readonly stage: Stage;
  readonly orbit: Orbit;
  private readonly scene: DeviceScene;
  readonly subject: Subject;
  private readonly drag: Drag;
  private readonly header: Header;
  private readonly world: WorldPanel;
  private readonly readouts: Readings;
  private readonly legend: Legend;
  private readonly model: ModelPanel;
  private readonly modes: ModePanel | null = null;
  private readonly target: TargetPane | null = null;
  readonly shapes: Shapes;
  private readonly feel: FeelPanel | null = null;
  readonly plots: Plots;
  private readonly sound = new Sound();
  private readonly rumble = new Rumble();
  private readonly link: Link;
  private readonly silence: Silence = { disconnected: true, gone: false, servoEnded: false, stale: true, coils: NaN, missingPose: "", tripProgram: "" };
  private readonly sendTimes: number[] = [];
  private readonly answers: number[] = [];
  private readonly arrivals: number[] = [];
  private readonly latencies: number[] = [];
  private readonly sceneCosts: number[] = [];
  private readonly plotCosts: number[] = [];
  control = false;
  private fresh = false;
  private arrived = 0;
  private wasDead = false;
  private changes = 0; // of the socket: opened, closed
  private echo = NaN;
  private touched = false;
  private frames = 0;
  private drawn = 0;
  private dropped = 0;
  private droppedAt = -Infinity;
  private readAt = 0;
  private saidAt = 0;
  private mistakeTimer = 0;
  private health: Health | null = null;
  private noticed = "false false";

  constructor(private readonly session: Session) {
    this.sample = new Sample(session.columns);
    this.history = new History(session.columns);
    const wanted = requestedLevel();
    this.detailControl = new DetailControl(wanted ?? (isDrawnInSoftware() ? "layered" : "full"), wanted !== null);
    this.stage = new Stage(at<HTMLCanvasElement>("scene"), this.detailControl.best);
    this.scene = sceneOf(session);
    this.orbit = new Orbit(this.stage.camera, () => this.viewMoved(), this.scene.home(session));
    this.legend = this.scene.colours === "force" ? new Legend() : new Legend(["", ""]);
    this.header = new Header(session, () => this.command({ do: "engage" }));
    this.world = new WorldPanel(session, (name, values) => this.command({ do: "world", name, values }));
    this.readouts = this.scene.readings(session);
    this.model = new ModelPanel(session.models, (command) => this.command(command));
    this.model.show(session.world.model);
    if (session.modes.length) {
      this.modes = new ModePanel((command) => this.command(command));
      this.target = new TargetPane(session.world.scene, session.world.shapes, this.detailControl.best);
    }
    if (session.feel) this.feel = new FeelPanel(session.feel, (act) => this.command({ ...act, do: "feel" }));
    this.plots = new Plots(this.history, session, this.scene);
    this.subject = this.scene.subject(this.stage, session);
    // In the frame of what the world acts on: a motor's target has a picture of its own.
    this.shapes = this.target?.shapes ?? new Shapes(this.stage, 1000, session.world.shapes, at("arrows"));
    if (this.scene.colours === "currents") this.legend.coils(this.subject.range, session.scene.gives);
    if (this.scene.colours === "none") this.legend.arrows();
    this.legend.device(session.scene);
    this.link = new Link(token(), 1000 * session.patience, {
      onOpen: () => void this.onOpen(),
      onClose: (code, reason) => void this.onClose(code, reason),
      frame: (frame, came) => {
        if (frame.kind === "rows") this.rows(frame, came);
        else if (frame.kind === "mesh") this.subject.shape(frame);
        else {
          this.subject.paint(frame);
          this.legend.scale(this.subject.range);
        }
      },
      event: (event) => this.event(event),
    });
    this.drag = new Drag(this.stage.canvas, this.subject, this.orbit, (wish, stamp, held) => this.hold(wish, stamp, held));
    fill(session, this.scene, this.subject.keys);
    this.detail();
    this.buttons();
    listen(this);
    document.addEventListener("visibilitychange", () => this.onHide());
    this.probe();
    requestAnimationFrame((now) => this.frame(now));
  }

  /** The tool's buttons that a person holds down, for programs that are connected. */
  press(buttons: string[]): void {
    if (this.health?.connections?.length) this.command({ do: "buttons", pressed: buttons });
  }

  /** Coils off, at once, whoever asks. */
  stop(by: string): void {
    this.command({ do: "stop" });
    this.header.disarm();
    write(at("polite"), `Stop sent (${by}).`);
  }

  /** The hand was moved by a key: it rests there. */
  rest(wish: Wish, stamp: number): void {
    this.hold(wish, stamp, false);
  }

  private hold(wish: Wish, stamp: number, held: boolean): void {
    if (!this.control) return;
    this.link.point({ stamp, ...wish, held });
    keep(this.sendTimes, performance.now() - stamp);
    this.touched = true;
    at("hint").hidden = true;
  }

  /** Whoever does not see the page does not hold the stylus: a hidden page is not run often enough to say so in time. */
  private onHide(): void {
    if (!document.hidden || !this.drag.held) return;
    this.drag.abandon();
    this.link.drop();
  }

  private command(command: Record<string, unknown> & { values?: Values }): void {
    this.link.command(command);
  }

  private async onOpen(): Promise<void> {
    if (!this.silence.disconnected) return;
    // After an interruption another servo may answer: then this page knows the wrong device.
    const opened = ++this.changes;
    const again = await fetchSession().catch(() => null);
    if (opened !== this.changes) return; // closed meanwhile
    if (again && again.started !== this.session.started) location.reload();
    this.silence.disconnected = this.silence.gone = false;
    this.silence.servoEnded = false;
  }

  private async onClose(code: number, reason: string): Promise<void> {
    const closed = ++this.changes;
    this.silence.disconnected = true;
    this.control = false;
    this.forget();
    if (code === FULL) cover(full(reason));
    else {
      // Is there nobody, somebody who does not know it, or one who is slow? A refused connection is a TypeError.
      const mistake: unknown = await fetchSession().catch((mistake: unknown) => mistake);
      if (closed !== this.changes) return;
      if (mistake instanceof UnknownToken) cover(UNKNOWN);
      this.silence.gone = mistake instanceof TypeError;
    }
  }

  /** Nothing is live: take every number away at once. */
  private forget(): void {
    this.sample.forget();
    this.health = null;
    this.header.loop(null);
    this.subject.forget();
    this.readouts.show(this.sample);
    this.legend.show(this.sample);
    this.modes?.show(this.sample);
    this.model.enable(false);
    this.modes?.enable(false);
    this.feel?.enable(false);
    this.target?.forget();
    this.shapes.forget();
    this.plots.freeze(true);
    at("view").classList.add("dead");
    at("hint").hidden = true;
    this.world.enable(false);
    this.sound.play(0, 0);
    this.wasDead = true;
  }

  private revive(): void {
    this.wasDead = false;
    this.plots.freeze(false);
    this.subject.live();
    at("view").classList.remove("dead");
    this.world.enable(this.control);
    this.model.enable(this.control);
    this.modes?.enable(this.control);
    this.feel?.enable(this.control);
    this.target?.live();
  }

  private rows(frame: Rows, came: number): void {
    if (this.silence.disconnected || !frame.count) return;
    if (frame.t0 < this.history.newest - 1) this.history.clear();
    cover(null);
    this.history.append(frame);
    this.sample.row.set(frame.data.subarray((frame.count - 1) * frame.width));
    this.sample.t = this.history.newest;
    this.silence.coils = this.sample.number("coil_state");
    this.frames++;
    if (frame.dropped > this.dropped) this.droppedAt = performance.now();
    this.dropped = frame.dropped;
    this.arrived = performance.now();
    this.fresh = true;
    if (Number.isNaN(frame.echo)) return;
    this.echo = frame.echo;
    keep(this.answers, came - frame.echo);
    keep(this.arrivals, this.arrived - frame.echo);
  }

  private event(event: Record<string, unknown> & { event: string }): void {
    switch (event.event) {
      case "role":
        this.control = event["control"] === true;
        at("watching").hidden = this.control;
        at("watching").title = "Another page is in control. This one can still stop the device.";
        at<HTMLButtonElement>("cool").disabled = !this.control;
        this.drag.enabled = this.control && this.session.steered;
        this.world.enable(this.control);
        this.model.enable(this.control);
        this.modes?.enable(this.control);
        this.feel?.enable(this.control);
        break;
      case "feel":
        this.feel?.show(event as unknown as FeelState);
        break;
      case "worlds":
        this.world.offer(event["worlds"] as World[]);
        break;
      case "world":
        this.world.show(event["name"] as string, event["values"] as Values);
        this.world.remark((event["remarks"] ?? []) as string[]);
        this.model.show(event["model"] as string);
        this.shapes.build((event["shapes"] ?? []) as Shape[]);
        this.target?.build((event["scene"] ?? null) as TargetScene | null);
        break;
      case "health":
        this.silence.servoEnded = event["alive"] === false;
        this.silence.missingPose = String(event["missing_pose"] ?? "");
        this.silence.tripProgram = String(event["trip_program"] ?? "");
        this.health = event as unknown as Health;
        this.header.showConnections(this.health.connections ?? []);
        this.notice(this.health);
        break;
      case "mistake":
        this.showMistake(String(event["text"]));
    }
  }

  /** What a person should know beside the numbers, once; the recorder's trouble also stays in the header. */
  private notice(health: Health): void {
    // The texts count seconds and megabytes: that is no news.
    const kinds = `${Boolean(health.recording_trouble)} ${health.warning.replaceAll(/\d/g, "")}`;
    if (kinds === this.noticed) return;
    this.noticed = kinds;
    const text = [health.recording_trouble && `Recording: ${health.recording_trouble}`, health.warning].filter(Boolean);
    if (text.length) this.showMistake(text.join("; "));
    else at("mistake").hidden = true;
    // Whoever writes a world reads the place in its code for as long as it is wrong.
    if (health.world_trouble) clearTimeout(this.mistakeTimer);
  }

  private showMistake(text: string): void {
    const box = at("mistake");
    write(box, text);
    box.hidden = false;
    clearTimeout(this.mistakeTimer);
    this.mistakeTimer = window.setTimeout(() => (box.hidden = true), NOTED);
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    this.silence.stale = performance.now() - this.arrived > STALE;
    const dead = this.silence.disconnected || this.silence.servoEnded || this.silence.stale;
    // Silence alone does not open the hand that holds: when samples come again, it is still there.
    if (this.silence.disconnected || this.silence.servoEnded) this.drag.letGo(now);
    if (dead && !this.wasDead) this.forget();
    else if (!dead && this.wasDead) this.revive();
    if (this.fresh && !dead) {
      this.subject.show(this.sample);
      this.target?.show(this.sample);
      this.shapes.show(this.sample);
      this.legend.show(this.sample);
      this.senses(now);
    }
    const begun = performance.now();
    if (this.stage.draw(now)) {
      this.drawn++;
      if (this.detailControl.frame(now)) this.detail();
      keep(this.sceneCosts, performance.now() - begun);
    }
    this.target?.draw(now);
    this.measure();
    const plotting = performance.now();
    if (this.plots.draw(now, this.fresh && !dead)) keep(this.plotCosts, performance.now() - plotting);
    this.fresh = false;
    this.updateText(now, dead);
  }

  /** From the pointer's event to the force that answers it, drawn. */
  private measure(): void {
    if (Number.isNaN(this.echo)) return;
    keep(this.latencies, performance.now() - this.echo);
    this.echo = NaN;
  }

  /** Draw as much as there is time for, and say so when that is less than all. */
  private detail(): void {
    const { level } = this.detailControl;
    this.stage.level = level;
    if (this.target) this.target.level = level;
    this.plots.every = DETAIL[level].plots;
    const note = at("detail");
    note.hidden = level === "full";
    write(note, this.detailControl.best === "full" ? "less detail: drawing was slow" : "less detail: no graphics processor");
  }

  private updateText(now: number, dead: boolean): void {
    const present = status(this.sample, this.session, this.silence);
    this.header.status(present, this.control);
    if (now - this.readAt < READ) return;
    this.readAt = now;
    if (!dead) {
      this.readouts.show(this.sample);
      this.modes?.show(this.sample);
      this.header.loop(this.health);
    }
    const lost = at("dropped");
    lost.hidden = performance.now() - this.droppedAt > NOTED;
    if (this.dropped) write(lost, `${this.dropped} samples not shown: this page was too slow`);
    this.hint(dead);
    uncover();
    if (!dead && now - this.saidAt > SAY) {
      this.saidAt = now;
      const words = [this.readouts.sentence(this.sample), this.modes?.sentence(this.sample) ?? ""];
      write(at("polite"), words.filter(Boolean).join("; "));
    }
  }

  private hint(dead: boolean): void {
    const hint = at("hint");
    // Whoever reads why there is no force need not be shown how to feel it.
    if (!at("alert").hidden) return void (hint.hidden = true);
    if (this.touched || dead || !this.control || !this.session.steered) return;
    const { x, y } = this.subject.anchor();
    write(hint, this.subject.hint);
    hint.hidden = false;
    // In the part of the picture that nothing else needs; where that is too small, not at all.
    const free = at("free");
    const [right, bottom] = [free.clientWidth - hint.offsetWidth, free.clientHeight - hint.offsetHeight];
    if (right < 0 || bottom < 0) hint.hidden = true;
    const left = Math.min(Math.max(x + 22 - free.offsetLeft, 0), right);
    const top = Math.min(Math.max(y - 4 - free.offsetTop, 0), bottom);
    hint.style.transform = `translate(${left.toFixed(0)}px, ${top.toFixed(0)}px)`;
  }

  private senses(now: number): void {
    const force = this.sample.vector("wrench_actual", firstOf(this.session.scene.gives));
    const size = norm(force);
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    const share = size / this.session.limits[this.session.scene.gives];
    this.sound.play(share, size > 0.01 ? dot(force, right.toArray()) / size : 0);
    this.rumble.play(share, now);
  }

  private viewMoved(): void {
    this.stage.touch();
    this.legend.length(this.stage.scale(this.orbit.distance));
  }

  private buttons(): void {
    // On the way down, not up: a stop does not wait for a finger.
    at("stop").addEventListener("pointerdown", () => this.stop("button"));
    at("stop").addEventListener("click", (event) => event.detail === 0 && this.stop("button"));
    at("sound").addEventListener("click", () => at("sound").setAttribute("aria-pressed", String(this.sound.toggle())));
    at("rumble").addEventListener("click", () => at("rumble").setAttribute("aria-pressed", String(this.rumble.toggle())));
    const cool = at<HTMLButtonElement>("cool");
    cool.hidden = !this.session.simulated;
    cool.addEventListener("click", () => this.command({ do: "cool" }));
    listenToViewButtons(this.orbit);
    new ResizeObserver(() => this.viewMoved()).observe(at("view"));
  }

  private probe(): void {
    const page = this;
    expose({
      get frames() {
        return page.frames;
      },
      get drawn() {
        return page.drawn;
      },
      get dropped() {
        return page.dropped;
      },
      get status() {
        return status(page.sample, page.session, page.silence).word;
      },
      get latencies() {
        return [...page.latencies];
      },
      get parts() {
        return { sent: median(page.sendTimes), answered: median(page.answers), arrived: median(page.arrivals), drawn: median(page.latencies) };
      },
      get costs() {
        return { scene: median(page.sceneCosts), plots: median(page.plotCosts) };
      },
      get level() {
        return page.detailControl.level;
      },
      get kept() {
        return page.stage.kepts;
      },
      get arrow() {
        return page.subject.arrowVisible;
      },
      get range() {
        return page.subject.range;
      },
      get control() {
        return page.control;
      },
      get samples() {
        return page.plots.samples;
      },
      get heap() {
        return (performance as { memory?: { usedJSHeapSize: number } }).memory?.usedJSHeapSize ?? NaN;
      },
      value: (name) => Array.from(page.sample.list(name)),
      forceAt: (direction) => page.subject.forceAt(direction),
      stylus: () => page.subject.places(),
      picture: () => page.subject.picture?.() ?? { coils: 0, mover: [] },
      shapes: () => page.shapes.places,
      spots: () => page.shapes.spots,
      plug: () => page.target?.shown ?? { place: [], bent: [] },
    });
  }
}

/** The last few hundred numbers of a kind. */
function keep(list: number[], value: number): void {
  list.push(value);
  if (list.length > 500) list.shift();
}

const median = (list: number[]): number => [...list].sort((a, b) => a - b)[list.length >> 1] ?? NaN;

// Another address pasted over this one differs only behind the #, and would load nothing by itself.
addEventListener("hashchange", () => location.reload());

/** Once somebody answers: a connection that was lost while the page loads must not leave it empty for good. */
async function begin(): Promise<void> {
  const answer = await fetchSession().catch((mistake: unknown) => mistake);
  if (answer instanceof UnknownToken) cover(UNKNOWN);
  else if (answer instanceof Error) {
    cover(UNREACHED);
    setTimeout(() => void begin(), RETRY);
  } else new Console(answer as Session);
}

if (!token()) cover(UNKNOWN);
else void begin();
