// What is drawn where the mover is: a marker and the way that it came, or the tool of a coil array with its magnets.

import {
  BufferAttribute,
  BufferGeometry,
  Group,
  LatheGeometry,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshLambertMaterial,
  MeshPhongMaterial,
  type Object3D,
  SphereGeometry,
  Vector2,
  Vector3,
} from "three";
import type { PlateScene } from "../session";
import { css, onThemeChange } from "../theme";
import { partsOf, placePart } from "./parts";

const MM = 1000;
const MARKER = 4; // mm, radius
const WAY = 240; // places of the way that the mover came
const STEM = 1.6; // mm, radius: of the tool's shape the device file states its tip only

export interface Mover {
  readonly group: Object3D;
  /** how far it reaches from its middle [mm] */
  readonly radius: number;
  /** where it is drawn [mm]; NaN: it is not */
  readonly place: Vector3;
  /** Position [m] and quaternion R_SR; hidden where they are not known. */
  move(p: readonly number[], q: readonly number[]): void;
  forget(): void;
}

export class Marker implements Mover {
  readonly group = new Group();
  readonly radius = MARKER;
  private readonly ball = new Mesh(new SphereGeometry(MARKER, 24, 16), new MeshPhongMaterial({ shininess: 40 }));
  private readonly way: Line<BufferGeometry, LineBasicMaterial>;
  private readonly passed = new Float32Array(3 * WAY);
  private kept = 0;

  constructor(changed: () => void) {
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(this.passed, 3));
    this.way = new Line(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.6 }));
    this.way.frustumCulled = false;
    this.ball.visible = false;
    this.group.add(this.way, this.ball);
    const dress = (): void => {
      this.ball.material.color.set(css("--pen"));
      this.way.material.color.set(css("--text"));
      changed();
    };
    onThemeChange(dress);
    dress();
  }

  get place(): Vector3 {
    return placeOf(this.ball);
  }

  move(p: readonly number[]): void {
    this.ball.visible = Number.isFinite(p[0]!);
    if (!this.ball.visible) return;
    this.ball.position.set(p[0]! * MM, p[1]! * MM, p[2]! * MM);
    // Keep this place of the way; the oldest goes.
    if (this.kept === WAY) this.passed.copyWithin(0, 3);
    else this.kept++;
    this.ball.position.toArray(this.passed, 3 * (this.kept - 1));
    this.way.geometry.getAttribute("position").needsUpdate = true;
    this.way.geometry.setDrawRange(0, this.kept);
  }

  forget(): void {
    this.kept = 0;
    this.way.geometry.setDrawRange(0, 0);
    this.ball.visible = false;
  }
}

/** The magnets at their sizes and places in the tool, and a stem to its tip. */
export class ArrayTool implements Mover {
  readonly group = new Group();
  readonly radius: number;
  private readonly pen = new MeshLambertMaterial();

  constructor(scene: PlateScene, changed: () => void) {
    const { origin, tip_distance } = scene.tool;
    const magnets = partsOf(scene, "magnet").filter(({ moves }) => moves);
    const metal = new MeshPhongMaterial({ color: "#8c97a6", specular: "#8899aa", shininess: 60 });
    const tip = -tip_distance * MM;
    let lowest = 0;
    this.radius = 0;
    for (const magnet of magnets) {
      const position = magnet.position.map((x, i) => x - origin[i]!) as [number, number, number];
      this.group.add(placePart({ ...magnet, position }, metal));
      const reach = Math.hypot(magnet.outer_radius, magnet.length / 2) * MM;
      lowest = Math.min(lowest, position[2] * MM - reach);
      this.radius = Math.max(this.radius, Math.hypot(...position) * MM + magnet.outer_radius * MM);
    }
    // Into the magnets, so that nothing floats.
    const top = Math.max(lowest, tip) * 0.5;
    const stem = [[0, tip], [STEM * 0.5, tip + 0.4], [STEM, tip + 1.6], [STEM, top], [0, top]] as const;
    this.group.add(
      new Mesh(new LatheGeometry(stem.map(([x, y]) => new Vector2(x, y)), 24).rotateX(Math.PI / 2), this.pen),
    );
    const dress = (): void => {
      this.pen.color.set(css("--pen"));
      changed();
    };
    onThemeChange(dress);
    dress();
    this.group.visible = false;
  }

  get place(): Vector3 {
    return placeOf(this.group);
  }

  move(p: readonly number[], q: readonly number[]): void {
    this.group.visible = Number.isFinite(p[0]! + q[0]!);
    this.group.position.set(p[0]! * MM, p[1]! * MM, p[2]! * MM);
    this.group.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    this.group.updateMatrixWorld();
  }

  forget(): void {
    this.group.visible = false;
  }
}

const placeOf = (body: Object3D): Vector3 =>
  body.visible ? body.getWorldPosition(new Vector3()) : new Vector3(NaN, NaN, NaN);
