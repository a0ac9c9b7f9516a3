// Plan view of the dome, +x to the right: distance from the centre is proportional to the angle from the top.

import type { Pen, SetPoint } from "./connection";

export interface Plan {
  limit: number;
  places: SetPoint[];
  /** number of the prompted set-point; known to experimenters only */
  prompted?: number;
  /** hand goal [deg], if the pen is steered from this page */
  handGoal?: { x: number; y: number } | undefined;
  pen: Pen | null;
}

const RIM_RADIUS = 0.9; // relative to half the canvas
const TAU = 2 * Math.PI;
const ARROW_LENGTH_PER_N = 0.45; // relative to half the canvas
const MAX_ARROW_LENGTH = 0.6;
const MIN_ARROW_FORCE_N = 0.02;

/** Canvas position, right and down relative to half its size, of angle `theta` from the top at azimuth `phi` [deg]. */
export function toCanvas(theta: number, phi: number, limit: number): [number, number] {
  const r = (RIM_RADIUS * theta) / limit;
  return [r * Math.cos((phi * Math.PI) / 180), -r * Math.sin((phi * Math.PI) / 180)];
}

/** Angles [deg] at a point of the canvas [px from its upper left corner]. */
export function fromCanvas(canvas: HTMLCanvasElement, px: number, py: number, limit: number): { x: number; y: number } {
  const half = canvas.clientWidth / 2;
  return { x: ((px - half) / half / RIM_RADIUS) * limit, y: (-(py - half) / half / RIM_RADIUS) * limit };
}

export function drawPlan(canvas: HTMLCanvasElement, plan: Plan): void {
  const size = canvas.clientWidth;
  if (!size) return;
  const dots = Math.round(size * devicePixelRatio);
  if (canvas.width !== dots) canvas.width = canvas.height = dots;
  const style = getComputedStyle(canvas);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const c = canvas.getContext("2d")!;
  const half = size / 2;
  c.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, half * devicePixelRatio, half * devicePixelRatio);
  c.clearRect(-half, -half, size, size);
  const rim = RIM_RADIUS * half;
  const scale = rim / plan.limit;
  c.beginPath();
  c.arc(0, 0, rim, 0, TAU);
  c.fillStyle = colour("--panel");
  c.fill();
  c.lineWidth = 1.5;
  c.strokeStyle = colour("--base");
  c.stroke();
  c.strokeStyle = colour("--line");
  c.lineWidth = 1;
  for (const theta of new Set(plan.places.map((place) => place.theta))) {
    c.beginPath();
    c.arc(0, 0, theta * scale, 0, TAU);
    c.stroke();
  }
  for (const place of plan.places) {
    const [x, y] = toCanvas(place.theta, place.phi, plan.limit);
    c.beginPath();
    c.arc(x * half, y * half, 3, 0, TAU);
    c.fillStyle = colour("--base");
    c.fill();
    if (place.number === plan.prompted) {
      c.beginPath();
      c.arc(x * half, y * half, 13, 0, TAU);
      c.lineWidth = 3;
      c.strokeStyle = colour("--accent");
      c.stroke();
    }
  }
  if (plan.handGoal) {
    c.beginPath();
    c.arc(plan.handGoal.x * scale, -plan.handGoal.y * scale, 13, 0, TAU);
    c.setLineDash([3, 3]);
    c.lineWidth = 1.5;
    c.strokeStyle = colour("--goal");
    c.stroke();
    c.setLineDash([]);
  }
  if (plan.pen) {
    const x = plan.pen.x * scale;
    const y = -plan.pen.y * scale;
    if (plan.pen.fx !== undefined && plan.pen.fy !== undefined) arrow(c, x, y, plan.pen.fx, plan.pen.fy, half, colour("--delivered"));
    c.beginPath();
    c.arc(x, y, 7, 0, TAU);
    c.fillStyle = colour(plan.pen.off ? "--muted" : "--text");
    c.fill();
    c.lineWidth = 2;
    c.strokeStyle = colour("--panel");
    c.stroke();
  }
}

function arrow(c: CanvasRenderingContext2D, x: number, y: number, fx: number, fy: number, half: number, colour: string): void {
  const size = Math.hypot(fx, fy);
  if (size < MIN_ARROW_FORCE_N) return;
  const long = Math.min(size * ARROW_LENGTH_PER_N, MAX_ARROW_LENGTH) * half;
  const [ex, ey] = [x + (fx / size) * long, y - (fy / size) * long];
  const turn = Math.atan2(ey - y, ex - x);
  c.strokeStyle = c.fillStyle = colour;
  c.lineWidth = 4;
  c.beginPath();
  c.moveTo(x, y);
  c.lineTo(ex, ey);
  c.stroke();
  c.beginPath();
  for (const [r, a] of [[9, 0], [8, 2.4], [8, -2.4]] as const) c.lineTo(ex + r * Math.cos(turn + a), ey + r * Math.sin(turn + a));
  c.fill();
}

/** Force as text, because the force of a simulated device cannot be felt. */
export function describeForce(pen: Pen | null): string {
  if (!pen) return "the tool's position is unknown";
  if (pen.off) return "coils off";
  if (pen.out === undefined) return "";
  const aside = Math.hypot(pen.fx ?? 0, pen.fy ?? 0);
  return `${pen.out < 0 ? "pulls inward" : "pushes outward"} ${Math.abs(pen.out).toFixed(2)} N, sideways ${aside.toFixed(2)} N`;
}
