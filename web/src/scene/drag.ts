// Mouse, pen and touch on the picture: on the stylus they drag it, beside it they turn and zoom the view. A place on the
// screen becomes one in space where the ray from the camera meets the surface along which the tool is dragged.

import type { Vector3 } from "three";
import type { Orbit } from "./orbit";
import type { Ray } from "./stage";
import type { Subject, Wish } from "./subject";

const MOUSE = 24; // px around the stylus that take hold
const TOUCH = 44;
const NOTCH = 1; // mm per notch of the wheel
const OFTEN = 4; // ms between two places that are passed on at once

/** Where a ray meets a sphere about the origin; beside the sphere its nearest outline counts. */
export function intersectSphere({ from, along }: Ray, radius: number): Vector3 {
  const b = from.dot(along);
  const inside = b * b - from.lengthSq() + radius * radius;
  return from.clone().addScaledVector(along, inside > 0 ? -b - Math.sqrt(inside) : -b);
}

/** Where a ray meets the level plane at `height`; null beside the horizon, where there is no place to go to. */
export function intersectLevelPlane({ from, along }: Ray, height: number): Vector3 | null {
  const far = (height - from.z) / along.z;
  return Number.isFinite(far) && far > 0 ? from.clone().addScaledVector(along, far) : null;
}

/** Where a ray meets the plane through `point` with this normal. */
export function intersectPlane({ from, along }: Ray, point: Vector3, normal: Vector3): Vector3 {
  return from.clone().addScaledVector(along, point.clone().sub(from).dot(normal) / along.dot(normal));
}

export interface Hold {
  /** the hand moved to `wish` at `stamp` [ms]; `held` is false at the moment of letting go */
  (wish: Wish, stamp: number, held: boolean): void;
}

export class Drag {
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private holding: number | null = null;
  private wish: Wish | null = null;
  private passed = 0; // stamp of the last place that was passed on
  private box = new DOMRect();
  enabled = true;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly subject: Subject,
    private readonly orbit: Orbit,
    private readonly hold: Hold,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    // Where the browser has it: the pointer's places as they come, not kept back for the next frame.
    canvas.addEventListener("pointerrawupdate", (event) => this.onRawMove(event as PointerEvent));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event));
    canvas.addEventListener("lostpointercapture", (event) => this.up(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  get held(): boolean {
    return this.holding !== null;
  }

  letGo(stamp: number): void {
    if (this.holding === null) return;
    this.holding = null;
    this.canvas.classList.remove("holding");
    if (this.wish) this.hold(this.wish, stamp, false);
  }

  /** The hold ends, and nothing is said of where the hand rests. */
  abandon(): void {
    this.holding = null;
    this.canvas.classList.remove("holding");
  }

  private at(event: MouseEvent): { x: number; y: number } {
    // Measured when the hand comes, not at each of its places: that would have the page laid out in between.
    if (!this.pointers.size) this.box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - this.box.left, y: event.clientY - this.box.top };
  }

  private onRawMove(event: PointerEvent): void {
    if (this.holding === event.pointerId && event.timeStamp - this.passed >= OFTEN) this.follow(event);
  }

  /** The hand goes where the pointer is. */
  private follow(event: PointerEvent): void {
    const { x, y } = this.at(event);
    this.passed = event.timeStamp;
    this.wish = this.subject.drag(x, y);
    this.hold(this.wish, event.timeStamp, true);
  }

  private down(event: PointerEvent): void {
    if (event.pointerType === "mouse" && event.button > 1) return;
    this.canvas.focus({ preventScroll: true });
    const { x, y } = this.at(event);
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x, y });
    const reach = event.pointerType === "mouse" ? MOUSE : TOUCH;
    if (this.enabled && this.holding === null && event.button === 0 && this.subject.near(x, y, reach)) {
      this.holding = event.pointerId;
      this.canvas.classList.add("holding");
      this.wish = this.subject.grab(x, y);
      this.hold(this.wish, event.timeStamp, true);
    }
    event.preventDefault();
  }

  private move(event: PointerEvent): void {
    const { x, y } = this.at(event);
    const before = this.pointers.get(event.pointerId);
    if (this.holding === event.pointerId) {
      if (event.timeStamp > this.passed) this.follow(event);
    } else if (before && this.pointers.size - (this.holding === null ? 0 : 1) === 2) {
      this.pinch(event.pointerId, before, { x, y });
    } else if (before) {
      this.orbit.turn((before.x - x) * 0.4, (y - before.y) * 0.4);
    } else {
      this.canvas.classList.toggle("near", this.enabled && this.subject.near(x, y, MOUSE));
    }
    if (before) this.pointers.set(event.pointerId, { x, y });
  }

  private pinch(id: number, before: { x: number; y: number }, now: { x: number; y: number }): void {
    for (const [other, place] of this.pointers) {
      if (other === id || other === this.holding) continue;
      const spread = Math.hypot(now.x - place.x, now.y - place.y);
      const was = Math.hypot(before.x - place.x, before.y - place.y);
      if (spread > 1) this.orbit.zoom(was / spread);
      return;
    }
  }

  private up(event: PointerEvent): void {
    this.pointers.delete(event.pointerId);
    if (this.holding === event.pointerId) this.letGo(event.timeStamp);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const { x, y } = this.at(event);
    if (this.enabled && (this.held || this.subject.near(x, y, MOUSE))) {
      this.wish = this.subject.press(-Math.sign(event.deltaY) * NOTCH);
      this.hold(this.wish, event.timeStamp, this.held);
    } else {
      this.orbit.zoom(Math.exp(event.deltaY * 0.001));
    }
  }
}
