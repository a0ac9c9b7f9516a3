// Mesh of the tool: tip towards −z, ring magnet about the origin, and the body of a stylus or a finger in a thimble.

import { Group, LatheGeometry, Mesh, MeshLambertMaterial, MeshPhongMaterial, Vector2, Vector3 } from "three";
import type { DomeScene } from "../session";
import { css, onThemeChange } from "../theme";

const MM_PER_M = 1000;
const STYLUS_LENGTH_MM = 64; // beyond the magnet; shorter than a real one, to leave room in the view
const FINGER_LENGTH_MM = 34; // beyond the magnet
const FINGER_RADIUS_MM = 8;

export class Stylus {
  readonly group = new Group();
  private readonly tip: Vector3;
  private readonly end: Vector3;
  private readonly pen = new MeshLambertMaterial();

  constructor(tool: DomeScene, changed: () => void) {
    const { worn, outer_radius, length, tip_distance } = tool.magnet;
    this.end = new Vector3(0, 0, worn ? FINGER_LENGTH_MM : STYLUS_LENGTH_MM);
    const r = outer_radius * MM_PER_M;
    const half = (length * MM_PER_M) / 2;
    this.tip = new Vector3(0, 0, -tip_distance * MM_PER_M);
    const body = r + 0.5;
    const pen = this.lathe(
      worn ? this.finger(body, half) : [
        [0, this.tip.z],
        [0.9, this.tip.z + 0.25],
        [1.3, this.tip.z + 1.2],
        [body * 0.93, -half - 0.6],
        [body, -half],
        [body, half + 1],
        [body * 0.9, half + 3],
        [body * 0.78, STYLUS_LENGTH_MM - 12],
        [body * 0.7, STYLUS_LENGTH_MM - 1],
        [body * 0.5, STYLUS_LENGTH_MM],
        [0, STYLUS_LENGTH_MM],
      ],
      this.pen,
    );
    const metal = new MeshPhongMaterial({ color: "#8c97a6", specular: "#8899aa", shininess: 60 });
    const magnet = this.lathe(
      [
        [body + 0.06, -half + 1],
        [body + 0.45, -half + 1.6],
        [body + 0.45, half - 1.6],
        [body + 0.06, half - 1],
      ],
      metal,
    );
    this.group.add(pen, magnet);
    const applyTheme = (): void => {
      this.pen.color.set(css("--pen"));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
    this.group.visible = false;
  }

  /** Set position [m] and quaternion R_SR. */
  move(p: readonly number[], q: readonly number[]): void {
    this.group.visible = Number.isFinite(p[0]! + q[0]!);
    this.group.position.set(p[0]! * MM_PER_M, p[1]! * MM_PER_M, p[2]! * MM_PER_M);
    this.group.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    this.group.updateMatrixWorld();
  }

  /** Tip and far end [mm]. */
  ends(): [Vector3, Vector3] {
    return [this.group.localToWorld(this.tip.clone()), this.group.localToWorld(this.end.clone())];
  }

  /** Profile of a thimble around the magnet, and of the finger in it. */
  private finger(body: number, half: number): [number, number][] {
    const wide = Math.max(FINGER_RADIUS_MM, body);
    return [
      [0, this.tip.z],
      [body * 0.7, this.tip.z + 0.6],
      [body, -half],
      [body, half + 1],
      [wide, half + 4],
      [wide, FINGER_LENGTH_MM - 6],
      [wide * 0.8, FINGER_LENGTH_MM - 2],
      [0, FINGER_LENGTH_MM],
    ];
  }

  private lathe(profile: [number, number][], material: MeshLambertMaterial | MeshPhongMaterial): Mesh {
    const geometry = new LatheGeometry(
      profile.map(([x, y]) => new Vector2(x, y)),
      36,
    );
    geometry.rotateX(Math.PI / 2);
    return new Mesh(geometry, material);
  }
}
