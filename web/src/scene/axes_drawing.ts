// Drawing of any device without a scene of its own: axes of the stator frame, coils if known, a marker for the mover with
// its trail, and the force on it.

import { BufferGeometry, Group, Line, LineBasicMaterial, MeshPhongMaterial, type Object3D, Vector3 } from "three";
import type { Sample, Vector } from "../sample";
import type { Scene, Session } from "../session";
import { css, onThemeChange } from "../theme";
import type { HandGoal } from "../wire";
import { Arrow } from "./arrow";
import { intersectPlane } from "./drag";
import { HandGoalMarker } from "./hand_goal_marker";
import { Marker, type Mover } from "./mover_drawing";
import { fieldSensors, partsOf, placePart } from "./parts";
import type { Stage } from "./stage";
import type { DeviceDrawing } from "./device_drawing";

const MM_PER_M = 1000;
const AXIS_LENGTH_MM = 60; // of a half axis
const MAX_ARROW_MM = 72; // at the force limit
const KEY_STEP_M = 1e-3;

export class AxesDrawing implements DeviceDrawing {
  readonly hint: string = "drag the marker";
  readonly keys: readonly (readonly [string, string])[] = [
    ["← → ↑ ↓", "move the marker by 1 mm as seen here (with Shift: 5 mm)"],
    ["+ −", "move it along z; or the wheel during a drag"],
  ];
  readonly range: number = NaN;
  grasped = false;
  private readonly group = new Group();
  protected readonly mover: Mover;
  private readonly goalMarker: HandGoalMarker;
  private readonly commanded: Arrow;
  private readonly delivered: Arrow;
  private readonly arrowScale: number;
  protected readonly handGoal: Vector3; // [m]
  protected grabOffset = { x: 0, y: 0 };
  private readonly at = new Vector3(NaN, NaN, NaN); // position of the mover [mm]
  private readonly drawn = new Float32Array(16).fill(NaN);

