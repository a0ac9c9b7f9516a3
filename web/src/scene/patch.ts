// A small canvas that follows what moves over a kept picture: a processor that draws pays for every pixel.

import { type Camera, type DirectionalLight, type HemisphereLight, Mesh, type Object3D, type PerspectiveCamera, Vector3 } from "three";
import { type Screen, Sketch } from "./sketch";

const MARGIN = 6; // px around what moves: edges are drawn a little wider than they are
const STEP = 64; // px: its size goes in steps, for another size means another picture buffer
const ROOM = 2; // steps by which it may be too large before it shrinks

interface Size {
  width: number;
  height: number;
}

export class Patch {
  private readonly canvas = document.createElement("canvas");
  private readonly sketch: Sketch;
  private size: Size = { width: 0, height: 0 };

  constructor(over: HTMLCanvasElement, sky: HemisphereLight, sun: DirectionalLight) {
    this.canvas.className = "patch";
    this.canvas.ariaHidden = "true";
    this.canvas.hidden = true;
    over.before(this.canvas);
    this.sketch = new Sketch(this.canvas, sky, sun);
  }

  /** Draw `objects` as `camera` sees them in a view of `view` CSS px, behind `screen`, and nothing else. */
  draw(objects: readonly Object3D[], camera: PerspectiveCamera, view: Size, sharpness: number, screen: Screen | null): void {
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
    const ratio = Math.min(devicePixelRatio, sharpness);
    this.sketch.draw(objects, camera, view, { left, top, width, height, ratio }, screen);
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px`, transform: `translate(${left}px, ${top}px)` });
  }

  hide(): void {
    this.canvas.hidden = true;
  }
}

/** A length that holds `needed` px, as it is or in whole steps, and none longer than `most`. */
function fitSize(present: number, needed: number, most: number): number {
  const wanted = STEP * Math.ceil(needed / STEP);
  if (present >= wanted && present <= wanted + ROOM * STEP && present <= most) return present;
  return Math.min(wanted, most);
}

function clamp(value: number, most: number): number {
  return Math.max(0, Math.min(value, most));
}

const corner = new Vector3();

/** The rectangle of the view in which `objects` are seen [CSS px]; null if none is. */
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
  left = Math.max(0, left - MARGIN);
  top = Math.max(0, top - MARGIN);
  const width = Math.min(view.width, right + MARGIN) - left;
  const height = Math.min(view.height, bottom + MARGIN) - top;
  return width > 0 && height > 0 ? { left, top, width, height } : null;
}
