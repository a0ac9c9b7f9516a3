// Drawings of the mover: a marker with its trail, or the tool of a coil array with its magnets.

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

const MM_PER_M = 1000;
const MARKER_RADIUS_MM = 4;
const TRAIL_POINTS = 240;
const STEM_RADIUS_MM = 1.6; // for the drawing only: a device file states just the tip of the tool

export interface Mover {
  readonly group: Object3D;
  /** radius of the drawing about its centre [mm] */
  readonly radius: number;
  /** drawn position [mm]; NaN: not drawn */
  readonly place: Vector3;
  /** Set position [m] and quaternion R_SR; hidden if they are unknown. */
  move(p: readonly number[], q: readonly number[]): void;
  forget(): void;
}

export class Marker implements Mover {
  readonly group = new Group();
  readonly radius = MARKER_RADIUS_MM;
  private readonly ball = new Mesh(new SphereGeometry(MARKER_RADIUS_MM, 24, 16), new MeshPhongMaterial({ shininess: 40 }));
  private readonly trail: Line<BufferGeometry, LineBasicMaterial>;
  private readonly trailPoints = new Float32Array(3 * TRAIL_POINTS);
  private trailLength = 0;

  constructor(changed: () => void) {
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(this.trailPoints, 3));
    this.trail = new Line(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.6 }));
    this.trail.frustumCulled = false;
    this.ball.visible = false;
    this.group.add(this.trail, this.ball);
    const applyTheme = (): void => {
      this.ball.material.color.set(css("--pen"));
      this.trail.material.color.set(css("--text"));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  get place(): Vector3 {
    return worldPosition(this.ball);
  }

  move(p: readonly number[]): void {
    this.ball.visible = Number.isFinite(p[0]!);
    if (!this.ball.visible) return;
    this.ball.position.set(p[0]! * MM_PER_M, p[1]! * MM_PER_M, p[2]! * MM_PER_M);
    // Append to the trail, and drop its oldest point.
    if (this.trailLength === TRAIL_POINTS) this.trailPoints.copyWithin(0, 3);
    else this.trailLength++;
    this.ball.position.toArray(this.trailPoints, 3 * (this.trailLength - 1));
    this.trail.geometry.getAttribute("position").needsUpdate = true;
    this.trail.geometry.setDrawRange(0, this.trailLength);
  }

  forget(): void {
    this.trailLength = 0;
    this.trail.geometry.setDrawRange(0, 0);
    this.ball.visible = false;
  }
}

/** Tool of a coil array: its magnets with true sizes and positions, and a stem to the tip. */
export class ArrayTool implements Mover {
  readonly group = new Group();
  readonly radius: number;
  private readonly pen = new MeshLambertMaterial();

  constructor(scene: PlateScene, changed: () => void) {
    const { origin, tip_distance } = scene.tool;
    const magnets = partsOf(scene, "magnet").filter(({ moves }) => moves);
    const metal = new MeshPhongMaterial({ color: "#8c97a6", specular: "#8899aa", shininess: 60 });
    const tip = -tip_distance * MM_PER_M;
    let lowest = 0;
    this.radius = 0;
    for (const magnet of magnets) {
      const position = magnet.position.map((x, i) => x - origin[i]!) as [number, number, number];
      this.group.add(placePart({ ...magnet, position }, metal));
      const reach = Math.hypot(magnet.outer_radius, magnet.length / 2) * MM_PER_M;
      lowest = Math.min(lowest, position[2] * MM_PER_M - reach);
      this.radius = Math.max(this.radius, Math.hypot(...position) * MM_PER_M + magnet.outer_radius * MM_PER_M);
    }
    // The stem reaches into the magnets, so that there is no gap.
    const top = Math.max(lowest, tip) * 0.5;
    const stem = [[0, tip], [STEM_RADIUS_MM * 0.5, tip + 0.4], [STEM_RADIUS_MM, tip + 1.6], [STEM_RADIUS_MM, top], [0, top]] as const;
    this.group.add(
      new Mesh(new LatheGeometry(stem.map(([x, y]) => new Vector2(x, y)), 24).rotateX(Math.PI / 2), this.pen),
    );
    const applyTheme = (): void => {
      this.pen.color.set(css("--pen"));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
    this.group.visible = false;
  }

  get place(): Vector3 {
    return worldPosition(this.group);
  }

  move(p: readonly number[], q: readonly number[]): void {
    this.group.visible = Number.isFinite(p[0]! + q[0]!);
    this.group.position.set(p[0]! * MM_PER_M, p[1]! * MM_PER_M, p[2]! * MM_PER_M);
    this.group.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    this.group.updateMatrixWorld();
  }

  forget(): void {
    this.group.visible = false;
  }
}

const worldPosition = (body: Object3D): Vector3 =>
  body.visible ? body.getWorldPosition(new Vector3()) : new Vector3(NaN, NaN, NaN);
