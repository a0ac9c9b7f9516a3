// Stator of an electromagnet under a dome: base, core, coils, field sensors, and the edge of the workspace.

import {
  BufferGeometry,
  Color,
  Float32BufferAttribute,
  Group,
  LatheGeometry,
  LineBasicMaterial,
  LineLoop,
  Mesh,
  MeshLambertMaterial,
  MeshPhongMaterial,
  RingGeometry,
  SphereGeometry,
  Vector2,
} from "three";
import type { DomeScene } from "../session";
import { css, onThemeChange } from "../theme";
import { fieldSensors, partsOf, placePart } from "./parts";

const MM_PER_M = 1000;
/** colours of a coil without current, and at its limit */
const COPPER = new Color("#a8623a");
const HOT = new Color("#ffcf5a");
const MARK_RADIUS_MM = 0.8; // of an engraved mark
const MIN_VISIBLE_CHANGE = 0.08; // of the current, relative to its limit

export class Body {
  readonly group = new Group();
  private readonly coils: MeshPhongMaterial[] = [];
  private readonly glowing: number[] = [];
  private readonly base = new MeshLambertMaterial();
  private readonly ink = new MeshLambertMaterial();
  private readonly edge = new LineBasicMaterial({ transparent: true, opacity: 0.55 });

  constructor(tool: DomeScene, changed: () => void) {
    const radius = tool.dome_radius * MM_PER_M;
    const core = new Mesh(
      new SphereGeometry(tool.core_radius * MM_PER_M, 32, 20),
      new MeshPhongMaterial({ color: "#7d8794", specular: "#667", shininess: 40 }),
    );
    this.group.add(core);
    for (const coil of partsOf(tool, "coil")) {
      const material = new MeshPhongMaterial({ color: COPPER, specular: "#442", shininess: 30 });
      // Translucent, because its size is unknown.
      if (!coil.stated) Object.assign(material, { transparent: true, opacity: 0.45 });
      this.coils.push(material);
      this.group.add(placePart(coil, material));
    }
    this.group.add(fieldSensors(tool));
    for (const mark of tool.marks ?? []) {
      const dot = new Mesh(new SphereGeometry(MARK_RADIUS_MM, 12, 8), this.ink);
      dot.position.set(...mark).multiplyScalar(MM_PER_M);
      this.group.add(dot);
    }
    this.group.add(this.foot(radius));
    if (tool.dome_wall > 0) this.group.add(this.rim(radius, radius - tool.dome_wall * MM_PER_M));
    this.group.add(this.workspace(radius * 1.004, tool.workspace));
    const applyTheme = (): void => {
      this.base.color.set(css("--base"));
      this.ink.color.set(css("--text"));
      this.edge.color.set(css("--text"));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  /** Colour the coils by current relative to the limit; returns whether a colour changed visibly. */
  glow(currents: ArrayLike<number>, limits: number[]): boolean {
    let different = false;
    this.coils.forEach((material, i) => {
      const share = Math.min(1, Math.abs(currents[i] ?? 0) / (limits[i] ?? 1)) || 0;
      material.color.lerpColors(COPPER, HOT, share);
      material.emissive.setRGB(0.55 * share, 0.25 * share, 0);
      if (Math.abs(share - (this.glowing[i] ?? 0)) < MIN_VISIBLE_CHANGE) return;
      this.glowing[i] = share;
      different = true;
    });
    return different;
  }

  /** Flat round base with a chamfered rim, just below the edge of the shell. */
  private foot(radius: number): Mesh {
    const profile = [
      [0, -0.02],
      [1.06, -0.02],
      [1.1, -0.05],
      [1.12, -0.11],
      [1.24, -0.42],
      [1.25, -0.5],
      [0, -0.5],
    ].map(([x, y]) => new Vector2(x! * radius, y! * radius));
    const geometry = new LatheGeometry(profile.reverse(), 72);
    geometry.rotateX(Math.PI / 2);
    return new Mesh(geometry, this.base);
  }

  /** Cross-section of the shell's wall at the base. */
  private rim(outer: number, inner: number): Mesh {
    return new Mesh(new RingGeometry(inner, outer, 96), this.ink);
  }

  private workspace(radius: number, halfAngle: number): LineLoop {
    const points: number[] = [];
    for (let k = 0; k < 120; k++) {
      const a = (2 * Math.PI * k) / 120;
      points.push(
        radius * Math.sin(halfAngle) * Math.cos(a),
        radius * Math.sin(halfAngle) * Math.sin(a),
        radius * Math.cos(halfAngle),
      );
    }
    return new LineLoop(
      new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points, 3)),
      this.edge,
    );
  }
}
