// Drawing of a stylus or fingertip over a dome, as with the Omni.

import { Vector3 } from "three";
import { norm, type Sample, type Vector } from "../sample";
import type { Session, DomeScene } from "../session";
import type { ForceMap, HandGoal, Mesh } from "../wire";
import { Arrow } from "./arrow";
import { Body } from "./body";
import { intersectSphere } from "./drag";
import { ForceDome } from "./force_dome";
import { HandGoalMarker } from "./hand_goal_marker";
import type { Stage } from "./stage";
import { Stylus } from "./stylus";
import type { DeviceDrawing } from "./device_drawing";

const MM_PER_M = 1000;
const MIN_LIFT_MM = -6; // hand goal below contact
const MAX_LIFT_MM = 24;
const INITIAL_LIFT_MM = -2; // slightly pressed against the dome
const OPACITY_BEHIND_DOME = 0.35; // of the stylus
const MAX_ARROW_MM = 72; // at the force limit

export class DomeDrawing implements DeviceDrawing {
  readonly hint: string;
  readonly keys: readonly (readonly [string, string])[];
  readonly dome: ForceDome;
  private readonly body: Body;
  private readonly stylus: Stylus;
  private readonly goalMarker: HandGoalMarker;
  private readonly commanded: Arrow;
  private readonly delivered: Arrow;
  private readonly contact: number;
  private readonly workspace: number;
  private readonly arrowScale: number;
  private readonly limits: number[];
  private goalDirection = new Vector3(0, 0, 1);
  private lift = INITIAL_LIFT_MM;
  private grabOffset = { x: 0, y: 0 };
  private drawn = new Float32Array(20);

  constructor(
    private readonly stage: Stage,
    tool: DomeScene,
    limits: Session["limits"],
  ) {
    const touch = (): void => stage.touch();
    const held = tool.magnet.worn ? "fingertip" : "stylus";
    this.hint = `drag the ${held}`;
    this.keys = [
      ["← → ↑ ↓", `move the ${held} along the dome by 1° (with Shift: 5°)`],
      ["+ −", `lift or press the ${held}; or the wheel during a drag`],
    ];
    this.contact = tool.contact_distance * MM_PER_M;
    this.workspace = tool.workspace;
    this.arrowScale = MAX_ARROW_MM / limits.force;
    this.limits = limits.current;
    this.dome = new ForceDome(tool.dome_radius * MM_PER_M, touch);
    this.body = new Body(tool, touch);
    this.stylus = new Stylus(tool, touch);
    this.goalMarker = new HandGoalMarker(touch);
    this.commanded = new Arrow(false, "--commanded", 0.35, 7, touch);
    this.delivered = new Arrow(true, "--delivered", 0, 6, touch);
    stage.scene.add(
      this.body.group,
      this.stylus.group,
      this.dome.mesh,
      this.goalMarker.group,
      this.delivered.mesh,
      this.commanded.mesh,
    );
    stage.setMoving([this.stylus.group, this.goalMarker.group, this.delivered.mesh, this.commanded.mesh], { radius: tool.dome_radius * MM_PER_M, opacity: OPACITY_BEHIND_DOME });
  }

  get arrowVisible(): boolean {
    return this.delivered.visible || this.commanded.visible;
  }

  /** [N]; 0 if the map is blank */
  get range(): number {
    return this.dome.blank ? 0 : this.dome.range;
  }

  forceAt(direction: readonly number[]): { force: number; saturated: boolean } {
    return this.dome.at(direction);
  }

  live(): void {
    this.dome.live(true);
  }

  show(sample: Sample): boolean {
    const p = sample.vector("p");
    const goal = sample.vector("hand_goal");
    const commanded = sample.vector("wrench_commanded");
    const delivered = sample.vector("wrench_actual");
    const currents = sample.list("current_measured");
    const now = [...p.map((x) => x * 20000), ...goal.map((x) => x * 20000), ...commanded.map((x) => x * 250)];
    now.push(...delivered.map((x) => x * 250), ...Array.from(currents.subarray(0, 3), (x) => x * 5));
    // Ignore sensor noise: redraw for changes above 0.05 mm, 4 mN or 0.2 A.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.stylus.move(p, sample.quaternion("q"));
    this.goalMarker.move(goal, p);
    const from = new Vector3(p[0] * MM_PER_M, p[1] * MM_PER_M, p[2] * MM_PER_M);
    this.aim(this.delivered, from, delivered);
    this.aim(this.commanded, from, commanded);
    if (this.body.glow(currents, this.limits)) this.stage.touchSlowly();
    if (!this.grasped && Number.isFinite(goal[0])) this.follow(goal);
    this.stage.touchMoving();
    return true;
  }

