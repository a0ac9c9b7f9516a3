// The second picture: the target scene with its own view, scale bar and buttons.

import { at, write } from "../panels/dom";
import type { Sample, Vector } from "../sample";
import type { Shape, TargetScene } from "../session";
import type { Level } from "./detail";
import { Orbit, type Home } from "./orbit";
import { Shapes } from "./shapes";
import { Stage } from "./stage";
import { Target, UNIT } from "./target";

const HOME: Home = { azimuth: -78, elevation: 52, distance: 360, centre: [56, -14, -22] };
const BEGIN = 17e-3; // m: how far a plug is out when a session begins

export class TargetPane {
  private readonly home: Home = { ...HOME };
  private framed = "";
  private scene: TargetScene | null = null;
  private readonly stage: Stage;
  private readonly orbit: Orbit;
  private readonly target: Target;
  readonly shapes: Shapes;
  private readonly pointers = new Map<number, { x: number; y: number }>();

  constructor(scene: TargetScene | null, shapes: Shape[], best: Level) {
    this.stage = new Stage(at<HTMLCanvasElement>("target-scene"), best);
    this.orbit = new Orbit(this.stage.camera, () => this.updateScale(), this.home);
    this.target = new Target(this.stage);
    this.shapes = new Shapes(this.stage, UNIT, shapes, at("bodies"));
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

  /** How much to draw. */
  set level(level: Level) {
    this.stage.level = level;
  }

  /** Another world, or other sizes. */
  build(scene: TargetScene | null): void {
    this.target.build(scene);
    const { scene: bodies } = this.shapes;
    this.target.drawn = !bodies;
    // Only the snap-fits have a plug, and hooks.
    for (const one of document.querySelectorAll<HTMLElement>("[data-held]")) write(one, bodies ? "body" : "plug");
    at("hooks").hidden = bodies;
    this.scene = scene;
    this.stage.centre = null;
    this.frameAll();
  }

  show(sample: Sample): void {
    this.target.show(sample);
  }

  draw(now: number): void {
    this.stage.draw(now);
  }

  forget(): void {
    this.target.forget();
    at("target").classList.add("dead");
  }

  live(): void {
    at("target").classList.remove("dead");
  }

  /** What is drawn now, for tests. */
  get shown(): { place: Vector; bent: number[] } {
    return { place: this.target.place, bent: [...this.target.bent] };
  }

  private frameAll(): void {
    if (this.scene) this.frame(this.scene);
    else if (this.shapes.scene) this.frameShapes();
  }

  /** The whole of socket and plug in view, the plug as far out as it begins. */
  private frame({ root, floor, outline }: TargetScene): void {
    const from = (Math.min(root, floor) - 2.5e-3) * UNIT;
    const to = (outline.at(-1)![0] + BEGIN) * UNIT;
    this.look([(from + to) / 2, -14, -22], 0.58 * (to - from)); // the nearer end looks larger
  }

  /** The whole of a scene in view. */
  private frameShapes(): void {
    const { centre, radius } = this.shapes.extent;
    this.look(centre.map((one) => one * UNIT) as Home["centre"], 1.25 * radius * UNIT);
  }

  /** What reaches so far to both sides of `centre` in view: between the buttons and the numbers, at any size of the page. */
  private look(centre: Home["centre"], reach: number): void {
    const free = at("target-free");
    const [width, height] = [Math.max(60, free.clientWidth) / 2, Math.max(60, free.clientHeight) / 2];
    this.stage.centre = { x: free.offsetLeft + free.clientWidth / 2, y: free.offsetTop + free.clientHeight / 2 };
    const turned = this.orbit.distance / this.home.distance;
    this.home.centre = centre;
    // Seen from the side it is flat; the body that is held moves sideways, as a drawer does.
    this.home.distance = Math.max(this.stage.fit(reach, width), this.stage.fit(0.56 * reach, height));
    const home = JSON.stringify(this.home);
    if (home === this.framed) return; // a slider that moves nothing leaves the view as it was turned
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
    const pixels = (this.stage.scale(this.orbit.distance) * UNIT) / 1000;
    const millimetres = [1, 2, 5, 10].find((mm) => mm * pixels > 35) ?? 20;
    const box = at("target-scale");
    box.querySelector<HTMLElement>("span")!.style.width = `${millimetres * pixels}px`;
    write(box.querySelector("b")!, `${millimetres} mm`);
  }
}
