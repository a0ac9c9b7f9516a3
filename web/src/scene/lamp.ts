// Light on a body for pictures that the page draws itself: what three's shaders for Lambert and Phong materials compute.

import { type Color, type DirectionalLight, type HemisphereLight, type MeshLambertMaterial, MeshPhongMaterial, Vector3 } from "three";

/** Sky and sun on one material, by the formulas of three's own shaders. */
export class Lamp {
  private readonly up = new Vector3();
  private readonly towardsSun = new Vector3();
  private readonly view = new Vector3();
  private readonly half = new Vector3();
  private readonly specular: Color | null;
  private readonly shininess: number;
  private readonly out: [number, number, number] = [0, 0, 0];

  constructor(
    private readonly sky: HemisphereLight,
    private readonly sun: DirectionalLight,
    private readonly material: MeshLambertMaterial | MeshPhongMaterial,
    private readonly eye: Vector3,
  ) {
    this.up.copy(sky.position).normalize();
    this.towardsSun.copy(sun.position).sub(sun.target.position).normalize();
    this.specular = material instanceof MeshPhongMaterial ? material.specular : null;
    this.shininess = material instanceof MeshPhongMaterial ? material.shininess : 0;
  }

  /** Red, green and blue, 0…255, of a place with `normal`, which points out of the body. */
  colour(at: Vector3, normal: Vector3): [number, number, number] {
    this.view.subVectors(this.eye, at).normalize();
    const upward = 0.5 * normal.dot(this.up) + 0.5;
    const facing = Math.max(0, normal.dot(this.towardsSun));
    let gloss = 0;
    let grazing = 0;
    if (this.specular && facing > 0) {
      this.half.addVectors(this.view, this.towardsSun).normalize();
      const seen = this.half.dot(this.view);
      grazing = 2 ** ((-5.55473 * seen - 6.98316) * seen);
      gloss = 0.25 * (0.5 * this.shininess + 1) * Math.max(0, normal.dot(this.half)) ** this.shininess;
    }
    for (let k = 0; k < 3; k++) {
      const part = PARTS[k]!;
      const sun = this.sun.color[part] * this.sun.intensity * facing;
      const sky = (this.sky.groundColor[part] * (1 - upward) + this.sky.color[part] * upward) * this.sky.intensity;
      const mirror = this.specular ? (this.specular[part] * (1 - grazing) + grazing) * gloss : 0;
      this.out[k] = shade((this.material.color[part] * (sky + sun) + mirror * sun) / Math.PI);
    }
    return this.out;
  }
}

const PARTS = ["r", "g", "b"] as const;

/** Linear light to what a screen wants, 0…255. */
function shade(light: number): number {
  if (light >= 1) return 255;
  return 255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
}
