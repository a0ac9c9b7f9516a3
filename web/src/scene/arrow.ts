// A force as a flat arrow that always faces the camera: filled for what is given, an outline for what is asked.

import { BufferAttribute, BufferGeometry, Color, Mesh, MeshBasicMaterial, Vector3, type Camera } from "three";
import { css, onThemeChange } from "../theme";

const SHAFT = 1.5; // mm, half widths
const HEAD = 4.2;
const POINT = 8.5; // length of the head
const SHORTEST = 0.35; // mm: below this there is nothing to point at

/** Half widths along the arrow, as [position from the end, half width]. */
type Outline = [number, number][];

export class Arrow {
  readonly mesh: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly positions = new Float32Array(3 * 14);
  private readonly along = new Vector3();
  private readonly side = new Vector3();
  private readonly at = new Vector3();

  constructor(
    filled: boolean,
    private readonly colour: string,
    private readonly widen: number,
    order: number,
    changed: () => void,
  ) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(this.positions, 3));
    geometry.setIndex(filled ? FILL : RIM);
    // Drawn over everything: a radial force lies inside the pen.
    this.mesh = new Mesh(
      geometry,
      new MeshBasicMaterial({ depthTest: false, depthWrite: false, transparent: true, side: 2 }),
    );
    this.mesh.renderOrder = order;
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    const dress = (): void => {
      this.mesh.material.color = new Color(css(this.colour));
      changed();
    };
    onThemeChange(dress);
    dress();
  }

  /** From `from`, along `vector`, both in millimetres. */
  point(from: Vector3, vector: Vector3, camera: Camera): void {
    const length = vector.length();
    this.mesh.visible = length > SHORTEST;
    if (!this.mesh.visible) return;
    this.along.copy(vector).divideScalar(length);
    this.side.subVectors(camera.position, from).cross(this.along);
    if (this.side.lengthSq() < 1e-6) this.side.set(1, 0, 0);
    this.side.normalize();
    this.write(0, from, outline(length, this.widen));
    this.write(7, from, outline(length, this.widen + 0.8));
    this.mesh.geometry.getAttribute("position").needsUpdate = true;
    this.mesh.geometry.computeBoundingBox();
  }

  get visible(): boolean {
    return this.mesh.visible;
  }

  hide(): void {
    this.mesh.visible = false;
  }

  /** Seven corners: up one side, over the point, down the other. */
  private write(first: number, from: Vector3, [tail, neck, barb, tip]: Outline): void {
    const corners: Outline = [tail!, neck!, barb!, tip!, [barb![0], -barb![1]], [neck![0], -neck![1]], [tail![0], -tail![1]]];
    corners.forEach(([s, w], k) => {
      this.at.copy(from).addScaledVector(this.along, s).addScaledVector(this.side, w);
      this.at.toArray(this.positions, 3 * (first + k));
    });
  }
}

function outline(length: number, grown: number): Outline {
  const head = Math.min(POINT, 0.6 * length);
  const wide = HEAD * (head / POINT);
  const slim = SHAFT * Math.min(1, 0.4 + 0.6 * (head / POINT));
  return [
    [-grown, slim + grown],
    [length - head - grown, slim + grown],
    [length - head - grown, wide + 1.8 * grown],
    [length + 2.2 * grown, 0],
  ];
}

const FILL = [0, 1, 5, 0, 5, 6, 2, 3, 4];
const RIM = Array.from({ length: 7 }, (_, k) => [k, (k + 1) % 7, 7 + k, 7 + k, (k + 1) % 7, 7 + ((k + 1) % 7)]).flat();
