// Console page: connects WebSocket, 3D view, panels and keys, and redraws once per animation frame.

import { History } from "./history";
import { listenToKeys } from "./keys";
import { Link } from "./link";
import { fillDialogs, placeDialogBelowAlert } from "./panels/dialogs";
import { at, write } from "./panels/dom";
import { Header, type Health } from "./panels/header";
import { Legend } from "./panels/legend";
import { coverPage, MISSING_TOKEN, NO_RESPONSE, tooManyPages } from "./panels/lock";
import { FeelPanel } from "./panels/feel";
import { ModelPanel } from "./panels/model";
import { ModePanel } from "./panels/modes";
import { Plots } from "./panels/plots";
import { WorldPanel } from "./panels/world";
import { exposeProbe } from "./probe";
import { dot, norm, Sample } from "./sample";
import { firstOf, type DeviceScene, type ReadoutPanel } from "./scene/device_scene";
import { requestedLevel, DETAIL, DetailControl } from "./scene/detail";
import { isDrawnInSoftware } from "./scene/graphics";
import { Drag } from "./scene/drag";
import { Orbit } from "./scene/orbit";
import { sceneOf } from "./scene/scenes";
import { Shapes } from "./scene/shapes";
import { Stage } from "./scene/stage";
import type { DeviceDrawing } from "./scene/device_drawing";
import { ObjectPane } from "./scene/object_pane";
import { listenToViewButtons } from "./scene/view_buttons";
import { Rumble } from "./senses/rumble";
import { Sound } from "./senses/sound";
import { fetchSession, UnknownToken, token, type FeelState, type Session, type Shape, type ObjectScene, type Values, type World } from "./session";
import { status, type LinkState } from "./status";
import { Vector3 } from "three";
import type { HandGoal, Rows } from "./wire";

const READOUT_INTERVAL_MS = 100;
const ANNOUNCE_INTERVAL_MS = 4000; // of the readouts for screen readers
const NOTICE_DURATION_MS = 8000; // of notices that require no action
const CLOSE_CODE_FULL = 1013; // the server has too many pages open
const STALE_AFTER_MS = 500; // without a sample
const RETRY_INTERVAL_MS = 1000; // of the request for the session description
const MAX_TIMINGS = 500; // kept of each kind

