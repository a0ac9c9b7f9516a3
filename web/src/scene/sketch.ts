// A picture of a few moving things, drawn by the page itself into a plain canvas. Where there is no graphics processor,
// WebGL is computed in another process and fetched back, which takes longer than to draw a stylus and two arrows here.
//
// Bodies are lit at their corners, as three's Lambert and Phong materials are at every pixel, and hidden by depth; flat
// signs (basic materials) lie over them in the order of their `renderOrder`.

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
import { Lamp } from "./lamp";

/** What is drawn: a part of the view, in CSS px of the view, with so many pixels per CSS px. */
export interface Part {
  left: number;
  top: number;
  width: number;
  height: number;
  ratio: number;
}

/** A ball about the origin, through which what is behind it is seen only faintly. */
export interface Screen {
  radius: number;
  through: number;
}

type Solid = Mesh<BufferGeometry, MeshLambertMaterial | MeshPhongMaterial>;
type Sign = Mesh<BufferGeometry, MeshBasicMaterial> | Line<BufferGeometry, LineDashedMaterial>;

export class Sketch {
  private readonly context: CanvasRenderingContext2D;
  private picture = new ImageData(1, 1);
  private colours = new Uint32Array(1);
  private depth = new Float32Array(1);
  private readonly project = new Matrix4();
  private readonly unproject = new Matrix4();
  private part: Part = { left: 0, top: 0, width: 1, height: 1, ratio: 1 };
  private view = { width: 1, height: 1 };
  /** the corners of the present body: place on the picture, depth, colour */
  private corners = new Float32Array(0);

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly sky: HemisphereLight,
    private readonly sun: DirectionalLight,
  ) {
    // Kept where this processor writes it, every frame.
    this.context = canvas.getContext("2d", { willReadFrequently: true })!;
  }

  /** Draw `objects` as `camera` sees them in `part` of a view of `view` CSS px, behind `screen`. */
  draw(
    objects: readonly Object3D[],
    camera: PerspectiveCamera,
    view: { width: number; height: number },
    part: Part,
    screen: Screen | null,
  ): void {
    this.begin(camera, view, part);
    const signs: Sign[] = [];
    for (const object of objects) {
      object.updateMatrixWorld();
      object.traverseVisible((thing) => {
        const { geometry, material } = thing as Solid | Sign;
        if (!geometry) return;
        if (material instanceof MeshBasicMaterial || material instanceof LineDashedMaterial) signs.push(thing as Sign);
        else this.solid(thing as Solid, camera);
      });
    }
    if (screen) this.dim(screen, camera);
    this.context.putImageData(this.picture, 0, 0);
    for (const sign of signs.sort((a, b) => a.renderOrder - b.renderOrder)) this.sign(sign);
  }

  private begin(camera: PerspectiveCamera, view: { width: number; height: number }, part: Part): void {
    this.part = part;
    this.view = view;
    const width = Math.max(1, Math.round(part.width * part.ratio));
    const height = Math.max(1, Math.round(part.height * part.ratio));
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

  /** From -1…1 across the view to pixels of the picture. */
  private across(x: number): number {
    return (((x + 1) / 2) * this.view.width - this.part.left) * this.part.ratio;
  }

  private down(y: number): number {
    return (((1 - y) / 2) * this.view.height - this.part.top) * this.part.ratio;
  }

  private solid(body: Solid, camera: PerspectiveCamera): void {
    const places = body.geometry.getAttribute("position");
    const normals = body.geometry.getAttribute("normal");
    if (this.corners.length < 6 * places.count) this.corners = new Float32Array(6 * places.count);
    const lamp = new Lamp(this.sky, this.sun, body.material, camera.position);
    for (let k = 0; k < places.count; k++) {
      place.fromBufferAttribute(places, k).applyMatrix4(body.matrixWorld);
      normal.fromBufferAttribute(normals, k).transformDirection(body.matrixWorld);
      const [r, g, b] = lamp.colour(place, normal);
      place.applyMatrix4(this.project);
      const { corners } = this;
      corners[6 * k] = this.across(place.x);
      corners[6 * k + 1] = this.down(place.y);
      corners[6 * k + 2] = place.z;
      corners[6 * k + 3] = r;
      corners[6 * k + 4] = g;
      corners[6 * k + 5] = b;
    }
    const { index } = body.geometry;
    const count = index ? index.count : places.count;
    const at = (k: number): number => 6 * (index ? index.getX(k) : k);
    for (let k = 0; k < count; k += 3) this.triangle(at(k), at(k + 1), at(k + 2));
  }

  /** Fill a triangle of three corners where nothing nearer is; not one that shows its back, which a body hides. */
  private triangle(a: number, b: number, c: number): void {
    const { corners: n, colours, depth } = this;
    const { width, height } = this.picture;
    const ax = n[a]!, ay = n[a + 1]!, bx = n[b]!, by = n[b + 1]!, cx = n[c]!, cy = n[c + 1]!;
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax); // y grows downwards: a front goes round against the clock
    if (!(area < -1e-9)) return;
    const az = n[a + 2]!, bz = n[b + 2]!, cz = n[c + 2]!;
    const ar = n[a + 3]!, br = n[b + 3]!, cr = n[c + 3]!;
    const ag = n[a + 4]!, bg = n[b + 4]!, cg = n[c + 4]!;
    const ab = n[a + 5]!, bb = n[b + 5]!, cb = n[c + 5]!;
    // The shares of the corners, how they grow from pixel to pixel, and the pixels over which one of them grows by 1.
    const du = (by - cy) / area, dv = (cy - ay) / area, dw = -du - dv;
    const u1 = 1 / du, v1 = 1 / dv, w1 = 1 / dw;
    // Pixels whose middles lie inside.
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
      // From where to where no share is below zero; a long thin triangle fills little of its box.
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

  /** Where the ball stands before a body, let little of it through. */
  private dim({ radius, through }: Screen, camera: PerspectiveCamera): void {
    const { colours, depth, part } = this;
    const { width, height } = this.picture;
    const eye = camera.position;
    const outside = eye.lengthSq() - radius * radius;
    const faint = Math.round(255 * through) << 24;
    const [left, right, top, bottom] = this.around(radius);
    for (let y = Math.max(0, top); y < Math.min(height, bottom); y++) {
      const up = 1 - (2 * ((y + 0.5) / part.ratio + part.top)) / this.view.height;
      for (let x = Math.max(0, left); x < Math.min(width, right); x++) {
        const k = y * width + x;
        if (colours[k] === 0) continue;
        place.set((2 * ((x + 0.5) / part.ratio + part.left)) / this.view.width - 1, up, depth[k]!);
        place.applyMatrix4(this.unproject).sub(eye);
        const square = place.lengthSq();
        const half = place.dot(eye);
        const root = half * half - square * outside;
        if (root > 0 && -half - Math.sqrt(root) < square) colours[k] = (colours[k]! & 0xffffff) | faint;
      }
    }
  }

  /** Left, right, top and bottom of a box on the picture in which a ball about the origin is seen. */
  private around(radius: number): [number, number, number, number] {
    const box: [number, number, number, number] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let k = 0; k < 8; k++) {
      place.set(k & 1 ? radius : -radius, k & 2 ? radius : -radius, k & 4 ? radius : -radius).applyMatrix4(this.project);
      const x = this.across(place.x);
      const y = this.down(place.y);
      box[0] = Math.min(box[0], Math.floor(x));
      box[1] = Math.max(box[1], Math.ceil(x));
      box[2] = Math.min(box[2], Math.floor(y));
      box[3] = Math.max(box[3], Math.ceil(y));
    }
    return box;
  }

  /** A flat sign, over everything before it. */
  private sign(sign: Sign): void {
    const { context } = this;
    const places = sign.geometry.getAttribute("position");
    const xy: [number, number][] = [];
    for (let k = 0; k < places.count; k++) {
      place.fromBufferAttribute(places, k).applyMatrix4(sign.matrixWorld).applyMatrix4(this.project);
      xy.push([this.across(place.x), this.down(place.y)]);
    }
    const { material } = sign;
    context.globalAlpha = material.opacity;
    context.beginPath();
    if (material instanceof LineDashedMaterial) {
      const [from, to] = [xy[0]!, xy[1]!];
      const length = from3.fromBufferAttribute(places, 0).distanceTo(to3.fromBufferAttribute(places, 1));
      const scale = Math.hypot(to[0] - from[0], to[1] - from[1]) / Math.max(length, 1e-6);
      context.moveTo(...from);
      context.lineTo(...to);
      context.setLineDash([material.dashSize * scale, material.gapSize * scale]);
      context.strokeStyle = material.color.getStyle();
      context.stroke();
    } else {
      const { index } = sign.geometry;
      for (let k = 0; k < (index?.count ?? 0); k += 3) {
        const [a, b, c] = [xy[index!.getX(k)]!, xy[index!.getX(k + 1)]!, xy[index!.getX(k + 2)]!];
        const towards = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0;
        if (!towards && material.side === 0) continue; // its back
        // All one way round, or overlapping parts would cancel.
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

const place = new Vector3();
const normal = new Vector3();
const from3 = new Vector3();
const to3 = new Vector3();
