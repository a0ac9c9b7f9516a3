// Mouse, pen and touch on the 3D view: on the tool they drag it, beside it they rotate and zoom the view. A screen
// position becomes a position in space by intersecting the camera ray with the surface along which the tool is dragged.

import type { Vector3 } from "three";
import type { Orbit } from "./orbit";
import type { Ray } from "./stage";
import type { DeviceDrawing } from "./device_drawing";
import type { HandGoal } from "../wire";

const MOUSE_GRAB_RADIUS_PX = 24;
const TOUCH_GRAB_RADIUS_PX = 44;
const WHEEL_STEP_MM = 1;
const MIN_RAW_INTERVAL_MS = 4; // between raw pointer updates that are sent

/** Intersect a ray with a sphere about the origin; if it misses, return the ray's point closest to the sphere. */
export function intersectSphere({ from, along }: Ray, radius: number): Vector3 {
  const b = from.dot(along);
  const inside = b * b - from.lengthSq() + radius * radius;
  return from.clone().addScaledVector(along, inside > 0 ? -b - Math.sqrt(inside) : -b);
}

/** Intersect a ray with the horizontal plane at `height`; null if there is no intersection in front of the camera. */
export function intersectLevelPlane({ from, along }: Ray, height: number): Vector3 | null {
  const far = (height - from.z) / along.z;
  return Number.isFinite(far) && far > 0 ? from.clone().addScaledVector(along, far) : null;
}

/** Intersect a ray with the plane through `point` with the normal `normal`. */
export function intersectPlane({ from, along }: Ray, point: Vector3, normal: Vector3): Vector3 {
  return from.clone().addScaledVector(along, point.clone().sub(from).dot(normal) / along.dot(normal));
}

export interface OnHandGoal {
  /** new hand goal at time `stamp` [ms]; `held` is false when the tool is released */
  (handGoal: HandGoal, stamp: number, held: boolean): void;
}

export class Drag {
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private holding: number | null = null;
  private handGoal: HandGoal | null = null;
  private sentAt = 0; // time stamp of the last update that was sent
  private box = new DOMRect();
  enabled = true;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly drawing: DeviceDrawing,
    private readonly orbit: Orbit,
    private readonly onHandGoal: OnHandGoal,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    // Raw updates, where the browser supports them, arrive immediately instead of once per frame.
    canvas.addEventListener("pointerrawupdate", (event) => this.onRawMove(event as PointerEvent));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event));
    canvas.addEventListener("lostpointercapture", (event) => this.up(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  get held(): boolean {
    return this.holding !== null;
  }

  release(stamp: number): void {
    if (this.holding === null) return;
    this.holding = null;
    this.canvas.classList.remove("holding");
    if (this.handGoal) this.onHandGoal(this.handGoal, stamp, false);
  }

  /** End the drag without sending a rest pose. */
  abandon(): void {
    this.holding = null;
    this.canvas.classList.remove("holding");
  }

  private at(event: MouseEvent): { x: number; y: number } {
    // Measure only at the start of a drag, because every measurement may force a layout.
    if (!this.pointers.size) this.box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - this.box.left, y: event.clientY - this.box.top };
  }

  private onRawMove(event: PointerEvent): void {
    if (this.holding === event.pointerId && event.timeStamp - this.sentAt >= MIN_RAW_INTERVAL_MS) this.follow(event);
  }

  /** Set the hand goal from the pointer's position. */
  private follow(event: PointerEvent): void {
    const { x, y } = this.at(event);
    this.sentAt = event.timeStamp;
    this.handGoal = this.drawing.drag(x, y);
    this.onHandGoal(this.handGoal, event.timeStamp, true);
  }

  private down(event: PointerEvent): void {
    if (event.pointerType === "mouse" && event.button > 1) return;
    this.canvas.focus({ preventScroll: true });
    const { x, y } = this.at(event);
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x, y });
    const reach = event.pointerType === "mouse" ? MOUSE_GRAB_RADIUS_PX : TOUCH_GRAB_RADIUS_PX;
    if (this.enabled && this.holding === null && event.button === 0 && this.drawing.near(x, y, reach)) {
      this.holding = event.pointerId;
      this.canvas.classList.add("holding");
      this.handGoal = this.drawing.grab(x, y);
      this.onHandGoal(this.handGoal, event.timeStamp, true);
    }
    event.preventDefault();
  }

  private move(event: PointerEvent): void {
    const { x, y } = this.at(event);
    const before = this.pointers.get(event.pointerId);
    if (this.holding === event.pointerId) {
      if (event.timeStamp > this.sentAt) this.follow(event);
    } else if (before && this.pointers.size - (this.holding === null ? 0 : 1) === 2) {
      this.pinch(event.pointerId, before, { x, y });
    } else if (before) {
      this.orbit.turn((before.x - x) * 0.4, (y - before.y) * 0.4);
    } else {
      this.canvas.classList.toggle("near", this.enabled && this.drawing.near(x, y, MOUSE_GRAB_RADIUS_PX));
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
    if (this.holding === event.pointerId) this.release(event.timeStamp);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const { x, y } = this.at(event);
    if (this.enabled && (this.held || this.drawing.near(x, y, MOUSE_GRAB_RADIUS_PX))) {
      this.handGoal = this.drawing.press(-Math.sign(event.deltaY) * WHEEL_STEP_MM);
      this.onHandGoal(this.handGoal, event.timeStamp, this.held);
    } else {
      this.orbit.zoom(Math.exp(event.deltaY * 0.001));
    }
  }
}
