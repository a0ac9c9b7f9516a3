// Rotor angles (ψ, λ, φ) [rad] with R = Rx(ψ) Ry(λ) Rz(φ), as in the modes of a motor; quaternions are (x, y, z, w).

import type { Vector } from "../sample";

export type Quaternion = [number, number, number, number];

/** Quaternion from the angles (ψ, λ, φ). */
export function quaternionOf([psi, lambda, phi]: Vector): Quaternion {
  const [a, b, c] = [Math.sin(psi / 2), Math.sin(lambda / 2), Math.sin(phi / 2)];
  const [u, v, w] = [Math.cos(psi / 2), Math.cos(lambda / 2), Math.cos(phi / 2)];
  return [a * v * w + u * b * c, u * b * w - a * v * c, u * v * c + a * b * w, u * v * w - a * b * c];
}

/** Angles (ψ, λ, φ) from a quaternion. */
export function angles([x, y, z, w]: Quaternion): Vector {
  const r02 = 2 * (x * z + y * w);
  const r12 = 2 * (y * z - x * w);
  const r22 = 1 - 2 * (x * x + y * y);
  const r01 = 2 * (x * y - z * w);
  const r00 = 1 - 2 * (y * y + z * z);
  return [Math.atan2(-r12, r22), Math.asin(Math.min(1, Math.max(-1, r02))), Math.atan2(-r01, r00)];
}

/** Direction of the mover's z axis. */
export function axis([x, y, z, w]: Quaternion): Vector {
  return [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)];
}
