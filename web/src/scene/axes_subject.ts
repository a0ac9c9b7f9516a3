// Any device: the stator's axes, its coils where the server knows them, a marker where the mover is, the way that it
// came, and the force on it.

import {
  BufferAttribute,
  BufferGeometry,
  Group,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshPhongMaterial,
  SphereGeometry,
  Vector3,
} from "three";
import type { Sample, Vector } from "../sample";
import type { Scene, Session } from "../session";
import { css, onThemeChange } from "../theme";
import { Arrow } from "./arrow";
import { Goal } from "./goal";
import { chips, partsOf, placePart } from "./parts";
import type { Stage } from "./stage";
import type { Subject, Wish } from "./subject";

const MM = 1000;
const AXIS = 60; // mm
const MARKER = 4; // mm, radius
const LONGEST = 72; // mm of arrow at the greatest force
const WAY = 240; // places of the way that the mover came
const STEP = 1e-3; // m per step of a key

export class AxesSubject implements Subject {
  readonly hint = "drag the marker";
  readonly keys = [
    ["← → ↑ ↓", "move the marker by 1 mm as seen here (with Shift: 5 mm)"],
    ["+ −", "move it along z; or the wheel during a drag"],
  ] as const;
  readonly range = NaN;
  grasped = false;
  private readonly group = new Group();
  private readonly marker = new Mesh(new SphereGeometry(MARKER, 24, 16), new MeshPhongMaterial({ shininess: 40 }));
  private readonly way: Line<BufferGeometry, LineBasicMaterial>;
  private readonly passed = new Float32Array(3 * WAY);
  private kept = 0;
  private readonly goal: Goal;
  private readonly asked: Arrow;
  private readonly given: Arrow;
  private readonly arrowScale: number;
  private readonly wish: Vector3; // m
  private slip = { x: 0, y: 0 };
  private readonly drawn = new Float32Array(12).fill(NaN);

  constructor(
    private readonly stage: Stage,
    scene: Scene,
    limits: Session["limits"],
  ) {
    const touch = (): void => stage.touch();
    this.wish = new Vector3(...(scene.rest ?? [0, 0, 0]));
    this.arrowScale = LONGEST / limits.force;
    this.goal = new Goal(touch);
    this.asked = new Arrow(false, "--asked", 0.35, 7, touch);
    this.given = new Arrow(true, "--given", 0, 6, touch);
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(this.passed, 3));
    this.way = new Line(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.6 }));
    this.way.frustumCulled = false;
    const axes = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)].map((along) => {
      const ends = new BufferGeometry().setFromPoints([along.clone().multiplyScalar(-AXIS), along.clone().multiplyScalar(AXIS)]);
      return new Line(ends, new LineBasicMaterial());
    });
    this.marker.visible = false;
    this.group.add(...axes, this.way, this.marker);
    const copper = new MeshPhongMaterial({ color: "#a8623a", specular: "#442", shininess: 30 });
    this.group.add(...partsOf(scene, "coil").map((coil) => placePart(coil, copper)), chips(scene));
    stage.canvas.ariaLabel =
      "Axes, and a marker for the mover. Arrow keys move it as seen here, plus and minus along z, question mark lists all keys.";
    stage.scene.add(this.group, this.goal.group, this.given.mesh, this.asked.mesh);
    const dress = (): void => {
      axes.forEach((axis, i) => axis.material.color.set(css(`--s${"xyz"[i]!}`)));
      this.marker.material.color.set(css("--pen"));
      this.way.material.color.set(css("--text"));
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
    const target = sample.vector("target");
    const asked = sample.vector("asked");
    const given = sample.vector("given");
    const now = [...[...p, ...target].map((x) => x * 20000), ...[...asked, ...given].map((x) => x * 250)];
    // Noise of the sensors is no reason to draw: 0.05 mm and 4 mN are.
    if (!now.some((x, i) => Math.abs(x - this.drawn[i]!) > 1 || Number.isNaN(this.drawn[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.drawn.set(now);
    const at = new Vector3(...p).multiplyScalar(MM);
    this.marker.visible = Number.isFinite(at.x);
    if (this.marker.visible) {
      this.marker.position.copy(at);
      this.came(at);
    }
    this.goal.move(target, p);
    this.aim(this.given, at, given);
    this.aim(this.asked, at, asked);
    if (!this.grasped && Number.isFinite(target[0])) this.wish.set(...target);
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.drawn.fill(NaN);
    this.kept = 0;
    this.way.geometry.setDrawRange(0, 0);
    this.marker.visible = false;
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

  felt(): { force: number; saturated: boolean } {
    return { force: NaN, saturated: false };
  }

  near(x: number, y: number, reach: number): boolean {
    if (!this.marker.visible) return false;
    const at = this.stage.project(this.marker.position);
    return Math.hypot(x - at.x, y - at.y) < reach;
  }

  grab(x: number, y: number): Wish {
    this.grasped = true;
    const at = this.stage.project(this.wish.clone().multiplyScalar(MM));
    this.slip = { x: at.x - x, y: at.y - y };
    return this.wanted();
  }

  /** In the plane through the marker that faces the camera. */
  drag(x: number, y: number): Wish {
    this.grasped = true;
    const { from, along } = this.stage.ray(x + this.slip.x, y + this.slip.y);
    const facing = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 2);
    const to = this.wish.clone().multiplyScalar(MM).sub(from);
    this.wish.copy(from.addScaledVector(along, to.dot(facing) / along.dot(facing))).divideScalar(MM);
    return this.wanted();
  }

  press(notches: number): Wish {
    this.grasped = true;
    this.wish.z += notches * STEP;
    return this.wanted();
  }

  nudge(right: number, up: number): Wish {
    this.grasped = true;
    const { matrixWorld } = this.stage.camera;
    this.wish.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 0), right * STEP);
    this.wish.addScaledVector(new Vector3().setFromMatrixColumn(matrixWorld, 1), up * STEP);
    return this.wanted();
  }

  anchor(): { x: number; y: number } {
    return this.stage.project(this.marker.position);
  }

  /** The marker's left side, middle and right side on the page [px]. */
  places(): { x: number; y: number }[] {
    const box = this.stage.canvas.getBoundingClientRect();
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).multiplyScalar(MARKER);
    return [-1, 0, 1].map((side) => {
      const { x, y } = this.stage.project(this.marker.position.clone().addScaledVector(right, side));
      return { x: x + box.left, y: y + box.top };
    });
  }

  private wanted(): Wish {
    const { x, y, z } = this.wish;
    return { p: [x, y, z] };
  }

  /** Keep this place of the way; the oldest goes. */
  private came(at: Vector3): void {
    if (this.kept === WAY) this.passed.copyWithin(0, 3);
    else this.kept++;
    at.toArray(this.passed, 3 * (this.kept - 1));
    this.way.geometry.getAttribute("position").needsUpdate = true;
    this.way.geometry.setDrawRange(0, this.kept);
  }

  private aim(arrow: Arrow, from: Vector3, force: Vector): void {
    if (!Number.isFinite(force[0] + from.x)) return arrow.hide();
    arrow.point(from, new Vector3(...force).multiplyScalar(this.arrowScale), this.stage.camera);
  }
}