  /** whether this page sets the hand goal; otherwise it follows the servo's */
  grasped = false;

  forget(): void {
    this.drawn.fill(NaN);
    this.goalMarker.group.visible = false;
    this.delivered.hide();
    this.commanded.hide();
    this.body.glow([], this.limits);
    this.dome.live(false);
    this.grasped = false;
  }

  shape({ directions, triangles }: Mesh): void {
    this.dome.shape(directions, triangles);
  }

  paint({ force, saturated }: ForceMap): void {
    this.dome.paint(force, saturated);
    this.dome.live(true);
  }

  near(x: number, y: number, reach: number): boolean {
    if (!this.stylus.group.visible) return false;
    const [tip, end] = this.stylus.ends().map((point) => this.stage.project(point)) as [
      { x: number; y: number },
      { x: number; y: number },
    ];
    const dx = end.x - tip.x;
    const dy = end.y - tip.y;
    const s = Math.min(1, Math.max(0, ((x - tip.x) * dx + (y - tip.y) * dy) / (dx * dx + dy * dy || 1)));
    return Math.hypot(x - tip.x - s * dx, y - tip.y - s * dy) < reach;
  }

  grab(x: number, y: number): HandGoal {
    this.grasped = true;
    // Keep the offset on the screen between pointer and hand goal, so that the stylus does not jump when grabbed.
    const at = this.stage.project(this.goalDirection.clone().multiplyScalar(this.contact + this.lift));
    this.grabOffset = { x: at.x - x, y: at.y - y };
    return this.currentHandGoal();
  }

  drag(x: number, y: number): HandGoal {
    this.grasped = true;
    this.aimAt(intersectSphere(this.stage.ray(x + this.grabOffset.x, y + this.grabOffset.y), this.contact + this.lift));
    return this.currentHandGoal();
  }

  press(millimetres: number): HandGoal {
    this.grasped = true;
    this.lift = Math.min(MAX_LIFT_MM, Math.max(MIN_LIFT_MM, this.lift + millimetres));
    return this.currentHandGoal();
  }

  nudge(right: number, up: number): HandGoal {
    this.grasped = true;
    const radians = Math.PI / 180;
    const axisRight = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    const axisUp = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 1);
    const step = axisRight.multiplyScalar(right * radians).addScaledVector(axisUp, up * radians);
    step.addScaledVector(this.goalDirection, -step.dot(this.goalDirection));
    const angle = Math.hypot(right, up) * radians;
    if (step.lengthSq() < 1e-12) return this.currentHandGoal();
    this.aimAt(this.goalDirection.clone().multiplyScalar(Math.cos(angle)).addScaledVector(step.normalize(), Math.sin(angle)));
    return this.currentHandGoal();
  }

  anchor(): { x: number; y: number } {
    const [, end] = this.stylus.ends();
    return this.stage.project(end);
  }

  /** Tip, magnet and far end on the page [px]. */
  places(): { x: number; y: number }[] {
    const box = this.stage.canvas.getBoundingClientRect();
    const [tip, end] = this.stylus.ends();
    return [tip, this.stylus.group.position, end].map((point) => {
      const { x, y } = this.stage.project(point);
      return { x: x + box.left, y: y + box.top };
    });
  }

  /** Set the direction of the hand goal, limited to the workspace. */
  private aimAt(direction: Vector3): void {
    const u = direction.clone().normalize();
    const tilt = Math.acos(Math.min(1, Math.max(-1, u.z)));
    if (tilt > this.workspace) {
      const flat = Math.hypot(u.x, u.y) || 1;
      const s = Math.sin(this.workspace);
      u.set((u.x / flat) * s, (u.y / flat) * s, Math.cos(this.workspace));
    }
    this.goalDirection.copy(u);
  }

  private follow(goal: Vector): void {
    this.goalDirection.set(...goal).normalize();
    const lift = norm(goal) * MM_PER_M - this.contact;
    this.lift = Math.min(MAX_LIFT_MM, Math.max(MIN_LIFT_MM, lift));
  }

  private currentHandGoal(): HandGoal {
    const p = this.goalDirection.clone().multiplyScalar((this.contact + this.lift) / MM_PER_M);
    return { p: [p.x, p.y, p.z] };
  }

  private aim(arrow: Arrow, from: Vector3, force: Vector): void {
    if (!Number.isFinite(force[0])) return arrow.hide();
    arrow.point(from, new Vector3(...force).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}
