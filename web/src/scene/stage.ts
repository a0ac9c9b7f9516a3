// Camera, lights and renderer, which draws only after changes. Where drawing is slow, the static part of the scene is
// cached in a backdrop below the canvas, and a small canvas over it redraws only the moving part.

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
import { DETAIL, type DetailLevel } from "./detail";
import { Patch } from "./patch";
import type { Screen } from "./software_renderer";

/** Ray from `from` [mm] in the unit direction `along`. */
export interface Ray {
  from: Vector3;
  along: Vector3;
}

const STATIC_LAYER = 0;
const MOVING_LAYER = 1;
const SETTLING_TIME_MS = 150; // without a change of the static part, before it is cached
const SLOW_REDRAW_INTERVAL_MS = 3000; // of slow changes in the static part

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
  /** times of the last change and of the last drawing of the static part [ms] */
  private staticChangedAt = 0;
  private staticChanged = true;
  private slowlyChanged = false;
  private staticDrawnAt = 0;
  private size = { width: 1, height: 1 };
  private opticalCentre: { x: number; y: number } | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    best: DetailLevel,
  ) {
    // Without a GPU, antialiasing makes drawing four times slower.
    this.renderer = new WebGLRenderer({ canvas, antialias: best === "full", alpha: true });
    this.backdrop = new Backdrop(canvas);
    this.patch = new Patch(canvas, this.sky, this.sun);
    this.sky.layers.enableAll();
    this.sun.layers.enableAll();
    this.camera.layers.enable(MOVING_LAYER);
    this.camera.up.set(0, 0, 1);
    this.sun.position.set(-60, -80, 160);
    this.scene.add(this.sky, this.sun);
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement!);
    onThemeChange(() => this.applyTheme());
    this.applyTheme();
    this.level = best;
  }

  /** Declare `objects` as the moving part, so that the rest can be cached; `screen` dims them behind it. */
  setMoving(objects: Object3D[], screen: Screen): void {
    this.moving = objects;
    this.screen = screen;
    for (const object of objects) object.traverse((part) => part.layers.set(MOVING_LAYER));
  }

  /** Add `object` with its present children to the moving part. */
  addMoving(object: Object3D): void {
    if (!this.moving.length) return;
    if (!this.moving.includes(object)) this.moving.push(object);
    object.traverse((part) => part.layers.set(MOVING_LAYER));
  }

  /** Set the level of detail. */
  set level(level: DetailLevel) {
    this.detail = DETAIL[level];
    this.resize();
  }

  /** Redraw the whole scene in the next frame. */
  touch(): void {
    this.dirty = true;
    this.staticChanged = true;
    this.backdrop.invalidate();
  }

  /** Redraw the moving part in the next frame. */
  touchMoving(): void {
    this.dirty = true;
  }

  /** Redraw a slow change of the static part within seconds. */
  touchSlowly(): void {
    this.slowlyChanged = true;
  }

  /** Draw if needed; returns whether it did. */
  draw(now: number): boolean {
    if (this.staticChanged) this.staticChangedAt = now;
    this.staticChanged = false;
    if (this.slowlyChanged && now - this.staticDrawnAt > SLOW_REDRAW_INTERVAL_MS) {
      this.slowlyChanged = false;
      this.dirty = true;
      this.backdrop.valid = false;
    }
    if (!this.dirty) return false;
    this.dirty = false;
    const layered = this.detail.layered && this.moving.length > 0 && now - this.staticChangedAt >= SETTLING_TIME_MS;
    if (layered) this.drawLayers(now);
    else this.drawWhole(now);
    return true;
  }

  /** Number of captures of the backdrop, for tests. */
  get captures(): number {
    return this.backdrop.captures;
  }

  private drawWhole(now: number): void {
    this.backdrop.invalidate();
    this.patch.hide();
    this.canvas.classList.remove("empty");
    this.setResolution(this.detail.whole);
    this.camera.layers.enable(STATIC_LAYER);
    this.camera.layers.enable(MOVING_LAYER);
    this.renderer.render(this.scene, this.camera);
    this.staticDrawnAt = now;
    this.slowlyChanged = false;
  }

  private drawLayers(now: number): void {
    if (!this.backdrop.valid) {
      this.setResolution(this.detail.backdrop);
      this.camera.layers.set(STATIC_LAYER);
      this.renderer.render(this.scene, this.camera);
      this.backdrop.capture(this.canvas);
      this.renderer.clear();
      this.canvas.classList.add("empty");
      this.staticDrawnAt = now;
    }
    this.patch.draw(this.moving, this.camera, this.size, this.detail.moving, this.screen);
  }

  /** Project a point to the canvas [CSS px]. */
  project(point: Vector3): { x: number; y: number } {
    const p = point.clone().project(this.camera);
    return { x: ((p.x + 1) / 2) * this.size.width, y: ((1 - p.y) / 2) * this.size.height };
  }

  /** Ray from the camera through a position on the canvas [CSS px]. */
  ray(x: number, y: number): Ray {
    const far = new Vector3((x / this.size.width) * 2 - 1, 1 - (y / this.size.height) * 2, 0.5);
    far.unproject(this.camera);
    return { from: this.camera.position.clone(), along: far.sub(this.camera.position).normalize() };
  }

  /** Set the position of the optical axis on the canvas [CSS px]; null: its centre. */
  set centre(centre: { x: number; y: number } | null) {
    this.opticalCentre = centre;
    this.resize();
  }

  /** Camera distance at which a sphere of `radius` has a radius of `pixels` on the canvas. */
  fit(radius: number, pixels: number): number {
    const angle = Math.atan((2 * pixels * Math.tan((this.camera.fov * Math.PI) / 360)) / this.size.height);
    return radius / Math.sin(angle);
  }

  /** Pixels per millimetre at `distance` from the camera. */
  scale(distance: number): number {
    return this.size.height / (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360));
  }

  /** Draw with at most `resolution` device pixels per CSS pixel. */
  private setResolution(resolution: number): void {
    const ratio = Math.min(devicePixelRatio, resolution);
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
    if (this.opticalCentre) this.camera.setViewOffset(width, height, width / 2 - this.opticalCentre.x, height / 2 - this.opticalCentre.y, width, height);
    else this.camera.clearViewOffset();
    this.camera.updateProjectionMatrix();
    this.touch();
  }

  private applyTheme(): void {
    this.sky.groundColor = new Color(css("--ground"));
    this.touch();
  }
}
