// A stylus or a fingertip over a dome: the Omni and its relatives.

import { Vector3 } from "three";
import { norm, type Sample, type Vector } from "../sample";
import type { Session, DomeScene } from "../session";
import type { ForceMap, Mesh } from "../wire";
import { Arrow } from "./arrow";
import { Body } from "./body";
import { intersectSphere } from "./drag";
import { ForceDome } from "./force_dome";
import { Goal } from "./goal";
import type { Stage } from "./stage";
import { Stylus } from "./stylus";
import type { Subject, Wish } from "./subject";

const MM = 1000;
const DEEPEST = -6; // mm: how far a hand may press into the dome
const HIGHEST = 24; // mm: how far it may lift
const LEAN = -2; // mm: how it holds the stylus when it lands
const THROUGH = 0.35; // share of the stylus that is seen through the dome
const LONGEST = 72; // mm of arrow at the greatest force

export class ToolSubject implements Subject {
  readonly hint: string;
  readonly keys: readonly (readonly [string, string])[];
  readonly dome: ForceDome;
  private readonly body: Body;
  private readonly stylus: Stylus;
  private readonly goal: Goal;
  private readonly asked: Arrow;
  private readonly given: Arrow;
  private readonly contact: number;
  private readonly workspace: number;
  private readonly arrowScale: number;
  private readonly limits: number[];
  private wish = new Vector3(0, 0, 1);
  private lift = LEAN;
  private slip = { x: 0, y: 0 };
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
    this.contact = tool.contact_distance * MM;
    this.workspace = tool.workspace;
    this.arrowScale = LONGEST / limits.force;
    this.limits = limits.current;
    this.dome = new ForceDome(tool.dome_radius * MM, touch);
    this.body = new Body(tool, touch);
    this.stylus = new Stylus(tool, touch);
    this.goal = new Goal(touch);
    this.asked = new Arrow(false, "--asked", 0.35, 7, touch);
    this.given = new Arrow(true, "--given", 0, 6, touch);
    stage.scene.add(
      this.body.group,
      this.stylus.group,
      this.dome.mesh,
      this.goal.group,
      this.given.mesh,
      this.asked.mesh,
    );
    stage.moves([this.stylus.group, this.goal.group, this.given.mesh, this.asked.mesh], { radius: tool.dome_radius * MM, through: THROUGH });
  }

  get arrowVisible(): boolean {
    return this.given.visible || this.asked.visible;
  }

  /** [N]; 0 where nothing is painted */
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
    const target = sample.vector("hand_goal");
    const asked = sample.vector("wrench_commanded");
    const given = sample.vector("wrench_actual");
    const currents = sample.list("current_measured");
    const now = [...p.map((x) => x * 20000), ...target.map((x) => x * 20000), ...asked.map((x) => x * 250)];
    now.push(...given.map((x) => x * 250), ...Array.from(currents.subarray(0, 3), (x) => x * 5));
    // Noise of the sensors is no reason to draw: 0.05 mm, 4 mN and 0.2 A are.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.stylus.move(p, sample.quaternion("q"));
    this.goal.move(target, p);
    const from = new Vector3(p[0] * MM, p[1] * MM, p[2] * MM);
    this.aim(this.given, from, given);
    this.aim(this.asked, from, asked);
    if (this.body.glow(currents, this.limits)) this.stage.fade();
    if (!this.grasped && Number.isFinite(target[0])) this.follow(target);
    this.stage.touchMoving();
    return true;
  }

  /** whether this page moves the hand; otherwise its wish follows what the servo says */
  grasped = false;

  forget(): void {
    this.drawn.fill(NaN);
    this.goal.group.visible = false;
    this.given.hide();
    this.asked.hide();
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

  grab(x: number, y: number): Wish {
    this.grasped = true;
    // The pen is held where it was grasped, not where its magnet is: the difference stays as it was on the screen.
    const at = this.stage.project(this.wish.clone().multiplyScalar(this.contact + this.lift));
    this.slip = { x: at.x - x, y: at.y - y };
    return this.currentWish();
  }

  drag(x: number, y: number): Wish {
    this.grasped = true;
    this.aimAt(intersectSphere(this.stage.ray(x + this.slip.x, y + this.slip.y), this.contact + this.lift));
    return this.currentWish();
  }

  press(millimetres: number): Wish {
    this.grasped = true;
    this.lift = Math.min(HIGHEST, Math.max(DEEPEST, this.lift + millimetres));
    return this.currentWish();
  }

  nudge(right: number, up: number): Wish {
    this.grasped = true;
    const radians = Math.PI / 180;
    const axisRight = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    const axisUp = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 1);
    const step = axisRight.multiplyScalar(right * radians).addScaledVector(axisUp, up * radians);
    step.addScaledVector(this.wish, -step.dot(this.wish));
    const angle = Math.hypot(right, up) * radians;
    if (step.lengthSq() < 1e-12) return this.currentWish();
    this.aimAt(this.wish.clone().multiplyScalar(Math.cos(angle)).addScaledVector(step.normalize(), Math.sin(angle)));
    return this.currentWish();
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

  /** The present wish along `direction`, kept inside the workspace. */
  private aimAt(direction: Vector3): void {
    const u = direction.clone().normalize();
    const tilt = Math.acos(Math.min(1, Math.max(-1, u.z)));
    if (tilt > this.workspace) {
      const flat = Math.hypot(u.x, u.y) || 1;
      const s = Math.sin(this.workspace);
      u.set((u.x / flat) * s, (u.y / flat) * s, Math.cos(this.workspace));
    }
    this.wish.copy(u);
  }

  private follow(target: Vector): void {
    this.wish.set(...target).normalize();
    const lift = norm(target) * MM - this.contact;
    this.lift = Math.min(HIGHEST, Math.max(DEEPEST, lift));
  }

  private currentWish(): Wish {
    const p = this.wish.clone().multiplyScalar((this.contact + this.lift) / MM);
    return { p: [p.x, p.y, p.z] };
  }

  private aim(arrow: Arrow, from: Vector3, force: Vector): void {
    if (!Number.isFinite(force[0])) return arrow.hide();
    arrow.point(from, new Vector3(...force).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}