class Console {
  private readonly sample: Sample;
  private readonly history: History;
  private readonly detailControl: DetailControl;
  private readonly stage: Stage;
  readonly orbit: Orbit;
  private readonly scene: DeviceScene;
  readonly drawing: DeviceDrawing;
  private readonly drag: Drag;
  private readonly header: Header;
  private readonly world: WorldPanel;
  private readonly readouts: ReadoutPanel;
  private readonly legend: Legend;
  private readonly model: ModelPanel;
  private readonly modes: ModePanel | null = null;
  private readonly objectPane: ObjectPane | null = null;
  readonly shapes: Shapes;
  private readonly feel: FeelPanel | null = null;
  readonly plots: Plots;
  private readonly sound = new Sound();
  private readonly rumble = new Rumble();
  private readonly link: Link;
  private readonly linkState: LinkState = { disconnected: true, serverEnded: false, servoEnded: false, stale: true, coils: NaN, missingPose: "", tripProgram: "" };
  private readonly sendTimes: number[] = [];
  private readonly responseTimes: number[] = [];
  private readonly arrivals: number[] = [];
  private readonly latencies: number[] = [];
  private readonly sceneCosts: number[] = [];
  private readonly plotCosts: number[] = [];
  control = false;
  private fresh = false;
  private arrived = 0;
  private wasDead = false;
  private changes = 0; // count of socket opens and closes
  private echo = NaN;
  private touched = false;
  private frames = 0;
  private drawn = 0;
  private dropped = 0;
  private droppedAt = -Infinity;
  private readAt = 0;
  private announcedAt = 0;
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
    this.readouts = this.scene.readouts(session);
    this.model = new ModelPanel(session.models, (command) => this.command(command));
    this.model.show(session.world.model);
    if (session.modes.length) {
      this.modes = new ModePanel((command) => this.command(command));
      this.objectPane = new ObjectPane(session.world.scene, session.world.shapes, this.detailControl.best);
    }
    if (session.feel) this.feel = new FeelPanel(session.feel, (act) => this.command({ ...act, do: "feel" }));
    this.plots = new Plots(this.history, session, this.scene);
    this.drawing = this.scene.drawing(this.stage, session);
    // Drawn in the frame of the object that the world acts on: a motor's object has a view of its own.
    this.shapes = this.objectPane?.shapes ?? new Shapes(this.stage, 1000, session.world.shapes, at("arrows"));
    if (this.scene.colours === "currents") this.legend.coils(this.drawing.range, session.scene.gives);
    if (this.scene.colours === "none") this.legend.arrows();
    this.legend.device(session.scene);
    this.link = new Link(token(), 1000 * session.heartbeat_timeout, {
      onOpen: () => void this.onOpen(),
      onClose: (code, reason) => void this.onClose(code, reason),
      frame: (frame, receivedAt) => {
        if (frame.kind === "rows") this.rows(frame, receivedAt);
        else if (frame.kind === "mesh") this.drawing.shape(frame);
        else {
          this.drawing.paint(frame);
          this.legend.scale(this.drawing.range);
        }
      },
      event: (event) => this.event(event),
    });
    this.drag = new Drag(this.stage.canvas, this.drawing, this.orbit, (handGoal, stamp, held) => this.hold(handGoal, stamp, held));
    fillDialogs(session, this.scene, this.drawing.keys);
    this.detail();
    this.buttons();
    listenToKeys(this);
    document.addEventListener("visibilitychange", () => this.onHide());
    this.probe();
    requestAnimationFrame((now) => this.frame(now));
  }

  /** Forward the pressed buttons of the tool to connected programs. */
  press(buttons: string[]): void {
    if (this.health?.connections?.length) this.command({ do: "buttons", pressed: buttons });
  }

  /** Switch the coils off at once; a page without control may do it too. */
  stop(by: string): void {
    this.command({ do: "stop" });
    this.header.disarm();
    write(at("polite"), `Stop sent (${by}).`);
  }

  /** Set the hand goal by key, without holding the tool. */
  rest(handGoal: HandGoal, stamp: number): void {
    this.hold(handGoal, stamp, false);
  }

  private hold(handGoal: HandGoal, stamp: number, held: boolean): void {
    if (!this.control) return;
    this.link.point({ stamp, ...handGoal, held });
    pushTiming(this.sendTimes, performance.now() - stamp);
    this.touched = true;
    at("hint").hidden = true;
  }

  /** Release the stylus when the page is hidden: browsers throttle hidden pages, so heartbeats would come too late. */
  private onHide(): void {
    if (!document.hidden || !this.drag.held) return;
    this.drag.abandon();
    this.link.drop();
  }

  private command(command: Record<string, unknown> & { values?: Values }): void {
    this.link.command(command);
  }

  private async onOpen(): Promise<void> {
    if (!this.linkState.disconnected) return;
    // After an interruption another servo may run at this address, and the page would show the wrong device.
    const opened = ++this.changes;
    const again = await fetchSession().catch(() => null);
    if (opened !== this.changes) return; // closed in the meantime
    if (again && again.started !== this.session.started) location.reload();
    this.linkState.disconnected = this.linkState.serverEnded = false;
    this.linkState.servoEnded = false;
  }

  private async onClose(code: number, reason: string): Promise<void> {
    const closed = ++this.changes;
    this.linkState.disconnected = true;
    this.control = false;
    this.forget();
    if (code === CLOSE_CODE_FULL) coverPage(tooManyPages(reason));
    else {
      // Distinguish no server (fetch rejects with a TypeError), a rejected token and a slow server.
      const mistake: unknown = await fetchSession().catch((mistake: unknown) => mistake);
      if (closed !== this.changes) return;
      if (mistake instanceof UnknownToken) coverPage(MISSING_TOKEN);
      this.linkState.serverEnded = mistake instanceof TypeError;
    }
  }

  /** Clear every readout: no value may look live when it is not. */
  private forget(): void {
    this.sample.forget();
    this.health = null;
    this.header.loop(null);
    this.drawing.forget();
    this.readouts.show(this.sample);
    this.legend.show(this.sample);
    this.modes?.show(this.sample);
    this.model.enable(false);
    this.modes?.enable(false);
    this.feel?.enable(false);
    this.objectPane?.forget();
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
    this.drawing.live();
    at("view").classList.remove("dead");
    this.world.enable(this.control);
    this.model.enable(this.control);
    this.modes?.enable(this.control);
    this.feel?.enable(this.control);
    this.objectPane?.live();
  }

  private rows(frame: Rows, receivedAt: number): void {
    if (this.linkState.disconnected || !frame.count) return;
    if (frame.t0 < this.history.newest - 1) this.history.clear();
    coverPage(null);
    this.history.append(frame);
    this.sample.row.set(frame.data.subarray((frame.count - 1) * frame.width));
    this.sample.t = this.history.newest;
    this.linkState.coils = this.sample.number("coil_state");
    this.frames++;
    if (frame.dropped > this.dropped) this.droppedAt = performance.now();
    this.dropped = frame.dropped;
    this.arrived = performance.now();
    this.fresh = true;
    if (Number.isNaN(frame.echo)) return;
    this.echo = frame.echo;
    pushTiming(this.responseTimes, receivedAt - frame.echo);
    pushTiming(this.arrivals, this.arrived - frame.echo);
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
        this.objectPane?.build((event["scene"] ?? null) as ObjectScene | null);
        break;
      case "health":
        this.linkState.servoEnded = event["alive"] === false;
        this.linkState.missingPose = String(event["missing_pose"] ?? "");
        this.linkState.tripProgram = String(event["trip_program"] ?? "");
        this.health = event as unknown as Health;
        this.header.showConnections(this.health.connections ?? []);
        this.notice(this.health);
        break;
      case "mistake":
        this.showMistake(String(event["text"]));
    }
  }

  /** Show each new warning once; recording failures also stay in the header. */
  private notice(health: Health): void {
    // Texts contain counters (seconds, megabytes): a change of digits alone is not a new warning.
    const kinds = `${Boolean(health.recording_trouble)} ${health.warning.replaceAll(/\d/g, "")}`;
    if (kinds === this.noticed) return;
    this.noticed = kinds;
    const text = [health.recording_trouble && `Recording: ${health.recording_trouble}`, health.warning].filter(Boolean);
    if (text.length) this.showMistake(text.join("; "));
    else at("mistake").hidden = true;
    // An error in the user's world stays visible until it is fixed.
    if (health.world_trouble) clearTimeout(this.mistakeTimer);
  }

  private showMistake(text: string): void {
    const box = at("mistake");
    write(box, text);
    box.hidden = false;
    clearTimeout(this.mistakeTimer);
    this.mistakeTimer = window.setTimeout(() => (box.hidden = true), NOTICE_DURATION_MS);
  }

  private frame(now: number): void {
    requestAnimationFrame((next) => this.frame(next));
    this.linkState.stale = performance.now() - this.arrived > STALE_AFTER_MS;
    const dead = this.linkState.disconnected || this.linkState.servoEnded || this.linkState.stale;
    // A gap in the samples alone does not release the stylus; only a lost connection or an ended servo does.
    if (this.linkState.disconnected || this.linkState.servoEnded) this.drag.release(now);
    if (dead && !this.wasDead) this.forget();
    else if (!dead && this.wasDead) this.revive();
    if (this.fresh && !dead) {
      this.drawing.show(this.sample);
      this.objectPane?.show(this.sample);
      this.shapes.show(this.sample);
      this.legend.show(this.sample);
      this.senses(now);
    }
    const drawStart = performance.now();
    if (this.stage.draw(now)) {
      this.drawn++;
      if (this.detailControl.frame(now)) this.detail();
      pushTiming(this.sceneCosts, performance.now() - drawStart);
    }
    this.objectPane?.draw(now);
    this.measure();
    const plotStart = performance.now();
    if (this.plots.draw(now, this.fresh && !dead)) pushTiming(this.plotCosts, performance.now() - plotStart);
    this.fresh = false;
    this.updateText(now, dead);
  }

  /** Record the latency from pointer event to drawn force. */
  private measure(): void {
    if (Number.isNaN(this.echo)) return;
    pushTiming(this.latencies, performance.now() - this.echo);
    this.echo = NaN;
  }

  /** Apply the level of detail, and show a note if it is reduced. */
  private detail(): void {
    const { level } = this.detailControl;
    this.stage.level = level;
    if (this.objectPane) this.objectPane.level = level;
    this.plots.interval = DETAIL[level].plotInterval;
    const note = at("detail");
    note.hidden = level === "full";
    write(note, this.detailControl.best === "full" ? "less detail: drawing was slow" : "less detail: no graphics processor");
  }

  private updateText(now: number, dead: boolean): void {
    const present = status(this.sample, this.session, this.linkState);
    this.header.status(present, this.control);
    if (now - this.readAt < READOUT_INTERVAL_MS) return;
    this.readAt = now;
    if (!dead) {
      this.readouts.show(this.sample);
      this.modes?.show(this.sample);
      this.header.loop(this.health);
    }
    const lost = at("dropped");
    lost.hidden = performance.now() - this.droppedAt > NOTICE_DURATION_MS;
    if (this.dropped) write(lost, `${this.dropped} samples not shown: this page was too slow`);
    this.hint(dead);
    placeDialogBelowAlert();
    if (!dead && now - this.announcedAt > ANNOUNCE_INTERVAL_MS) {
      this.announcedAt = now;
      const words = [this.readouts.sentence(this.sample), this.modes?.sentence(this.sample) ?? ""];
      write(at("polite"), words.filter(Boolean).join("; "));
    }
  }

  private hint(dead: boolean): void {
    const hint = at("hint");
    // While an alert explains why there is no force, the hint would only distract.
    if (!at("alert").hidden) return void (hint.hidden = true);
    if (this.touched || dead || !this.control || !this.session.steered) return;
    const { x, y } = this.drawing.anchor();
    write(hint, this.drawing.hint);
    hint.hidden = false;
    // Place the hint in the free area of the view; hide it if it does not fit.
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
    // On pointerdown, so that the stop does not wait for the release.
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
    exposeProbe({
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
        return status(page.sample, page.session, page.linkState).word;
      },
      get latencies() {
        return [...page.latencies];
      },
      get parts() {
        return { sent: median(page.sendTimes), answered: median(page.responseTimes), arrived: median(page.arrivals), drawn: median(page.latencies) };
      },
      get costs() {
        return { scene: median(page.sceneCosts), plots: median(page.plotCosts) };
      },
      get level() {
        return page.detailControl.level;
      },
      get kept() {
        return page.stage.captures;
      },
      get arrow() {
        return page.drawing.arrowVisible;
      },
      get range() {
        return page.drawing.range;
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
      forceAt: (direction) => page.drawing.forceAt(direction),
      stylus: () => page.drawing.places(),
      picture: () => page.drawing.picture?.() ?? { coils: 0, mover: [] },
      shapes: () => page.shapes.places,
      spots: () => page.shapes.spots,
      plug: () => page.objectPane?.shown ?? { place: [], bent: [] },
    });
  }
}

/** Append `value`, and drop the oldest beyond MAX_TIMINGS. */
function pushTiming(list: number[], value: number): void {
  list.push(value);
  if (list.length > MAX_TIMINGS) list.shift();
}

const median = (list: number[]): number => [...list].sort((a, b) => a - b)[list.length >> 1] ?? NaN;

// A pasted address with another token differs only in the fragment, which does not reload the page by itself.
addEventListener("hashchange", () => location.reload());

/** Start the console once the server responds; retry, so that a failed first request does not leave the page empty. */
async function start(): Promise<void> {
  const answer = await fetchSession().catch((mistake: unknown) => mistake);
  if (answer instanceof UnknownToken) coverPage(MISSING_TOKEN);
  else if (answer instanceof Error) {
    coverPage(NO_RESPONSE);
    setTimeout(() => void start(), RETRY_INTERVAL_MS);
  } else new Console(answer as Session);
}

if (!token()) coverPage(MISSING_TOKEN);
else void start();
