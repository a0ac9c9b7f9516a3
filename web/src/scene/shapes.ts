// Bodies of a world with memory, at the poses in the row's memory.

import {
  BoxGeometry,
  BufferGeometry,
  CapsuleGeometry,
  CylinderGeometry,
  Float32BufferAttribute,
  Group,
  Mesh,
  MeshLambertMaterial,
  SphereGeometry,
  Vector3,
} from "three";
import type { Sample } from "../sample";
import type { Shape } from "../session";
import { make } from "../panels/dom";
import { css, onThemeChange } from "../theme";
import type { Stage } from "./stage";

const MIN_VISIBLE_MOVE_M = 2e-5;
const MIN_VISIBLE_TURN = 2e-3; // of a quaternion's component

const COLOURS = { held: "--held", moves: "--loose", fixed: "--base", path: "--map-ink", "": "--plug" };
const LABELS = { held: "held body", moves: "moves", fixed: "fixed body", path: "path" };

/** Upper bound of a body's radius about its centre [m]. */
const reach = ({ size, points }: Shape): number =>
  Math.max(0, ...size, ...points.map(Math.abs), size.length === 2 ? size[0]! + size[1]! : 0);

export class Shapes {
  private readonly group = new Group();
  private readonly materials = {
    held: new MeshLambertMaterial({ flatShading: true }),
    moves: new MeshLambertMaterial({ flatShading: true }),
    // Translucent, because the held body may be inside.
    fixed: new MeshLambertMaterial({ transparent: true, opacity: 0.4, depthWrite: false }),
    path: new MeshLambertMaterial(),
    "": new MeshLambertMaterial(),
  };
  private shapes: Shape[] = [];
  private lastText = "[]";
  private drawn: number[][] = [];

  /** `unit`: scene units per metre. */
  constructor(
    private readonly stage: Stage,
    private readonly unit: number,
    shapes: Shape[],
    private readonly legend: HTMLElement,
  ) {
    stage.scene.add(this.group);
    const applyTheme = (): void => {
      for (const [role, colour] of Object.entries(COLOURS)) this.materials[role as Shape["role"]].color.set(css(colour));
      stage.touch();
    };
    onThemeChange(applyTheme);
    applyTheme();
    this.build(shapes);
  }

  /** Replace the bodies, if they changed. */
  build(shapes: Shape[]): void {
    const text = JSON.stringify(shapes);
    if (text === this.lastText) return;
    this.lastText = text;
    for (const child of [...this.group.children]) {
      (child as Mesh<BufferGeometry>).geometry.dispose();
      this.group.remove(child);
    }
    this.shapes = shapes;
    for (const shape of shapes) {
      const mesh = new Mesh(geometry(shape, this.unit), this.materials[shape.role]);
      mesh.visible = false;
      if (shape.place === null) this.put(mesh, shape.at);
      this.group.add(mesh);
    }
    this.drawn = shapes.map(() => []);
    this.stage.addMoving(this.group);
    this.stage.touch();
    this.updateLegend();
  }

  /** Set position [m] and quaternion. */
  private put(mesh: Mesh, [x, y, z, ...q]: number[]): void {
    mesh.position.set(x! * this.unit, y! * this.unit, z! * this.unit);
    mesh.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    mesh.visible = true;
  }

  /** Update the legend of the roles. */
  private updateLegend(): void {
    const list = this.legend;
    const roles = (["held", "moves", "fixed", "path"] as const).filter((role) => this.shapes.some((shape) => shape.role === role));
    for (const old of [...list.querySelectorAll(".role")]) old.remove();
    list.append(
      ...roles.map((role) => {
        const chip = make("span", { ariaHidden: "true", className: `body ${role}` });
        return make("li", { className: "role" }, chip, LABELS[role]);
      }),
    );
    if (list.childElementCount) list.hidden = false;
  }

  /** Whether the world is a scene, whose bodies have roles. */
  get scene(): boolean {
    return this.shapes.some(({ role }) => role !== "");
  }

  /** Centre and radius of the scene in its initial state [m]. */
  get extent(): { centre: number[]; radius: number } {
    const known = this.shapes.filter(({ at }) => at.length);
    const axis = (i: number): [number, number] => {
      const ends = known.flatMap((shape) => [shape.at[i]! - reach(shape), shape.at[i]! + reach(shape)]);
      return ends.length ? [Math.min(...ends), Math.max(...ends)] : [-0.02, 0.02];
    };
    const spans = [axis(0), axis(1), axis(2)];
    return {
      centre: spans.map(([low, high]) => (low + high) / 2),
      radius: Math.hypot(...spans.map(([low, high]) => (high - low) / 2)),
    };
  }

  show(sample: Sample): void {
    if (!this.shapes.length) return;
    const memory = sample.list("memory");
    let moved = false;
    this.shapes.forEach((shape, k) => {
      if (shape.place === null) return;
      const p = Array.from(memory.subarray(shape.place, shape.place + 3));
      const q = shape.attitude === null ? [0, 0, 0, 1] : Array.from(memory.subarray(shape.attitude, shape.attitude + 4));
      const now = [...p.map((x) => x / MIN_VISIBLE_MOVE_M), ...q.map((x) => x / MIN_VISIBLE_TURN)];
      const before = this.drawn[k]!;
      if (before.length && now.every((x, i) => !(Math.abs(x - before[i]!) > 1) && isNaN(x) === isNaN(before[i]!))) return;
      this.drawn[k] = now;
      const mesh = this.group.children[k]!;
      mesh.visible = now.length === 7 && now.every(Number.isFinite);
      if (mesh.visible) {
        mesh.position.set(p[0]! * this.unit, p[1]! * this.unit, p[2]! * this.unit);
        mesh.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
      }
      moved = true;
    });
    if (moved) this.stage.touchMoving();
  }

  forget(): void {
    this.group.children.forEach((mesh, k) => (mesh.visible = this.shapes[k]!.place === null));
    this.drawn = this.shapes.map(() => []);
    this.stage.touchMoving();
  }

  /** Centre of each body on the canvas [CSS px], for tests. */
  get spots(): { x: number; y: number }[] {
    return this.group.children.map((mesh) => this.stage.project(mesh.getWorldPosition(new Vector3())));
  }

  /** Drawn position of each body [m], for tests; null: not drawn. */
  get places(): (number[] | null)[] {
    return this.group.children.map((mesh) => (mesh.visible ? mesh.position.toArray().map((x) => x / this.unit) : null));
  }
}

/** Geometry of a body about its origin; capsules and cylinders along z. */
function geometry({ kind, size, points, corners }: Shape, unit: number): BufferGeometry {
  const [a, b, c] = size.map((x) => x * unit) as [number, number, number];
  switch (kind) {
    case "capsule":
      return new CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
    case "cylinder":
      return new CylinderGeometry(a, a, 2 * b, 40).rotateX(Math.PI / 2);
    case "ellipsoid":
      return new SphereGeometry(1, 32, 20).scale(a, b, c);
    case "mesh": {
      const made = new BufferGeometry();
      made.setAttribute("position", new Float32BufferAttribute(points.map((x) => x * unit), 3));
      made.setIndex(corners);
      made.computeVertexNormals();
      return made;
    }
    case "box":
      return new BoxGeometry(2 * a, 2 * b, 2 * c);
    default:
      return new SphereGeometry(a, 32, 20);
  }
}
