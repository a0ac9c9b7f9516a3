// Software renderer for a few small objects on a 2D canvas. Without a GPU, browsers compute WebGL in another process and
// copy the image back, which takes longer than drawing a stylus and two arrows here.
//
// Solids have Gouraud shading, with the lighting of three.js at the vertices, and a depth buffer. Flat overlays (basic
// materials) are drawn over them in the order of their `renderOrder`.

import {
  type BufferGeometry,
  type DirectionalLight,
  type HemisphereLight,
  type Line,
  LineDashedMaterial,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  type MeshLambertMaterial,
  type MeshPhongMaterial,
  type Object3D,
  type PerspectiveCamera,
  Vector3,
} from "three";
import { Lighting } from "./lighting";

/** Viewport: a rectangle of the view [CSS px], and its pixels per CSS px. */
export interface Viewport {
  left: number;
  top: number;
  width: number;
  height: number;
  ratio: number;
}

/** A translucent sphere about the origin, which dims objects behind it. */
export interface Screen {
  radius: number;
  /** opacity of objects behind it */
  opacity: number;
}

type Solid = Mesh<BufferGeometry, MeshLambertMaterial | MeshPhongMaterial>;
type Overlay = Mesh<BufferGeometry, MeshBasicMaterial> | Line<BufferGeometry, LineDashedMaterial>;

