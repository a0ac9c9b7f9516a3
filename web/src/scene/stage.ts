// The drawing surface: camera, light, and a renderer that draws only what changed. Where drawing is slow, what stands
// still is drawn once and kept under the canvas, and a small canvas over it redraws only the moving parts.

import {
  Color,
  DirectionalLight,
  HemisphereLight,
  type Object3D,
  PerspectiveCamera,
  Scene,
  Vector3,
  WebGLRenderer,
} from "three";
import { css, onThemeChange } from "../theme";
import { Backdrop } from "./backdrop";
import { DETAIL, type Level } from "./detail";
import { Patch } from "./patch";
import type { Screen } from "./sketch";

/** From `from` [mm] in the unit direction `along`. */
export interface Ray {
  from: Vector3;
  along: Vector3;
}

const STILL = 0;
const MOVING = 1; // the layers of what stands still and of what moves
const SETTLE = 150; // ms without a change after which what stands still is worth keeping
const FADED = 3000; // ms between two looks at what changes slowly while the rest moves

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 10, 2000);
  private readonly renderer: WebGLRenderer;
  private readonly sky = new HemisphereLight(0xffffff, 0x8890a0, 2.2);
  private readonly sun = new DirectionalLight(0xffffff, 2.0);
  private readonly backdrop: Backdrop;
  private readonly patch: Patch;
  private detail = DETAIL.full;
  private moving: Object3D[] = [];
  private screen: Screen | null = null;
  private dirty = true;
  private ratio = 0;
  /** when something that stands still changed last, and when it was drawn last [ms] */
  private changed = 0;
  private stirred = true;
  private faded = false;
  private kept = 0;
  private size = { width: 1, height: 1 };
  private middle: { x: number; y: number } | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    best: Level,
  ) {
    // Without a graphics processor smooth edges cost four times the picture: quick comes first.
    this.renderer = new WebGLRenderer({ canvas, antialias: best === "full", alpha: true });
    this.backdrop = new Backdrop(canvas);
    this.patch = new Patch(canvas, this.sky, this.sun);
    this.sky.layers.enableAll();
    this.sun.layers.enableAll();
    this.camera.layers.enable(MOVING);
    this.camera.up.set(0, 0, 1);
    this.sun.position.set(-60, -80, 160);
    this.scene.add(this.sky, this.sun);
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement!);
    onThemeChange(() => this.dress());
    this.dress();
    this.level = best;
  }

  /** `objects` move over what stands still, which may then be drawn once and kept; `screen` dims them behind it. */
  moves(objects: Object3D[], screen: Screen): void {
    this.moving = objects;
    this.screen = screen;
    for (const object of objects) object.traverse((part) => part.layers.set(MOVING));
  }

  /** `object` moves, too, with whatever it holds now. */
  join(object: Object3D): void {
    if (!this.moving.length) return;
    if (!this.moving.includes(object)) this.moving.push(object);
    object.traverse((part) => part.layers.set(MOVING));
  }

  /** How much to draw. */
  set level(level: Level) {
    this.detail = DETAIL[level];
    this.resize();
  }

  /** Something changed that mostly stands still: draw all of it at the next frame. */
  touch(): void {
    this.dirty = true;
    this.stirred = true;
    this.backdrop.drop();
  }

  /** Only what moves did: draw it at the next frame. */
  touchMoving(): void {
    this.dirty = true;
  }

  /** What stands still changed a little: it can wait for seconds, or until the rest has stopped. */
  fade(): void {
    this.faded = true;
  }

  /** Draw if needed; true if it did. */
  draw(now: number): boolean {
    if (this.stirred) this.changed = now;
    this.stirred = false;
    if (this.faded && now - this.kept > FADED) {
      this.faded = false;
      this.dirty = true;
      this.backdrop.holds = false;
    }
    if (!this.dirty) return false;
    this.dirty = false;
    const layered = this.detail.layered && this.moving.length > 0 && now - this.changed >= SETTLE;
    if (layered) this.drawLayers(now);
    else this.drawWhole(now);
    return true;
  }

  /** How often what stands still was drawn to be kept. */
  get kepts(): number {
    return this.backdrop.made;
  }

  private drawWhole(now: number): void {
    this.backdrop.drop();
    this.patch.hide();
    this.canvas.classList.remove("empty");
    this.sharpen(this.detail.whole);
    this.camera.layers.enable(STILL);
    this.camera.layers.enable(MOVING);
    this.renderer.render(this.scene, this.camera);
    this.kept = now;
    this.faded = false;
  }

  private drawLayers(now: number): void {
    if (!this.backdrop.holds) {
      this.sharpen(this.detail.kept);
      this.camera.layers.set(STILL);
      this.renderer.render(this.scene, this.camera);
      this.backdrop.take(this.canvas);
      this.renderer.clear();
      this.canvas.classList.add("empty");
      this.kept = now;
    }
    this.patch.draw(this.moving, this.camera, this.size, this.detail.moving, this.screen);
  }

  /** Where a point in space is on the canvas [CSS px]. */
  project(point: Vector3): { x: number; y: number } {
    const p = point.clone().project(this.camera);
    return { x: ((p.x + 1) / 2) * this.size.width, y: ((1 - p.y) / 2) * this.size.height };
  }

  /** From the camera through a place on the canvas: origin and unit direction. */
  ray(x: number, y: number): Ray {
    const far = new Vector3((x / this.size.width) * 2 - 1, 1 - (y / this.size.height) * 2, 0.5);
    far.unproject(this.camera);
    return { from: this.camera.position.clone(), along: far.sub(this.camera.position).normalize() };
  }

  /** Where on the canvas the camera's axis is [CSS px]; null: in its middle. */
  set centre(centre: { x: number; y: number } | null) {
    this.middle = centre;
    this.resize();
  }

  /** From how far a ball of `radius` is seen within `pixels` of its middle. */
  fit(radius: number, pixels: number): number {
    const angle = Math.atan((2 * pixels * Math.tan((this.camera.fov * Math.PI) / 360)) / this.size.height);
    return radius / Math.sin(angle);
  }

  /** Pixels per millimetre at `distance` from the camera. */
  scale(distance: number): number {
    return this.size.height / (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360));
  }

  /** Draw with at most `sharpness` device pixels per CSS pixel. */
  private sharpen(sharpness: number): void {
    const ratio = Math.min(devicePixelRatio, sharpness);
    if (ratio === this.ratio) return;
    this.ratio = ratio;
    this.renderer.setPixelRatio(ratio);
  }

  private resize(): void {
    const frame = this.canvas.parentElement!;
    this.size = { width: Math.max(1, frame.clientWidth), height: Math.max(1, frame.clientHeight) };
    const { width, height } = this.size;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    if (this.middle) this.camera.setViewOffset(width, height, width / 2 - this.middle.x, height / 2 - this.middle.y, width, height);
    else this.camera.clearViewOffset();
    this.camera.updateProjectionMatrix();
    this.touch();
  }

  private dress(): void {
    this.sky.groundColor = new Color(css("--ground"));
    this.touch();
  }
}
