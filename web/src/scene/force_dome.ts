// Dome with the force map: colour is the radial force delivered at each place, with hatching where the device is at its
// limit and a line where the force changes sign. Where there is no force the shell is transparent.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DataTexture,
  LinearFilter,
  Mesh,
  ShaderMaterial,
  SRGBColorSpace,
} from "three";
import { css, mapPixels, onThemeChange } from "../theme";

const VERTEX = /* glsl */ `
  attribute float force;
  attribute float saturated;
  varying float vForce;
  varying float vSaturated;
  varying vec3 vNormal;
  varying vec3 vView;
  void main() {
    vForce = force;
    vSaturated = saturated;
    vNormal = normalize(normalMatrix * position);
    vec4 eye = modelViewMatrix * vec4(position, 1.0);
    vView = -eye.xyz;
    gl_Position = projectionMatrix * eye;
  }`;

const FRAGMENT = /* glsl */ `
  uniform sampler2D map;
  uniform vec3 ink;
  uniform float range;
  uniform float live;
  varying float vForce;
  varying float vSaturated;
  varying vec3 vNormal;
  varying vec3 vView;
  void main() {
    float x = clamp(vForce / range, -1.0, 1.0);
    vec3 colour = texture2D(map, vec2(0.5 + 0.498 * x, 0.5)).rgb;
    float strength = smoothstep(0.0, 0.30, abs(x));
    float rim = 1.0 - abs(dot(normalize(vNormal), normalize(vView)));
    float alpha = mix(0.40, 0.93, strength) + 0.35 * rim * rim;
    float steep = fwidth(vForce);
    // Contour lines at every fifth of the range, and a stronger one at zero force.
    float level = vForce / range * 5.0;
    float band = abs(fract(level - 0.5) - 0.5) / max(fwidth(level), 1e-6);
    float line = (1.0 - smoothstep(0.5, 1.5, band)) * step(0.5, abs(level)) * 0.28;
    if (steep > 2e-4 * range) line = max(line, (1.0 - smoothstep(0.8, 2.0, abs(vForce) / steep)) * 0.8);
    float stripe = step(0.62, fract((gl_FragCoord.x + gl_FragCoord.y) / 11.0));
    line = max(line, 0.55 * stripe * smoothstep(0.4, 0.6, vSaturated));
    float light = 0.86 + 0.20 * normalize(vNormal).y - 0.30 * rim * rim;
    colour = mix(colour * light, ink, line);
    colour = mix(vec3(dot(colour, vec3(0.3, 0.6, 0.1))), colour, live);
    gl_FragColor = vec4(colour, max(alpha, line) * mix(0.6, 1.0, live));
  }`;

export class ForceDome {
  readonly mesh: Mesh<BufferGeometry, ShaderMaterial>;
  /** force at full colour [N] */
  range = 0.5;
  /** the map has no force and no limit anywhere */
  blank = false;
  force: Float32Array = new Float32Array();
  saturated: Uint8Array = new Uint8Array();
  private directions: Float32Array = new Float32Array();
  private readonly map = new DataTexture(mapPixels(), 256, 1);

  constructor(
    private readonly radius: number,
    private readonly changed: () => void,
  ) {
    this.map.minFilter = this.map.magFilter = LinearFilter;
    this.map.needsUpdate = true;
    const material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      transparent: true,
      uniforms: {
        map: { value: this.map },
        ink: { value: new Color() },
        range: { value: this.range },
        live: { value: 1 },
      },
    });
    this.mesh = new Mesh(new BufferGeometry(), material);
    this.mesh.visible = false;
    onThemeChange(() => this.applyTheme());
    this.applyTheme();
  }

  /** Set the mesh of the dome. */
  shape(directions: Float32Array, triangles: Uint32Array): void {
    this.directions = directions;
    const { geometry } = this.mesh;
    geometry.setAttribute("position", new BufferAttribute(directions.map((x) => x * this.radius), 3));
    geometry.setAttribute("force", new BufferAttribute(new Float32Array(directions.length / 3), 1));
    geometry.setAttribute("saturated", new BufferAttribute(new Float32Array(directions.length / 3), 1));
    geometry.setIndex(new BufferAttribute(triangles, 1));
    this.mesh.frustumCulled = false;
    this.mesh.visible = true; // transparent until the map arrives
    this.changed();
  }

  paint(force: Float32Array, saturated: Uint8Array): void {
    this.force = force;
    this.saturated = saturated;
    let largest = 0;
    for (const f of force) largest = Math.max(largest, Math.abs(f));
    this.range = roundUp(Math.max(largest, 0.05));
    this.blank = largest < 1e-4 && !saturated.some(Boolean); // 0.1 mN: rounding errors
    const { geometry, material } = this.mesh;
    (geometry.getAttribute("force") as BufferAttribute).copyArray(force).needsUpdate = true;
    (geometry.getAttribute("saturated") as BufferAttribute).copyArray(saturated).needsUpdate = true;
    material.uniforms["range"]!.value = this.range;
    this.changed();
  }

  /** Draw in grey while the page is not live. */
  live(yes: boolean): void {
    this.mesh.material.uniforms["live"]!.value = yes ? 1 : 0;
    this.changed();
  }

  /** Force and limit at the vertex nearest to `direction`. */
  at(direction: readonly number[]): { force: number; saturated: boolean } {
    let best = -2;
    let vertex = 0;
    const [x, y, z] = direction as [number, number, number];
    for (let i = 0; i < this.force.length; i++) {
      const d = this.directions[3 * i]! * x + this.directions[3 * i + 1]! * y + this.directions[3 * i + 2]! * z;
      if (d > best) [best, vertex] = [d, i];
    }
    return { force: this.force[vertex] ?? NaN, saturated: this.saturated[vertex] === 1 };
  }

  private applyTheme(): void {
    this.map.image.data = mapPixels();
    this.map.needsUpdate = true;
    (this.mesh.material.uniforms["ink"]!.value as Color).setStyle(css("--map-ink"), SRGBColorSpace).convertLinearToSRGB();
    this.changed();
  }
}

/** Round up to a convenient full scale: a preferred number times a power of ten. */
export function roundUp(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  for (const step of [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8]) if (step * power >= value * 0.999) return step * power;
  return 10 * power;
}
