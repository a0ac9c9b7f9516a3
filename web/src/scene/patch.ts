// Small canvas that follows the moving part over the backdrop: software rendering costs time per pixel.

import { type Camera, type DirectionalLight, type HemisphereLight, Mesh, type Object3D, type PerspectiveCamera, Vector3 } from "three";
import { type Screen, SoftwareRenderer } from "./software_renderer";

const MARGIN_PX = 6; // around the moving part, for outlines and antialiasing
const SIZE_STEP_PX = 64; // every change of size allocates a new buffer
const MAX_EXCESS_STEPS = 2; // of the size, before it is reduced

interface Size {
  width: number;
  height: number;
}

export class Patch {
  private readonly canvas = document.createElement("canvas");
  private readonly renderer: SoftwareRenderer;
  private size: Size = { width: 0, height: 0 };

  constructor(over: HTMLCanvasElement, sky: HemisphereLight, sun: DirectionalLight) {
    this.canvas.className = "patch";
    this.canvas.ariaHidden = "true";
    this.canvas.hidden = true;
    over.before(this.canvas);
    this.renderer = new SoftwareRenderer(this.canvas, sky, sun);
  }

  /** Draw `objects` as seen by `camera` in a view of size `view` [CSS px], dimmed behind `screen`. */
  draw(objects: readonly Object3D[], camera: PerspectiveCamera, view: Size, resolution: number, screen: Screen | null): void {
    const frame = outline(objects, camera, view);
    this.canvas.hidden = frame === null;
    if (!frame) return;
    this.size = {
      width: fitSize(this.size.width, frame.width, view.width),
      height: fitSize(this.size.height, frame.height, view.height),
    };
    const { width, height } = this.size;
    const left = Math.floor(clamp(frame.left - (width - frame.width) / 2, view.width - width));
    const top = Math.floor(clamp(frame.top - (height - frame.height) / 2, view.height - height));
    const ratio = Math.min(devicePixelRatio, resolution);
    this.renderer.draw(objects, camera, view, { left, top, width, height, ratio }, screen);
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px`, transform: `translate(${left}px, ${top}px)` });
  }

  hide(): void {
    this.canvas.hidden = true;
  }
}

/** Canvas length for `needed` px: the present one if it fits, otherwise in whole steps; at most `most`. */
function fitSize(present: number, needed: number, most: number): number {
  const wanted = SIZE_STEP_PX * Math.ceil(needed / SIZE_STEP_PX);
  if (present >= wanted && present <= wanted + MAX_EXCESS_STEPS * SIZE_STEP_PX && present <= most) return present;
  return Math.min(wanted, most);
}

function clamp(value: number, most: number): number {
  return Math.max(0, Math.min(value, most));
}

const corner = new Vector3();

/** Bounding rectangle of `objects` in the view [CSS px]; null if none is visible. */
function outline(objects: readonly Object3D[], camera: Camera, view: Size): (Size & { left: number; top: number }) | null {
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const object of objects) {
    object.updateMatrixWorld();
    object.traverseVisible((part) => {
      const { geometry } = part as Mesh;
      if (!geometry) return;
      if (!geometry.boundingBox) geometry.computeBoundingBox();
      const { min, max } = geometry.boundingBox!;
      for (let k = 0; k < 8; k++) {
        corner.set(k & 1 ? min.x : max.x, k & 2 ? min.y : max.y, k & 4 ? min.z : max.z);
        corner.applyMatrix4(part.matrixWorld).project(camera);
        const x = ((corner.x + 1) / 2) * view.width;
        const y = ((1 - corner.y) / 2) * view.height;
        [left, right] = [Math.min(left, x), Math.max(right, x)];
        [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
      }
    });
  }
  left = Math.max(0, left - MARGIN_PX);
  top = Math.max(0, top - MARGIN_PX);
  const width = Math.min(view.width, right + MARGIN_PX) - left;
  const height = Math.min(view.height, bottom + MARGIN_PX) - top;
  return width > 0 && height > 0 ? { left, top, width, height } : null;
}
