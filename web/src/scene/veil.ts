// What moves is drawn over a kept picture of the dome: where the dome stands in front of it, it is seen faintly.

import { CustomBlending, Mesh, MeshBasicMaterial, SphereGeometry, SrcAlphaFactor, ZeroFactor } from "three";

const THROUGH = 0.35; // share that is seen through the shell

/** A ball of `radius` [mm] that shows nothing itself and dims what is behind it. */
export function veil(radius: number): Mesh {
  const material = new MeshBasicMaterial({
    transparent: true,
    opacity: THROUGH,
    depthWrite: false,
    blending: CustomBlending,
    blendSrc: ZeroFactor,
    blendDst: SrcAlphaFactor,
    premultipliedAlpha: true,
  });
  const ball = new Mesh(new SphereGeometry(radius, 24, 16), material);
  ball.renderOrder = 1; // after the pen, before the arrows, which lie over everything
  return ball;
}