  constructor(
    protected readonly stage: Stage,
    scene: Scene,
    limits: Session["limits"],
    mover?: Mover,
    /** drawing of the coils; default: copper coils */
    coils?: Object3D,
  ) {
    const touch = (): void => stage.touch();
    this.handGoal = new Vector3(...(scene.rest ?? [0, 0, 0]));
    this.arrowScale = MAX_ARROW_MM / limits.force;
    this.goalMarker = new HandGoalMarker(touch);
    this.commanded = new Arrow(false, "--commanded", 0.35, 7, touch);
    this.delivered = new Arrow(true, "--delivered", 0, 6, touch);
    this.mover = mover ?? new Marker(touch);
    const axes = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)].map((along) => {
      const ends = new BufferGeometry().setFromPoints([along.clone().multiplyScalar(-AXIS_LENGTH_MM), along.clone().multiplyScalar(AXIS_LENGTH_MM)]);
      return new Line(ends, new LineBasicMaterial());
    });
    const edge = new LineBasicMaterial({ transparent: true, opacity: 0.55 });
    const edges = (scene.edges ?? []).map((points) => {
      const corners = points.map((point) => new Vector3(...point).multiplyScalar(MM_PER_M));
      return new Line(new BufferGeometry().setFromPoints(corners), edge);
    });
    const copper = new MeshPhongMaterial({ color: "#a8623a", specular: "#442", shininess: 30 });
    this.group.add(...axes, ...edges, ...(coils ? [coils] : partsOf(scene, "coil").map((coil) => placePart(coil, copper))), fieldSensors(scene));
    stage.canvas.ariaLabel =
      "Axes, and a marker for the mover. Arrow keys move it as seen here, plus and minus along z, question mark lists all keys.";
    stage.scene.add(this.group, this.mover.group, this.goalMarker.group, this.delivered.mesh, this.commanded.mesh);
    const applyTheme = (): void => {
      edge.color.set(css("--text"));
      axes.forEach((axis, i) => axis.material.color.set(css(`--s${"xyz"[i]!}`)));
      touch();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  get arrowVisible(): boolean {
    return this.delivered.visible || this.commanded.visible;
  }

  show(sample: Sample): boolean {
    const p = sample.vector("p");
    const goal = sample.vector("hand_goal");
    const commanded = sample.vector("wrench_commanded");
    const delivered = sample.vector("wrench_actual");
    const q = sample.quaternion("q");
    const now = [...[...p, ...goal].map((x) => x * 20000), ...[...commanded, ...delivered].map((x) => x * 250), ...q.map((x) => x * 500)];
    // Ignore sensor noise: redraw for changes above 0.05 mm, 4 mN or 0.2°.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    this.at.set(...p).multiplyScalar(MM_PER_M);
    this.mover.move(p, q);
    this.goalMarker.move(goal, p, true);
    this.aim(this.delivered, this.at, delivered);
    this.aim(this.commanded, this.at, commanded);
    if (!this.grasped && Number.isFinite(goal[0])) this.handGoal.set(...goal);
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.drawn.fill(NaN);
    this.at.setScalar(NaN);
    this.mover.forget();
    this.goalMarker.group.visible = false;
    this.delivered.hide();
    this.commanded.hide();
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
    const [left, middle] = this.sides().map((point) => this.stage.project(point)) as [ScreenPoint, ScreenPoint];
    // A large mover can be grabbed anywhere on its drawing.
    const wide = Math.hypot(middle.x - left.x, middle.y - left.y);
    return Math.hypot(x - middle.x, y - middle.y) < Math.max(reach, wide);
  }

  grab(x: number, y: number): HandGoal {
    this.grasped = true;
    const at = this.stage.project(this.handGoal.clone().multiplyScalar(MM_PER_M));
    this.grabOffset = { x: at.x - x, y: at.y - y };
    return this.currentHandGoal();
  }

  /** Drag in the plane through the marker that faces the camera. */
  drag(x: number, y: number): HandGoal {
    this.grasped = true;
    const ray = this.stage.ray(x + this.grabOffset.x, y + this.grabOffset.y);
    const facing = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 2);
    this.handGoal.copy(intersectPlane(ray, this.handGoal.clone().multiplyScalar(MM_PER_M), facing)).divideScalar(MM_PER_M);
    return this.currentHandGoal();
  }

  press(notches: number): HandGoal {
    this.grasped = true;
    this.handGoal.z += notches * KEY_STEP_M;
    return this.currentHandGoal();
  }

  nudge(right: number, up: number): HandGoal {
    this.grasped = true;
    const { matrixWorld } = this.stage.camera;
    this.handGoal.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 0), right * KEY_STEP_M);
    this.handGoal.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 1), up * KEY_STEP_M);
    return this.currentHandGoal();
  }

  anchor(): ScreenPoint {
    return this.stage.project(this.at);
  }

  picture(): { coils: number; mover: number[] } {
    let coils = 0;
    this.group.traverseVisible(({ name }) => (coils += name === "coil" ? 1 : 0));
    return { coils, mover: this.mover.place.divideScalar(MM_PER_M).toArray() };
  }

  /** Left side, centre and right side of the mover on the page [px]. */
  places(): ScreenPoint[] {
    const box = this.stage.canvas.getBoundingClientRect();
    return this.sides().map((point) => {
      const { x, y } = this.stage.project(point);
      return { x: x + box.left, y: y + box.top };
    });
  }

  /** Left side, centre and right side of the mover in this view [mm]. */
  private sides(): Vector3[] {
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).multiplyScalar(this.mover.radius);
    return [-1, 0, 1].map((side) => this.at.clone().addScaledVector(right, side));
  }

  protected currentHandGoal(): HandGoal {
    const { x, y, z } = this.handGoal;
    return { p: [x, y, z] };
  }

  private aim(arrow: Arrow, from: Vector3, force: Vector): void {
    if (!Number.isFinite(force[0] + from.x)) return arrow.hide();
    arrow.point(from, new Vector3(...force).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}

interface ScreenPoint {
  x: number;
  y: number;
}
