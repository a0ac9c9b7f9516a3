// Second view: the object that a motor moves, with camera, scale bar and buttons of its own.

import { at, write } from "../panels/dom";
import type { Sample, Vector } from "../sample";
import type { Shape, ObjectScene } from "../session";
import type { DetailLevel } from "./detail";
import { Orbit, type Home } from "./orbit";
import { Shapes } from "./shapes";
import { Stage } from "./stage";
import { ObjectDrawing, UNITS_PER_M } from "./object_drawing";

const HOME: Home = { azimuth: -78, elevation: 52, distance: 360, centre: [56, -14, -22] };
const INITIAL_PLUG_DISTANCE_M = 17e-3; // of the plug from the socket

export class ObjectPane {
  private readonly home: Home = { ...HOME };
  private framed = "";
  private scene: ObjectScene | null = null;
  private readonly stage: Stage;
  private readonly orbit: Orbit;
  private readonly drawing: ObjectDrawing;
  readonly shapes: Shapes;
  private readonly pointers = new Map<number, { x: number; y: number }>();

  constructor(scene: ObjectScene | null, shapes: Shape[], best: DetailLevel) {
    this.stage = new Stage(at<HTMLCanvasElement>("target-scene"), best);
    this.orbit = new Orbit(this.stage.camera, () => this.updateScale(), this.home);
    this.drawing = new ObjectDrawing(this.stage);
    this.shapes = new Shapes(this.stage, UNITS_PER_M, shapes, at("bodies"));
    this.build(scene);
    const { canvas } = this.stage;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      canvas.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    const views: Record<string, () => void> = {
      left: () => this.orbit.turn(-15, 0),
      right: () => this.orbit.turn(15, 0),
      in: () => this.orbit.zoom(1 / 1.25),
      out: () => this.orbit.zoom(1.25),
      reset: () => this.orbit.reset(),
    };
    for (const button of document.querySelectorAll<HTMLElement>("[data-target-view]")) {
      button.addEventListener("click", views[button.dataset["targetView"]!]!);
    }
    new ResizeObserver(() => {
      this.frameAll();
      this.updateScale();
    }).observe(at("target-free"));
  }

  /** Set the level of detail. */
  set level(level: DetailLevel) {
    this.stage.level = level;
  }

  /** Replace the object after a change of world or values. */
  build(scene: ObjectScene | null): void {
    this.drawing.build(scene);
    const { scene: bodies } = this.shapes;
    this.drawing.drawn = !bodies;
    // Only snap-fit worlds have a plug with hooks.
    for (const one of document.querySelectorAll<HTMLElement>("[data-held]")) write(one, bodies ? "body" : "plug");
    at("hooks").hidden = bodies;
    this.scene = scene;
    this.stage.centre = null;
    this.frameAll();
  }

  show(sample: Sample): void {
    this.drawing.show(sample);
  }

  draw(now: number): void {
    this.stage.draw(now);
  }

  forget(): void {
    this.drawing.forget();
    at("target").classList.add("dead");
  }

  live(): void {
    at("target").classList.remove("dead");
  }

  /** Drawn position and deflections, for tests. */
  get shown(): { place: Vector; bent: number[] } {
    return { place: this.drawing.place, bent: [...this.drawing.bent] };
  }

  private frameAll(): void {
    if (this.scene) this.frame(this.scene);
    else if (this.shapes.scene) this.frameShapes();
  }

  /** Fit socket and plug, in its initial position, into the view. */
  private frame({ root, floor, outline }: ObjectScene): void {
    const from = (Math.min(root, floor) - 2.5e-3) * UNITS_PER_M;
    const to = (outline.at(-1)![0] + INITIAL_PLUG_DISTANCE_M) * UNITS_PER_M;
    this.fitView([(from + to) / 2, -14, -22], 0.58 * (to - from)); // perspective enlarges the nearer end
  }

  /** Fit a MuJoCo scene into the view. */
  private frameShapes(): void {
    const { centre, radius } = this.shapes.extent;
    this.fitView(centre.map((one) => one * UNITS_PER_M) as Home["centre"], 1.25 * radius * UNITS_PER_M);
  }

  /** Fit a length of ±`reach` about `centre` into the free area between buttons and readouts. */
  private fitView(centre: Home["centre"], reach: number): void {
    const free = at("target-free");
    const [width, height] = [Math.max(60, free.clientWidth) / 2, Math.max(60, free.clientHeight) / 2];
    this.stage.centre = { x: free.offsetLeft + free.clientWidth / 2, y: free.offsetTop + free.clientHeight / 2 };
    const turned = this.orbit.distance / this.home.distance;
    this.home.centre = centre;
    // Less height than width, because plug and held body mainly move sideways.
    this.home.distance = Math.max(this.stage.fit(reach, width), this.stage.fit(0.56 * reach, height));
    const home = JSON.stringify(this.home);
    if (home === this.framed) return; // unchanged size: keep the user's view
    const other = this.orbit.centre.toArray().some((one, i) => one !== this.home.centre[i]);
    this.framed = home;
    this.orbit.centre.set(...this.home.centre);
    if (other) this.orbit.reset();
    else this.orbit.zoom((turned * this.home.distance) / this.orbit.distance); // the page was resized
  }

  private drag(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const spread = Math.hypot(now.x - other.x, now.y - other.y);
      if (spread > 1) this.orbit.zoom(Math.hypot(before.x - other.x, before.y - other.y) / spread);
    } else this.orbit.turn((before.x - now.x) * 0.4, (now.y - before.y) * 0.4);
    this.pointers.set(event.pointerId, now);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.orbit.zoom(Math.exp(event.deltaY * 0.001));
  }

  private updateScale(): void {
    this.stage.touch();
    const pixels = (this.stage.scale(this.orbit.distance) * UNITS_PER_M) / 1000;
    const millimetres = [1, 2, 5, 10].find((mm) => mm * pixels > 35) ?? 20;
    const box = at("target-scale");
    box.querySelector<HTMLElement>("span")!.style.width = `${millimetres * pixels}px`;
    write(box.querySelector("b")!, `${millimetres} mm`);
  }
}
