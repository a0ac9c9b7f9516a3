// Flat arrow for a force or torque that always faces the camera: filled for delivered, outlined for commanded.

import { BufferAttribute, BufferGeometry, Color, Mesh, MeshBasicMaterial, Vector3, type Camera } from "three";
import { css, onThemeChange } from "../theme";

const SHAFT_HALF_WIDTH_MM = 1.5;
const HEAD_HALF_WIDTH_MM = 4.2;
const HEAD_LENGTH_MM = 8.5;
const MIN_LENGTH_MM = 0.35; // shorter arrows are hidden

/** Half of the arrow's outline, as [position from the tail, half width]. */
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
    geometry.setIndex(filled ? FILL_TRIANGLES : RIM_TRIANGLES);
    // Drawn over everything, because the arrow of a radial force lies inside the stylus.
    this.mesh = new Mesh(
      geometry,
      new MeshBasicMaterial({ depthTest: false, depthWrite: false, transparent: true, side: 2 }),
    );
    this.mesh.renderOrder = order;
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    const applyTheme = (): void => {
      this.mesh.material.color = new Color(css(this.colour));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  /** Draw the arrow from `from` along `vector`, both in millimetres. */
  point(from: Vector3, vector: Vector3, camera: Camera): void {
    const length = vector.length();
    this.mesh.visible = length > MIN_LENGTH_MM;
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

  /** Write seven vertices: one side, the tip, the other side. */
  private write(first: number, from: Vector3, [tail, neck, barb, tip]: Outline): void {
    const corners: Outline = [tail!, neck!, barb!, tip!, [barb![0], -barb![1]], [neck![0], -neck![1]], [tail![0], -tail![1]]];
    corners.forEach(([s, w], k) => {
      this.at.copy(from).addScaledVector(this.along, s).addScaledVector(this.side, w);
      this.at.toArray(this.positions, 3 * (first + k));
    });
  }
}

function outline(length: number, grown: number): Outline {
  const head = Math.min(HEAD_LENGTH_MM, 0.6 * length);
  const wide = HEAD_HALF_WIDTH_MM * (head / HEAD_LENGTH_MM);
  const slim = SHAFT_HALF_WIDTH_MM * Math.min(1, 0.4 + 0.6 * (head / HEAD_LENGTH_MM));
  return [
    [-grown, slim + grown],
    [length - head - grown, slim + grown],
    [length - head - grown, wide + 1.8 * grown],
    [length + 2.2 * grown, 0],
  ];
}

const FILL_TRIANGLES = [0, 1, 5, 0, 5, 6, 2, 3, 4];
const RIM_TRIANGLES = Array.from({ length: 7 }, (_, k) => [k, (k + 1) % 7, 7 + k, 7 + k, (k + 1) % 7, 7 + ((k + 1) % 7)]).flat();
