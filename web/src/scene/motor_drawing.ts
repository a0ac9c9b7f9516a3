// Drawing of a spherical motor. Dragging tilts the handle; wheel and keys spin it about its axis.

import { Vector3 } from "three";
import type { Sample, Vector } from "../sample";
import type { MotorScene, Session } from "../session";
import type { HandGoal } from "../wire";
import { Arrow } from "./arrow";
import { intersectSphere } from "./drag";
import { HandGoalMarker } from "./hand_goal_marker";
import { Rotor } from "./rotor";
import type { Stage } from "./stage";
import type { DeviceDrawing } from "./device_drawing";
import { angles, axis, quaternionOf, type Quaternion } from "./rotor_angles";

const MM_PER_M = 1000;
const MAX_ARROW_MM = 200; // at the torque limit
const WHEEL_STEP_DEG = 2; // of spin
const RAD_PER_DEG = Math.PI / 180;

export class MotorDrawing implements DeviceDrawing {
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
  private readonly goalMarker: HandGoalMarker;
  private readonly commanded: Arrow;
  private readonly delivered: Arrow;
  private readonly handle: number;
  private readonly arrowScale: number;
  private goalAngles: Vector = [0, 0, 0];
  private grabOffset = { x: 0, y: 0 };
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
    this.arrowScale = MAX_ARROW_MM / limits.torque;
    this.rotor = new Rotor(mover, this.range, touch);
    this.goalMarker = new HandGoalMarker(touch);
    stage.canvas.ariaLabel =
      "Motor with a handle. Arrow keys tilt it, Q and E spin it, R and T choose how it moves the object, holding C releases the clutch, question mark lists all keys.";
    this.commanded = new Arrow(false, "--commanded", 0.35, 7, touch);
    this.delivered = new Arrow(true, "--delivered", 0, 6, touch);
    stage.scene.add(this.rotor.stator, this.rotor.group, this.goalMarker.group, this.delivered.mesh, this.commanded.mesh);
  }

  get arrowVisible(): boolean {
    return this.delivered.visible || this.commanded.visible;
  }

  show(sample: Sample): boolean {
    const q = sample.quaternion("q");
    const goal = sample.quaternion("hand_goal_q");
    const commanded = sample.vector("wrench_commanded", 3);
    const delivered = sample.vector("wrench_actual", 3);
    const currents = sample.list("current_measured");
    const now = [...q, ...goal].map((x) => x * 4000);
    now.push(...[...commanded, ...delivered].map((x) => x * 200), ...Array.from(currents, (x) => x * 100));
    // Ignore sensor noise: redraw for changes above 0.03°, 5 mN·m or 10 mA.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.rotor.turn(q);
    const at = (turn: Quaternion): Vector => axis(turn).map((x) => x * this.handle) as Vector;
    this.goalMarker.move(at(goal), at(q));
    this.aim(this.delivered, delivered);
    this.aim(this.commanded, commanded);
    this.rotor.glow(currents);
    if (!this.grasped && Number.isFinite(goal[0])) this.goalAngles = angles(goal);
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.drawn.fill(NaN);
    this.goalMarker.group.visible = false;
    this.delivered.hide();
    this.commanded.hide();
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
    const [foot, end] = this.rotor.ends().map((point) => this.stage.project(point)) as [ScreenPoint, ScreenPoint];
    const dx = end.x - foot.x;
    const dy = end.y - foot.y;
    const s = Math.min(1, Math.max(0, ((x - foot.x) * dx + (y - foot.y) * dy) / (dx * dx + dy * dy || 1)));
    return Math.hypot(x - foot.x - s * dx, y - foot.y - s * dy) < reach;
  }

  grab(x: number, y: number): HandGoal {
    this.grasped = true;
    // Keep the offset on the screen between pointer and ball, so that the handle does not jump when grabbed.
    const at = this.stage.project(this.along().multiplyScalar(this.handle * MM_PER_M));
    this.grabOffset = { x: at.x - x, y: at.y - y };
    return this.currentHandGoal();
  }

  drag(x: number, y: number): HandGoal {
    this.grasped = true;
    this.aimAt(intersectSphere(this.stage.ray(x + this.grabOffset.x, y + this.grabOffset.y), this.handle * MM_PER_M));
    return this.currentHandGoal();
  }

  press(notches: number): HandGoal {
    return this.spin(notches * WHEEL_STEP_DEG);
  }

  /** Spin the handle about its axis [deg]. */
  spin(degrees: number): HandGoal {
    this.grasped = true;
    this.goalAngles[2] += degrees * RAD_PER_DEG;
    return this.currentHandGoal();
  }

  nudge(right: number, up: number): HandGoal {
    this.grasped = true;
    const u = this.along();
    const step = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).multiplyScalar(right * RAD_PER_DEG);
    step.addScaledVector(new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 1), up * RAD_PER_DEG);
    step.addScaledVector(u, -step.dot(u));
    if (step.lengthSq() < 1e-12) return this.currentHandGoal();
    const angle = Math.hypot(right, up) * RAD_PER_DEG;
    this.aimAt(u.multiplyScalar(Math.cos(angle)).addScaledVector(step.normalize(), Math.sin(angle)));
    return this.currentHandGoal();
  }

  anchor(): ScreenPoint {
    return this.stage.project(this.rotor.ends()[1]);
  }

  /** Base, middle and end of the handle on the page [px]. */
  places(): ScreenPoint[] {
    const box = this.stage.canvas.getBoundingClientRect();
    const [foot, end] = this.rotor.ends();
    return [foot, foot.clone().lerp(end, 0.5), end].map((point) => {
      const { x, y } = this.stage.project(point);
      return { x: x + box.left, y: y + box.top };
    });
  }

  private along(): Vector3 {
    return new Vector3(...axis(quaternionOf(this.goalAngles)));
  }

  /** Set the hand goal's direction of the handle to `direction`, limited to the workspace; keep the spin. */
  private aimAt(direction: Vector3): void {
    const u = direction.clone().normalize();
    const flat = Math.hypot(u.x, u.y);
    const { workspace } = this.mover;
    if (Math.atan2(flat, u.z) > workspace) {
      const s = Math.sin(workspace) / (flat || 1);
      u.set(u.x * s, u.y * s, Math.cos(workspace));
    }
    this.goalAngles = [Math.atan2(-u.y, u.z), Math.asin(Math.min(1, Math.max(-1, u.x))), this.goalAngles[2]];
  }

  private currentHandGoal(): HandGoal {
    return { p: [0, 0, 0], q: quaternionOf(this.goalAngles) };
  }

  private aim(arrow: Arrow, torque: Vector): void {
    if (!Number.isFinite(torque[0])) return arrow.hide();
    arrow.point(new Vector3(), new Vector3(...torque).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}

interface ScreenPoint {
  x: number;
  y: number;
}
