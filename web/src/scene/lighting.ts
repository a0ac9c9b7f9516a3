// Lighting for the software renderer: the same as in the Lambert and Phong shaders of three.js.

import { type Color, type DirectionalLight, type HemisphereLight, type MeshLambertMaterial, MeshPhongMaterial, Vector3 } from "three";

/** Hemisphere and directional light on one material, by the formulas of the shaders of three.js. */
export class Lighting {
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

  /** RGB colour (0…255) at the point `at` with outward `normal`. */
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
      const channel = CHANNELS[k]!;
      const sun = this.sun.color[channel] * this.sun.intensity * facing;
      const sky = (this.sky.groundColor[channel] * (1 - upward) + this.sky.color[channel] * upward) * this.sky.intensity;
      const mirror = this.specular ? (this.specular[channel] * (1 - grazing) + grazing) * gloss : 0;
      this.out[k] = encodeSrgb((this.material.color[channel] * (sky + sun) + mirror * sun) / Math.PI);
    }
    return this.out;
  }
}

const CHANNELS = ["r", "g", "b"] as const;

/** Convert linear light to sRGB, 0…255. */
function encodeSrgb(light: number): number {
  if (light >= 1) return 255;
  return 255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
}
