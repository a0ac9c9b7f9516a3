// A rotor with a handle: spherical motors. The handle is dragged to tilt; wheel and keys spin it about itself.

import { Vector3 } from "three";
import type { Sample, Vector } from "../sample";
import type { MotorScene, Session } from "../session";
import { Arrow } from "./arrow";
import { intersectSphere } from "./drag";
import { Goal } from "./goal";
import { Rotor } from "./rotor";
import type { Stage } from "./stage";
import type { Subject, Wish } from "./subject";
import { angles, axis, quaternionOf, type Quaternion } from "./turn";

const MM = 1000;
const LONGEST = 200; // mm of arrow at the greatest torque
const NOTCH = 2; // degrees of spin per notch of the wheel
const DEGREE = Math.PI / 180;

export class RotorSubject implements Subject {
  readonly hint = "drag the handle";
  readonly keys = [
    ["← → ↑ ↓", "tilt the handle by 1° (with Shift: 5°)"],
    ["Q, E", "spin the handle by 2° (with Shift: 10°); or the wheel during a drag"],
    ["R, T", "the handle rotates the object, or translates it"],
    ["hold C", "release the clutch, to turn the handle back and reach further"],
  ] as const;
  readonly range: number;
  grasped = false;
  private readonly rotor: Rotor;
  private readonly goal: Goal;
  private readonly asked: Arrow;
  private readonly given: Arrow;
  private readonly handle: number;
  private readonly arrowScale: number;
  private wish: Vector = [0, 0, 0];
  private slip = { x: 0, y: 0 };
  private readonly drawn: Float32Array;

  constructor(
    private readonly stage: Stage,
    private readonly mover: MotorScene,
    limits: Session["limits"],
  ) {
    const touch = (): void => stage.touch();
    this.range = Math.max(...limits.current) / 2;
    this.handle = mover.handle_length;
    this.drawn = new Float32Array(14 + limits.current.length);
    this.arrowScale = LONGEST / limits.torque;
    this.rotor = new Rotor(mover, this.range, touch);
    this.goal = new Goal(touch);
    stage.canvas.ariaLabel =
      "Motor with a handle. Arrow keys tilt it, Q and E spin it, R and T choose how it moves the object, holding C releases the clutch, question mark lists all keys.";
    this.asked = new Arrow(false, "--asked", 0.35, 7, touch);
    this.given = new Arrow(true, "--given", 0, 6, touch);
    stage.scene.add(this.rotor.stator, this.rotor.group, this.goal.group, this.given.mesh, this.asked.mesh);
  }

  get arrowVisible(): boolean {
    return this.given.visible || this.asked.visible;
  }

  show(sample: Sample): boolean {
    const q = sample.quaternion("q");
    const target = sample.quaternion("hand_goal_q");
    const asked = sample.vector("wrench_commanded", 3);
    const given = sample.vector("wrench_actual", 3);
    const currents = sample.list("current_measured");
    const now = [...q, ...target].map((x) => x * 4000);
    now.push(...[...asked, ...given].map((x) => x * 200), ...Array.from(currents, (x) => x * 100));
    // Noise of the sensors is no reason to draw: 0.03°, 5 mN·m and 10 mA are.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.rotor.turn(q);
    const at = (turn: Quaternion): Vector => axis(turn).map((x) => x * this.handle) as Vector;
    this.goal.move(at(target), at(q));
    this.aim(this.given, given);
    this.aim(this.asked, asked);
    this.rotor.glow(currents);
    if (!this.grasped && Number.isFinite(target[0])) this.wish = angles(target);
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.drawn.fill(NaN);
    this.goal.group.visible = false;
    this.given.hide();
    this.asked.hide();
    this.rotor.glow([]);
    this.grasped = false;
    this.stage.touch();
  }

  live(): void {
    this.stage.touch();
  }

  shape(): void {}

  paint(): void {}

  forceAt(): { force: number; saturated: boolean } {
    return { force: NaN, saturated: false };
  }

  near(x: number, y: number, reach: number): boolean {
    if (!this.rotor.group.visible) return false;
    const [foot, end] = this.rotor.ends().map((point) => this.stage.project(point)) as [Spot, Spot];
    const dx = end.x - foot.x;
    const dy = end.y - foot.y;
    const s = Math.min(1, Math.max(0, ((x - foot.x) * dx + (y - foot.y) * dy) / (dx * dx + dy * dy || 1)));
    return Math.hypot(x - foot.x - s * dx, y - foot.y - s * dy) < reach;
  }

  grab(x: number, y: number): Wish {
    this.grasped = true;
    // The handle is held where it was grasped: the difference to its middle stays as it was on the screen.
    const at = this.stage.project(this.along().multiplyScalar(this.handle * MM));
    this.slip = { x: at.x - x, y: at.y - y };
    return this.currentWish();
  }

  drag(x: number, y: number): Wish {
    this.grasped = true;
    this.aimAt(intersectSphere(this.stage.ray(x + this.slip.x, y + this.slip.y), this.handle * MM));
    return this.currentWish();
  }

  press(notches: number): Wish {
    return this.spin(notches * NOTCH);
  }

  /** Turn the handle about itself by degrees. */
  spin(degrees: number): Wish {
    this.grasped = true;
    this.wish[2] += degrees * DEGREE;
    return this.currentWish();
  }

  nudge(right: number, up: number): Wish {
    this.grasped = true;
    const u = this.along();
    const step = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).multiplyScalar(right * DEGREE);
    step.addScaledVector(new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 1), up * DEGREE);
    step.addScaledVector(u, -step.dot(u));
    if (step.lengthSq() < 1e-12) return this.currentWish();
    const angle = Math.hypot(right, up) * DEGREE;
    this.aimAt(u.multiplyScalar(Math.cos(angle)).addScaledVector(step.normalize(), Math.sin(angle)));
    return this.currentWish();
  }

  anchor(): Spot {
    return this.stage.project(this.rotor.ends()[1]);
  }

  /** Foot, middle and end of the handle on the page [px]. */
  places(): Spot[] {
    const box = this.stage.canvas.getBoundingClientRect();
    const [foot, end] = this.rotor.ends();
    return [foot, foot.clone().lerp(end, 0.5), end].map((point) => {
      const { x, y } = this.stage.project(point);
      return { x: x + box.left, y: y + box.top };
    });
  }

  private along(): Vector3 {
    return new Vector3(...axis(quaternionOf(this.wish)));
  }

  /** The handle along `direction`, kept inside the workspace; its spin stays. */
  private aimAt(direction: Vector3): void {
    const u = direction.clone().normalize();
    const flat = Math.hypot(u.x, u.y);
    const { workspace } = this.mover;
    if (Math.atan2(flat, u.z) > workspace) {
      const s = Math.sin(workspace) / (flat || 1);
      u.set(u.x * s, u.y * s, Math.cos(workspace));
    }
    this.wish = [Math.atan2(-u.y, u.z), Math.asin(Math.min(1, Math.max(-1, u.x))), this.wish[2]];
  }

  private currentWish(): Wish {
    return { p: [0, 0, 0], q: quaternionOf(this.wish) };
  }

  private aim(arrow: Arrow, torque: Vector): void {
    if (!Number.isFinite(torque[0])) return arrow.hide();
    arrow.point(new Vector3(), new Vector3(...torque).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}

interface Spot {
  x: number;
  y: number;
}
