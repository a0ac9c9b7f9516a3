// The drawing surface: camera, light, and a renderer that draws only when something changed and coarser when it is slow.

import {
  Color,
  DirectionalLight,
  HemisphereLight,
  PerspectiveCamera,
  Scene,
  Vector3,
  WebGLRenderer,
} from "three";
import { css, onThemeChange } from "../theme";

const SLOW = 30; // ms a frame may take before the picture gets coarser
const QUICK = 12; // ms below which it gets finer again

/** Whether pictures are computed by the processor. */
function computed(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = String(info ? gl!.getParameter(info.UNMASKED_RENDERER_WEBGL) : "");
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 10, 2000);
  private readonly renderer: WebGLRenderer;
  private readonly sky = new HemisphereLight(0xffffff, 0x8890a0, 2.2);
  private readonly sun = new DirectionalLight(0xffffff, 2.0);
  private dirty = true;
  private readonly finest: number;
  private readonly coarsest: number;
  private ratio: number;
  private pace = 16;
  private last = 0;
  private settled = 0;

  constructor(readonly canvas: HTMLCanvasElement) {
    // Without a graphics processor smooth edges cost four times the picture: quick comes first.
    const slow = computed() && !new URLSearchParams(location.search).has("fine");
    this.renderer = new WebGLRenderer({ canvas, antialias: !slow, alpha: true });
    this.finest = slow ? 1 : Math.min(devicePixelRatio, 2);
    this.ratio = this.finest;
    this.coarsest = slow ? 0.5 : 0.75;
    this.camera.up.set(0, 0, 1);
    this.sun.position.set(-60, -80, 160);
    this.scene.add(this.sky, this.sun);
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement!);
    onThemeChange(() => this.dress());
    this.dress();
    this.resize();
  }

  /** Something changed: draw at the next frame. */
  touch(): void {
    this.dirty = true;
  }

  /** Draw if needed; true if it did. */
  draw(now: number): boolean {
    if (!this.dirty) return false;
    this.dirty = false;
    this.adapt(now);
    this.renderer.render(this.scene, this.camera);
    return true;
  }

  /** Where a point in space is on the canvas [CSS px]. */
  project(point: Vector3): { x: number; y: number } {
    const p = point.clone().project(this.camera);
    return { x: ((p.x + 1) / 2) * this.canvas.clientWidth, y: ((1 - p.y) / 2) * this.canvas.clientHeight };
  }

  /** From the camera through a place on the canvas: origin and unit direction. */
  ray(x: number, y: number): { from: Vector3; along: Vector3 } {
    const far = new Vector3((x / this.canvas.clientWidth) * 2 - 1, 1 - (y / this.canvas.clientHeight) * 2, 0.5);
    far.unproject(this.camera);
    return { from: this.camera.position.clone(), along: far.sub(this.camera.position).normalize() };
  }

  /** Pixels per millimetre at `distance` from the camera. */
  scale(distance: number): number {
    return this.canvas.clientHeight / (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360));
  }

  private adapt(now: number): void {
    const spent = now - this.last;
    this.last = now;
    if (spent > 500) return; // nothing was drawn for a while: says nothing about speed
    this.pace += 0.1 * (spent - this.pace);
    if (now - this.settled < 1500) return;
    if (this.pace > SLOW && this.ratio > this.coarsest) this.ratio = Math.max(this.coarsest, this.ratio * 0.8);
    else if (this.pace < QUICK && this.ratio < this.finest) this.ratio = Math.min(this.finest, this.ratio * 1.25);
    else return;
    this.settled = now;
    this.resize();
  }

  private resize(): void {
    const frame = this.canvas.parentElement!;
    const width = Math.max(1, frame.clientWidth);
    const height = Math.max(1, frame.clientHeight);
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  private dress(): void {
    this.sky.groundColor = new Color(css("--ground"));
    this.dirty = true;
  }
}