export class SoftwareRenderer {
  private readonly context: CanvasRenderingContext2D;
  private picture = new ImageData(1, 1);
  private colours = new Uint32Array(1);
  private depth = new Float32Array(1);
  private readonly project = new Matrix4();
  private readonly unproject = new Matrix4();
  private viewport: Viewport = { left: 0, top: 0, width: 1, height: 1, ratio: 1 };
  private view = { width: 1, height: 1 };
  /** vertices of the present solid: position on the canvas, depth, colour */
  private vertices = new Float32Array(0);

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly sky: HemisphereLight,
    private readonly sun: DirectionalLight,
  ) {
    // The CPU writes the canvas in every frame, so keep it in main memory.
    this.context = canvas.getContext("2d", { willReadFrequently: true })!;
  }

  /** Draw `objects` as seen by `camera` in `viewport` of a view of size `view` [CSS px], dimmed behind `screen`. */
  draw(
    objects: readonly Object3D[],
    camera: PerspectiveCamera,
    view: { width: number; height: number },
    viewport: Viewport,
    screen: Screen | null,
  ): void {
    this.begin(camera, view, viewport);
    const overlays: Overlay[] = [];
    for (const object of objects) {
      object.updateMatrixWorld();
      object.traverseVisible((child) => {
        const { geometry, material } = child as Solid | Overlay;
        if (!geometry) return;
        if (material instanceof MeshBasicMaterial || material instanceof LineDashedMaterial) overlays.push(child as Overlay);
        else this.solid(child as Solid, camera);
      });
    }
    if (screen) this.dim(screen, camera);
    this.context.putImageData(this.picture, 0, 0);
    for (const overlay of overlays.sort((a, b) => a.renderOrder - b.renderOrder)) this.overlay(overlay);
  }

  private begin(camera: PerspectiveCamera, view: { width: number; height: number }, viewport: Viewport): void {
    this.viewport = viewport;
    this.view = view;
    const width = Math.max(1, Math.round(viewport.width * viewport.ratio));
    const height = Math.max(1, Math.round(viewport.height * viewport.ratio));
    if (this.picture.width !== width || this.picture.height !== height || this.canvas.width !== width) {
      this.canvas.width = width;
      this.canvas.height = height;
      this.picture = new ImageData(width, height);
      this.colours = new Uint32Array(this.picture.data.buffer);
      this.depth = new Float32Array(width * height);
    }
    this.colours.fill(0);
    this.depth.fill(1);
    camera.updateMatrixWorld();
    this.project.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    this.unproject.copy(this.project).invert();
  }

  /** Convert normalised device coordinates (−1…1) to pixels of the canvas. */
  private across(x: number): number {
    return (((x + 1) / 2) * this.view.width - this.viewport.left) * this.viewport.ratio;
  }

  private down(y: number): number {
    return (((1 - y) / 2) * this.view.height - this.viewport.top) * this.viewport.ratio;
  }

  private solid(solid: Solid, camera: PerspectiveCamera): void {
    const positions = solid.geometry.getAttribute("position");
    const normals = solid.geometry.getAttribute("normal");
    if (this.vertices.length < 6 * positions.count) this.vertices = new Float32Array(6 * positions.count);
    const lighting = new Lighting(this.sky, this.sun, solid.material, camera.position);
    for (let k = 0; k < positions.count; k++) {
      point.fromBufferAttribute(positions, k).applyMatrix4(solid.matrixWorld);
      normal.fromBufferAttribute(normals, k).transformDirection(solid.matrixWorld);
      const [r, g, b] = lighting.colour(point, normal);
      point.applyMatrix4(this.project);
      const { vertices } = this;
      vertices[6 * k] = this.across(point.x);
      vertices[6 * k + 1] = this.down(point.y);
      vertices[6 * k + 2] = point.z;
      vertices[6 * k + 3] = r;
      vertices[6 * k + 4] = g;
      vertices[6 * k + 5] = b;
    }
    const { index } = solid.geometry;
    const count = index ? index.count : positions.count;
    const at = (k: number): number => 6 * (index ? index.getX(k) : k);
    for (let k = 0; k < count; k += 3) this.triangle(at(k), at(k + 1), at(k + 2));
  }

  /** Fill a triangle given by vertex indices, with depth test and back-face culling. */
  private triangle(a: number, b: number, c: number): void {
    const { vertices: n, colours, depth } = this;
    const { width, height } = this.picture;
    const ax = n[a]!, ay = n[a + 1]!, bx = n[b]!, by = n[b + 1]!, cx = n[c]!, cy = n[c + 1]!;
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax); // y points down, so that front faces are negative
    if (!(area < -1e-9)) return;
    const az = n[a + 2]!, bz = n[b + 2]!, cz = n[c + 2]!;
    const ar = n[a + 3]!, br = n[b + 3]!, cr = n[c + 3]!;
    const ag = n[a + 4]!, bg = n[b + 4]!, cg = n[c + 4]!;
    const ab = n[a + 5]!, bb = n[b + 5]!, cb = n[c + 5]!;
    // Increments of the barycentric coordinates per pixel, and their inverses.
    const du = (by - cy) / area, dv = (cy - ay) / area, dw = -du - dv;
    const u1 = 1 / du, v1 = 1 / dv, w1 = 1 / dw;
    // Pixels whose centres lie inside the bounding box.
    const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5));
    const right = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
    const top = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5));
    const bottom = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
    const px = left + 0.5;
    for (let y = top; y <= bottom; y++) {
      const py = y + 0.5;
      const u0 = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area;
      const v0 = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area;
      const w0 = 1 - u0 - v0;
      // Range of the row in which no coordinate is negative: a thin triangle fills little of its bounding box.
      let first = 0, last = right - left;
      if (du > 0) first = Math.max(first, -u0 * u1);
      else if (du < 0) last = Math.min(last, -u0 * u1);
      else if (u0 < 0) continue;
      if (dv > 0) first = Math.max(first, -v0 * v1);
      else if (dv < 0) last = Math.min(last, -v0 * v1);
      else if (v0 < 0) continue;
      if (dw > 0) first = Math.max(first, -w0 * w1);
      else if (dw < 0) last = Math.min(last, -w0 * w1);
      else if (w0 < 0) continue;
      for (let i = Math.ceil(first); i <= last; i++) {
        const u = u0 + i * du, v = v0 + i * dv, w = 1 - u - v;
        const k = y * width + left + i;
        const z = u * az + v * bz + w * cz;
        if (z >= depth[k]!) continue;
        depth[k] = z;
        const red = u * ar + v * br + w * cr, green = u * ag + v * bg + w * cg, blue = u * ab + v * bb + w * cb;
        colours[k] = 0xff000000 | (blue << 16) | (green << 8) | red;
      }
    }
  }

  /** Reduce the opacity of pixels behind the sphere. */
  private dim({ radius, opacity }: Screen, camera: PerspectiveCamera): void {
    const { colours, depth, viewport } = this;
    const { width, height } = this.picture;
    const eye = camera.position;
    const outside = eye.lengthSq() - radius * radius;
    const faint = Math.round(255 * opacity) << 24;
    const [left, right, top, bottom] = this.around(radius);
    for (let y = Math.max(0, top); y < Math.min(height, bottom); y++) {
      const up = 1 - (2 * ((y + 0.5) / viewport.ratio + viewport.top)) / this.view.height;
      for (let x = Math.max(0, left); x < Math.min(width, right); x++) {
        const k = y * width + x;
        if (colours[k] === 0) continue;
        point.set((2 * ((x + 0.5) / viewport.ratio + viewport.left)) / this.view.width - 1, up, depth[k]!);
        point.applyMatrix4(this.unproject).sub(eye);
        const square = point.lengthSq();
        const half = point.dot(eye);
        const root = half * half - square * outside;
        if (root > 0 && -half - Math.sqrt(root) < square) colours[k] = (colours[k]! & 0xffffff) | faint;
      }
    }
  }

  /** Bounding box of the sphere on the canvas: left, right, top, bottom. */
  private around(radius: number): [number, number, number, number] {
    const box: [number, number, number, number] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let k = 0; k < 8; k++) {
      point.set(k & 1 ? radius : -radius, k & 2 ? radius : -radius, k & 4 ? radius : -radius).applyMatrix4(this.project);
      const x = this.across(point.x);
      const y = this.down(point.y);
      box[0] = Math.min(box[0], Math.floor(x));
      box[1] = Math.max(box[1], Math.ceil(x));
      box[2] = Math.min(box[2], Math.floor(y));
      box[3] = Math.max(box[3], Math.ceil(y));
    }
    return box;
  }

  /** Draw a flat overlay over everything before it. */
  private overlay(overlay: Overlay): void {
    const { context } = this;
    const positions = overlay.geometry.getAttribute("position");
    const xy: [number, number][] = [];
    for (let k = 0; k < positions.count; k++) {
      point.fromBufferAttribute(positions, k).applyMatrix4(overlay.matrixWorld).applyMatrix4(this.project);
      xy.push([this.across(point.x), this.down(point.y)]);
    }
    const { material } = overlay;
    context.globalAlpha = material.opacity;
    context.beginPath();
    if (material instanceof LineDashedMaterial) {
      const [from, to] = [xy[0]!, xy[1]!];
      const length = from3.fromBufferAttribute(positions, 0).distanceTo(to3.fromBufferAttribute(positions, 1));
      const scale = Math.hypot(to[0] - from[0], to[1] - from[1]) / Math.max(length, 1e-6);
      context.moveTo(...from);
      context.lineTo(...to);
      context.setLineDash([material.dashSize * scale, material.gapSize * scale]);
      context.strokeStyle = material.color.getStyle();
      context.stroke();
    } else {
      const { index } = overlay.geometry;
      for (let k = 0; k < (index?.count ?? 0); k += 3) {
        const [a, b, c] = [xy[index!.getX(k)]!, xy[index!.getX(k + 1)]!, xy[index!.getX(k + 2)]!];
        const towards = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0;
        if (!towards && material.side === 0) continue; // back face
        // Same winding for all triangles, because opposite windings cancel where they overlap.
        context.moveTo(...a);
        context.lineTo(...(towards ? b : c));
        context.lineTo(...(towards ? c : b));
      }
      context.fillStyle = material.color.getStyle();
      context.fill();
    }
    context.globalAlpha = 1;
  }
}

const point = new Vector3();
const normal = new Vector3();
const from3 = new Vector3();
const to3 = new Vector3();
