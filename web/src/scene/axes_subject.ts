// Any device: the stator's axes, its coils where the server knows them, a marker where the mover is, the way that it
// came, and the force on it.

import { BufferGeometry, Group, Line, LineBasicMaterial, MeshPhongMaterial, type Object3D, Vector3 } from "three";
import type { Sample, Vector } from "../sample";
import type { Scene, Session } from "../session";
import { css, onThemeChange } from "../theme";
import { Arrow } from "./arrow";
import { intersectPlane } from "./drag";
import { Goal } from "./goal";
import { Marker, type Mover } from "./mover_drawing";
import { chips, partsOf, placePart } from "./parts";
import type { Stage } from "./stage";
import type { Subject, Wish } from "./subject";

const MM = 1000;
const AXIS = 60; // mm
const LONGEST = 72; // mm of arrow at the greatest force
const STEP = 1e-3; // m per step of a key

export class AxesSubject implements Subject {
  readonly hint: string = "drag the marker";
  readonly keys: readonly (readonly [string, string])[] = [
    ["← → ↑ ↓", "move the marker by 1 mm as seen here (with Shift: 5 mm)"],
    ["+ −", "move it along z; or the wheel during a drag"],
  ];
  readonly range: number = NaN;
  grasped = false;
  private readonly group = new Group();
  protected readonly mover: Mover;
  private readonly goal: Goal;
  private readonly asked: Arrow;
  private readonly given: Arrow;
  private readonly arrowScale: number;
  protected readonly wish: Vector3; // m
  protected slip = { x: 0, y: 0 };
  private readonly at = new Vector3(NaN, NaN, NaN); // mm: where the mover is
  private readonly drawn = new Float32Array(16).fill(NaN);

  constructor(
    protected readonly stage: Stage,
    scene: Scene,
    limits: Session["limits"],
    mover?: Mover,
    /** instead of copper coils */
    coils?: Object3D,
  ) {
    const touch = (): void => stage.touch();
    this.wish = new Vector3(...(scene.rest ?? [0, 0, 0]));
    this.arrowScale = LONGEST / limits.force;
    this.goal = new Goal(touch);
    this.asked = new Arrow(false, "--asked", 0.35, 7, touch);
    this.given = new Arrow(true, "--given", 0, 6, touch);
    this.mover = mover ?? new Marker(touch);
    const axes = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)].map((along) => {
      const ends = new BufferGeometry().setFromPoints([along.clone().multiplyScalar(-AXIS), along.clone().multiplyScalar(AXIS)]);
      return new Line(ends, new LineBasicMaterial());
    });
    const edge = new LineBasicMaterial({ transparent: true, opacity: 0.55 });
    const edges = (scene.edges ?? []).map((points) => {
      const corners = points.map((point) => new Vector3(...point).multiplyScalar(MM));
      return new Line(new BufferGeometry().setFromPoints(corners), edge);
    });
    const copper = new MeshPhongMaterial({ color: "#a8623a", specular: "#442", shininess: 30 });
    this.group.add(...axes, ...edges, ...(coils ? [coils] : partsOf(scene, "coil").map((coil) => placePart(coil, copper))), chips(scene));
    stage.canvas.ariaLabel =
      "Axes, and a marker for the mover. Arrow keys move it as seen here, plus and minus along z, question mark lists all keys.";
    stage.scene.add(this.group, this.mover.group, this.goal.group, this.given.mesh, this.asked.mesh);
    const dress = (): void => {
      edge.color.set(css("--text"));
      axes.forEach((axis, i) => axis.material.color.set(css(`--s${"xyz"[i]!}`)));
      touch();
    };
    onThemeChange(dress);
    dress();
  }

  get arrowVisible(): boolean {
    return this.given.visible || this.asked.visible;
  }

  show(sample: Sample): boolean {
    const p = sample.vector("p");
    const target = sample.vector("hand_goal");
    const asked = sample.vector("wrench_commanded");
    const given = sample.vector("wrench_actual");
    const q = sample.quaternion("q");
    const now = [...[...p, ...target].map((x) => x * 20000), ...[...asked, ...given].map((x) => x * 250), ...q.map((x) => x * 500)];
    // Noise of the sensors is no reason to draw: 0.05 mm, 4 mN and 0.2° are.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.at.set(...p).multiplyScalar(MM);
    this.mover.move(p, q);
    this.goal.move(target, p, true);
    this.aim(this.given, this.at, given);
    this.aim(this.asked, this.at, asked);
    if (!this.grasped && Number.isFinite(target[0])) this.wish.set(...target);
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.drawn.fill(NaN);
    this.at.setScalar(NaN);
    this.mover.forget();
    this.goal.group.visible = false;
    this.given.hide();
    this.asked.hide();
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
    const [left, middle] = this.sides().map((point) => this.stage.project(point)) as [Spot, Spot];
    // Also on a large mover: anywhere on its picture.
    const wide = Math.hypot(middle.x - left.x, middle.y - left.y);
    return Math.hypot(x - middle.x, y - middle.y) < Math.max(reach, wide);
  }

  grab(x: number, y: number): Wish {
    this.grasped = true;
    const at = this.stage.project(this.wish.clone().multiplyScalar(MM));
    this.slip = { x: at.x - x, y: at.y - y };
    return this.currentWish();
  }

  /** In the plane through the marker that faces the camera. */
  drag(x: number, y: number): Wish {
    this.grasped = true;
    const ray = this.stage.ray(x + this.slip.x, y + this.slip.y);
    const facing = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 2);
    this.wish.copy(intersectPlane(ray, this.wish.clone().multiplyScalar(MM), facing)).divideScalar(MM);
    return this.currentWish();
  }

  press(notches: number): Wish {
    this.grasped = true;
    this.wish.z += notches * STEP;
    return this.currentWish();
  }

  nudge(right: number, up: number): Wish {
    this.grasped = true;
    const { matrixWorld } = this.stage.camera;
    this.wish.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 0), right * STEP);
    this.wish.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 1), up * STEP);
    return this.currentWish();
  }

  anchor(): Spot {
    return this.stage.project(this.at);
  }

  picture(): { coils: number; mover: number[] } {
    let coils = 0;
    this.group.traverseVisible(({ name }) => (coils += name === "coil" ? 1 : 0));
    return { coils, mover: this.mover.place.divideScalar(MM).toArray() };
  }

  /** The mover's left side, middle and right side on the page [px]. */
  places(): Spot[] {
    const box = this.stage.canvas.getBoundingClientRect();
    return this.sides().map((point) => {
      const { x, y } = this.stage.project(point);
      return { x: x + box.left, y: y + box.top };
    });
  }

  /** The mover's left side, middle and right side as seen here [mm]. */
  private sides(): Vector3[] {
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).multiplyScalar(this.mover.radius);
    return [-1, 0, 1].map((side) => this.at.clone().addScaledVector(right, side));
  }

  protected currentWish(): Wish {
    const { x, y, z } = this.wish;
    return { p: [x, y, z] };
  }

  private aim(arrow: Arrow, from: Vector3, force: Vector): void {
    if (!Number.isFinite(force[0] + from.x)) return arrow.hide();
    arrow.point(from, new Vector3(...force).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}

interface Spot {
  x: number;
  y: number;
}
