// The view: turned about the device by dragging beside the stylus, nearer and further by wheel, pinch or buttons.

import { Vector3, type PerspectiveCamera } from "three";

const HOME = { azimuth: -62, elevation: 26, distance: 262 };

export class Orbit {
  readonly centre = new Vector3(0, 0, 43);
  private azimuth = HOME.azimuth;
  private elevation = HOME.elevation;
  distance = HOME.distance;

  constructor(
    private readonly camera: PerspectiveCamera,
    private readonly moved: () => void,
  ) {
    this.aim();
  }

  /** Turn by degrees. */
  turn(azimuth: number, elevation: number): void {
    this.azimuth += azimuth;
    this.elevation = Math.min(89, Math.max(-15, this.elevation + elevation));
    this.place();
  }

  zoom(factor: number): void {
    this.distance = Math.min(700, Math.max(90, this.distance * factor));
    this.place();
  }

  reset(): void {
    Object.assign(this, HOME);
    this.place();
  }

  private place(): void {
    this.aim();
    this.moved();
  }

  private aim(): void {
    const a = (this.azimuth * Math.PI) / 180;
    const e = (this.elevation * Math.PI) / 180;
    this.camera.position
      .set(Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e))
      .multiplyScalar(this.distance)
      .add(this.centre);
    this.camera.lookAt(this.centre);
    this.camera.updateMatrixWorld();
  }
}
