// Bodies of a world with memory: a ball, a key, a box, each where the numbers of the row's memory have it.

import {
  BoxGeometry,
  type BufferGeometry,
  CapsuleGeometry,
  CylinderGeometry,
  Group,
  Mesh,
  MeshLambertMaterial,
  SphereGeometry,
} from "three";
import type { Sample } from "../sample";
import type { Shape } from "../session";
import { css, onThemeChange } from "../theme";
import type { Stage } from "./stage";

const MOVED = 2e-5; // m: less is no reason to draw
const TURNED = 2e-3; // of a quaternion's parts

export class Shapes {
  private readonly group = new Group();
  private readonly material = new MeshLambertMaterial();
  private shapes: Shape[] = [];
  private told = "[]";
  private drawn: number[][] = [];

  /** `unit`: units of the picture per metre. */
  constructor(
    private readonly stage: Stage,
    private readonly unit: number,
    shapes: Shape[],
  ) {
    stage.scene.add(this.group);
    const dress = (): void => {
      this.material.color.set(css("--plug"));
      stage.touch();
    };
    onThemeChange(dress);
    dress();
    this.build(shapes);
  }

  /** Another world, or other sizes. */
  build(shapes: Shape[]): void {
    const told = JSON.stringify(shapes);
    if (told === this.told) return;
    this.told = told;
    for (const child of [...this.group.children]) {
      (child as Mesh<BufferGeometry>).geometry.dispose();
      this.group.remove(child);
    }
    this.shapes = shapes;
    for (const shape of shapes) {
      const mesh = new Mesh(geometry(shape, this.unit), this.material);
      mesh.visible = false;
      this.group.add(mesh);
    }
    this.drawn = shapes.map(() => []);
    this.stage.joins(this.group);
    this.stage.touch();
  }

  show(sample: Sample): void {
    if (!this.shapes.length) return;
    const memory = sample.list("memory");
    let moved = false;
    this.shapes.forEach((shape, k) => {
      const p = Array.from(memory.subarray(shape.place, shape.place + 3));
      const q = shape.attitude === null ? [0, 0, 0, 1] : Array.from(memory.subarray(shape.attitude, shape.attitude + 4));
      const now = [...p.map((x) => x / MOVED), ...q.map((x) => x / TURNED)];
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
    if (moved) this.stage.moved();
  }

  forget(): void {
    for (const mesh of this.group.children) mesh.visible = false;
    this.drawn = this.shapes.map(() => []);
    this.stage.moved();
  }

  /** Where each body is in the picture [m], for tests; null where it is not drawn. */
  get places(): (number[] | null)[] {
    return this.group.children.map((mesh) => (mesh.visible ? mesh.position.toArray().map((x) => x / this.unit) : null));
  }
}

/** The body about its own origin; capsules and cylinders along z. */
function geometry({ kind, size }: Shape, unit: number): BufferGeometry {
  const [a, b, c] = size.map((x) => x * unit) as [number, number, number];
  switch (kind) {
    case "capsule":
      return new CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
    case "cylinder":
      return new CylinderGeometry(a, a, 2 * b, 40).rotateX(Math.PI / 2);
    case "box":
      return new BoxGeometry(2 * a, 2 * b, 2 * c);
    default:
      return new SphereGeometry(a, 32, 20);
  }
}
