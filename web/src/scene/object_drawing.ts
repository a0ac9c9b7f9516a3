// Drawing of the object that a motor moves: a plug in its socket, with the deflection of the hooks and contact forces.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Group,
  Mesh,
  MeshLambertMaterial,
  Vector3,
} from "three";
import type { Sample, Vector } from "../sample";
import type { ObjectScene } from "../session";
import { css, onThemeChange } from "../theme";
import { Arrow } from "./arrow";
import type { Stage } from "./stage";

/** scene units per metre, so that a plug is as large as a motor in the other view */
export const UNITS_PER_M = 5000;
const MAX_ARROW_UNITS = 45; // at the typical force of the scene
const WALL_THICKNESS_M = 2.5e-3; // of the socket, for the drawing only

interface Strip {
  mesh: Mesh<BufferGeometry, MeshLambertMaterial>;
  put(station: number, x: number, low: number, high: number, halfDepth: number): void;
}

interface Beam extends Strip {
  side: number;
}

export class ObjectDrawing {
  private readonly plug = new Group();
  private readonly socket = new Group();
  private readonly plastic = new MeshLambertMaterial({ side: DoubleSide, flatShading: true });
  private readonly metal = new MeshLambertMaterial({ side: DoubleSide, flatShading: true });
  private readonly wall = new MeshLambertMaterial({ transparent: true, opacity: 0.55, depthWrite: false });
  private readonly beams: Beam[] = [];
  private readonly arrows: Arrow[];
  private scene: ObjectScene | null = null;
  private lastText = "";
  private readonly last = new Float32Array(23);
  /** drawn deflection of the tip of each hook [m], for tests */
  bent: [number, number] = [0, 0];

  constructor(private readonly stage: Stage) {
    const touch = (): void => stage.touch();
    this.arrows = [new Arrow(true, "--delivered", 0, 6, touch), new Arrow(true, "--delivered", 0, 6, touch)];
    stage.scene.add(this.plug, this.socket, ...this.arrows.map((arrow) => arrow.mesh));
    const applyTheme = (): void => {
      this.plastic.color.set(css("--plug"));
      this.metal.color.set(css("--hook"));
      this.wall.color.set(css("--base"));
      touch();
    };
    onThemeChange(applyTheme);
    applyTheme();
    this.build(null);
  }

  /** Show or hide plug and socket; a MuJoCo scene has bodies of its own. */
  set drawn(shown: boolean) {
    if (shown) this.stage.scene.add(this.plug, this.socket);
    else this.stage.scene.remove(this.plug, this.socket);
    this.stage.touch();
  }

  /** Replace plug and socket, if they changed; null: a plug without a socket. */
  build(scene: ObjectScene | null): void {
    const text = JSON.stringify(scene);
    if (text === this.lastText) return;
    this.lastText = text;
    this.scene = scene;
    for (const group of [this.plug, this.socket]) clear(group);
    this.beams.length = 0;
    this.last.fill(NaN);
    for (const arrow of this.arrows) arrow.hide();
    if (scene) {
      this.plug.add(...this.part(scene.outline, scene.width));
      this.housing(scene);
      for (let k = 0; k < scene.hooks; k++) this.beams.push(this.beam(scene, k === 0 ? 1 : -1));
    } else {
      this.plug.add(
        ...this.part(
          [
            [0, 3e-3],
            [16e-3, 3e-3],
          ],
          6e-3,
        ),
      );
    }
    this.stage.touch();
  }

  show(sample: Sample): boolean {
    const p = sample.vector("object");
    const q = sample.quaternion("object_q");
    const contacts = sample.list("contacts");
    const scene = this.scene;
    const now = [...p.map((x) => x * 1e5), ...q.map((x) => x * 4000)];
    for (let k = 0; k < 2; k++) {
      now.push(contacts[8 * k]! * 1e6, contacts[8 * k + 1]! * 1e4);
      for (let i = 2; i < 8; i++) now.push(contacts[8 * k + i]! * (i < 5 ? 1e5 : (200 / (scene?.force ?? 10))));
    }
    if (!now.some((x, i) => Math.abs(x - this.last[i]!) > 1 || Number.isNaN(this.last[i]!) !== Number.isNaN(x))) {
      return false;
    }
    this.last.set(now);
    const known = Number.isFinite(p[0] + q[0]);
    this.plug.visible = known;
    if (known) {
      this.plug.position.set(p[0] * UNITS_PER_M, p[1] * UNITS_PER_M, p[2] * UNITS_PER_M);
      this.plug.quaternion.set(...q);
    }
    this.arrows.forEach((arrow, k) => this.contact(arrow, k, Array.from(contacts.subarray(8 * k, 8 * k + 8))));
    this.stage.touch();
    return true;
  }

  forget(): void {
    this.last.fill(NaN);
    this.plug.visible = false;
    for (const arrow of this.arrows) arrow.hide();
    this.stage.touch();
  }

  /** Drawn position of the plug [m]. */
  get place(): Vector {
    return this.plug.position.toArray().map((x) => x / UNITS_PER_M) as Vector;
  }

