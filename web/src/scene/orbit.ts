// Orbit camera: rotated by dragging beside the tool, zoomed by wheel, pinch or buttons.

import { Vector3, type PerspectiveCamera } from "three";

/** Initial view, in degrees and millimetres. */
export interface Home {
  azimuth: number;
  elevation: number;
  distance: number;
  centre: [number, number, number];
}

export class Orbit {
  readonly centre: Vector3;
  private azimuth: number;
  private elevation: number;
  distance: number;

  constructor(
    private readonly camera: PerspectiveCamera,
    private readonly onMove: () => void,
    private readonly home: Home,
  ) {
    this.centre = new Vector3(...home.centre);
    this.azimuth = home.azimuth;
    this.elevation = home.elevation;
    this.distance = home.distance;
    this.aim();
  }

  /** Rotate the view by these angles [deg]. */
  turn(azimuth: number, elevation: number): void {
    this.azimuth += azimuth;
    this.elevation = Math.min(89, Math.max(-15, this.elevation + elevation));
    this.place();
  }

  zoom(factor: number): void {
    this.distance = Math.min(Math.max(1200, 2 * this.home.distance), Math.max(90, this.distance * factor));
    this.place();
  }

  reset(): void {
    this.azimuth = this.home.azimuth;
    this.elevation = this.home.elevation;
    this.distance = this.home.distance;
    this.place();
  }

  private place(): void {
    this.aim();
    this.onMove();
  }

  private aim(): void {
    const a = (this.azimuth * Math.PI) / 180;
    const e = (this.elevation * Math.PI) / 180;
    this.camera.position
      .set(Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e))
      .multiplyScalar(this.distance)
      .add(this.centre);
    this.camera.lookAt(this.centre);
    this.camera.far = Math.max(2000, 2 * this.distance);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }
}