  private contact(arrow: Arrow, k: number, [bent, place, x, y, z, fx, fy, fz]: number[]): void {
    const beam = this.beams[k];
    if (!this.scene || !beam || !Number.isFinite(bent!)) return arrow.hide();
    this.bent[k] = this.bend(beam, bent!, place!);
    const force = new Vector3(fx, fy, fz).multiplyScalar(MAX_ARROW_UNITS / this.scene.force);
    // The arrow ends at the contact, so that it lies beside the plug, not inside.
    const tip = new Vector3(x, y, z).multiplyScalar(UNITS_PER_M);
    arrow.point(tip.sub(force), force, this.stage.camera);
  }

  /** Bend the beam by `bent` at the distance `place` from its root; returns the deflection of its tip. */
  private bend({ put, side }: Beam, bent: number, place: number): number {
    const { along, section, back, root, width, at, bends } = this.scene!;
    let k = 0;
    while (k < at.length - 2 && at[k + 1]! < place) k++;
    const [a, b] = [at[k]!, at[Math.min(k + 1, at.length - 1)]!];
    const share = b > a ? Math.min(1, Math.max(0, (place - a) / (b - a))) : 0;
    const [low, high] = [bends[k]!, bends[Math.min(k + 1, bends.length - 1)]!];
    let last = 0;
    along.forEach((s, i) => {
      const aside = (last = bent * (low[i]! * (1 - share) + high[i]! * share));
      const outer = side * (back + aside) * UNITS_PER_M;
      const inner = side * (back - section[i]! + aside) * UNITS_PER_M;
      put(i, (root + s) * UNITS_PER_M, inner, outer, (width / 2) * UNITS_PER_M);
    });
    return last;
  }

  private beam(scene: ObjectScene, side: number): Beam {
    const strip = this.strip(scene.along.length, this.metal);
    this.socket.add(strip.mesh);
    const beam = { ...strip, side };
    this.bend(beam, 0, scene.at[0]!);
    return beam;
  }

  /** Prism with a symmetric outline, and a grip at its outer end. */
  private part(outline: [number, number][], depth: number): Mesh[] {
    const z = (0.75 * depth * UNITS_PER_M) / 2;
    const { mesh, put } = this.strip(outline.length, this.plastic);
    outline.forEach(([x, y], i) => put(i, x * UNITS_PER_M, -y * UNITS_PER_M, y * UNITS_PER_M, z));
    const [end, half] = outline.at(-1)!;
    const widest = Math.max(...outline.map(([, y]) => y), half);
    const grip = new BoxGeometry(6e-3 * UNITS_PER_M, 2.9 * widest * UNITS_PER_M, 2.8 * z);
    grip.translate((end + 3e-3) * UNITS_PER_M, 0, 0);
    return [mesh, new Mesh(grip, this.plastic)];
  }

  /** Bar of rectangular cross-section with `n` stations; `put` sets a station's position, sides and half depth. */
  private strip(n: number, material: MeshLambertMaterial): Strip {
    const geometry = new BufferGeometry();
    const positions = new BufferAttribute(new Float32Array(12 * n), 3);
    geometry.setAttribute("position", positions);
    const end = 4 * (n - 1);
    const index = [0, 2, 1, 0, 3, 2, end, end + 1, end + 2, end, end + 2, end + 3];
    for (let i = 0; i < n - 1; i++) {
      for (let k = 0; k < 4; k++) {
        const [a, b] = [4 * i + k, 4 * i + ((k + 1) % 4)];
        index.push(a, b, a + 4, b, b + 4, a + 4);
      }
    }
    geometry.setIndex(index);
    const mesh = new Mesh(geometry, material);
    mesh.frustumCulled = false;
    return {
      mesh,
      put: (i, x, low, high, z) => {
        positions.setXYZ(4 * i, x, low, -z);
        positions.setXYZ(4 * i + 1, x, high, -z);
        positions.setXYZ(4 * i + 2, x, high, z);
        positions.setXYZ(4 * i + 3, x, low, z);
        positions.needsUpdate = true;
      },
    };
  }

  private housing({ root, back, section, width, floor, hooks }: ObjectScene): void {
    const plate = Math.min(root, floor);
    const box = (from: number, to: number, low: number, high: number): void => {
      if (to - from < 1e-6 || high - low < 1e-6) return;
      const geometry = new BoxGeometry((to - from) * UNITS_PER_M, (high - low) * UNITS_PER_M, 1.15 * width * UNITS_PER_M);
      geometry.translate(((from + to) / 2) * UNITS_PER_M, ((low + high) / 2) * UNITS_PER_M, 0);
      this.socket.add(new Mesh(geometry, this.wall));
    };
    const outer = back + WALL_THICKNESS_M;
    box(plate - WALL_THICKNESS_M, plate, -outer, outer);
    box(plate, floor, -(back - section[0]!) * 0.9, (back - section[0]!) * 0.9);
    for (const side of hooks === 2 ? [1, -1] : [1]) {
      const [low, high] = [side * (back - section[0]! - 0.3e-3), side * outer].sort((a, b) => a - b) as [number, number];
      box(plate, root, low, high);
    }
  }
}

function clear(group: Group): void {
  for (const child of [...group.children]) {
    if (child instanceof Mesh) (child.geometry as BufferGeometry).dispose();
    group.remove(child);
  }
}
