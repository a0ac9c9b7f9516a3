// A spherical motor: stator with its coils coloured by current, and the rotor around it with magnets and handle.

import {
  CanvasTexture,
  CircleGeometry,
  Color,
  CylinderGeometry,
  DoubleSide,
  Group,
  InstancedMesh,
  LatheGeometry,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  MeshPhongMaterial,
  Quaternion,
  SphereGeometry,
  SRGBColorSpace,
  TorusGeometry,
  Vector2,
  Vector3,
  type BufferGeometry,
  type Material,
} from "three";
import type { MotorScene } from "../session";
import { css, mapped, onThemeChange } from "../theme";

const MM = 1000;
const UP = new Vector3(0, 0, 1);
const GRIP = 13; // mm, radius of the handle's ball: for the eye

export class Rotor {
  readonly group = new Group();
  readonly stator = new Group();
  private readonly coils: InstancedMesh;
  private readonly frame = new MeshLambertMaterial();
  private readonly grip = new MeshPhongMaterial({ specular: "#556", shininess: 40 });
  private readonly base = new MeshLambertMaterial();
  private readonly poles: { mesh: InstancedMesh<BufferGeometry, MeshPhongMaterial>; north: boolean }[] = [];
  private readonly colour = new Color();
  private last: ArrayLike<number> = [];

  constructor(
    private readonly mover: MotorScene,
    /** current at full colour [A] */
    readonly range: number,
    changed: () => void,
  ) {
    this.coils = this.wound();
    this.stator.add(this.coils, this.foot());
    this.magnets();
    this.shell();
    const dress = (): void => {
      this.frame.color.set(css("--base"));
      this.grip.color.set(css("--pen"));
      this.base.color.set(css("--base"));
      for (const { mesh, north } of this.poles) mesh.material.color.set(css(north ? "--north" : "--south"));
      this.glow(this.last);
      changed();
    };
    onThemeChange(dress);
    dress();
  }

  /** Coils take the colour of their current: one channel drives several, some the other way round. */
  glow(currents: ArrayLike<number>): void {
    this.last = Array.from(currents);
    this.mover.stator.groups.forEach((row, k) => {
      let current = 0;
      row.forEach((sign, channel) => (current += sign * (currents[channel] ?? 0)));
      const [r, g, b] = mapped((current || 0) / this.range);
      this.coils.setColorAt(k, this.colour.setRGB(r / 255, g / 255, b / 255, SRGBColorSpace));
    });
    if (this.coils.instanceColor) this.coils.instanceColor.needsUpdate = true;
  }

  /** Quaternion R_SR. */
  turn(q: readonly number[]): void {
    this.group.visible = Number.isFinite(q[0]!);
    this.group.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    this.group.updateMatrixWorld();
  }

  /** Foot and middle of the handle's ball, in millimetres. */
  ends(): [Vector3, Vector3] {
    return [new Vector3(0, 0, this.radius), new Vector3(0, 0, this.mover.handle_length * MM)].map((point) =>
      this.group.localToWorld(point),
    ) as [Vector3, Vector3];
  }

  private get radius(): number {
    return (this.mover.magnets.distance + this.mover.magnets.length / 2) * MM;
  }

  private wound(): InstancedMesh {
    const { directions, distance, outer_radius, inner_radius, length } = this.mover.stator;
    const [outer, inner, half] = [outer_radius * MM, inner_radius * MM, (length * MM) / 2];
    const profile = [
      [inner, -half],
      [outer, -half],
      [outer, half],
      [inner, half],
      [inner, -half],
    ].map(([x, y]) => new Vector2(x, y));
    const winding = new LatheGeometry(profile, 28).rotateX(Math.PI / 2);
    const material = new MeshLambertMaterial({ side: DoubleSide, flatShading: true });
    return placed(winding, material, directions, distance * MM);
  }

  private magnets(): void {
    const { directions, polarity, distance, radius, length } = this.mover.magnets;
    for (const north of [true, false]) {
      const some = directions.filter((_, i) => polarity[i]! > 0 === north);
      // A clear disc in a firm rim: what it hides, the coils, is what one wants to see.
      const rim = new MeshPhongMaterial({ specular: "#445", shininess: 30, side: DoubleSide });
      const wall = new CylinderGeometry(radius * MM, radius * MM, length * MM, 32, 1, true).rotateX(Math.PI / 2);
      const mesh = placed(wall, rim, some, distance * MM);
      this.poles.push({ mesh, north });
      const face = new MeshBasicMaterial({ map: letter(north), transparent: true, depthWrite: false });
      const letters = placed(new CircleGeometry(radius * MM, 32), face, some, this.radius, true);
      letters.renderOrder = 2;
      this.group.add(mesh, letters);
    }
  }

  private shell(): void {
    const { distance, radius, length, directions } = this.mover.magnets;
    const far = (distance + length / 2) * MM + 1;
    const top = Math.max(...directions.map((d) => Math.asin(d[2]))) + Math.asin(radius / distance) + 0.06;
    const band = (latitude: number, thick: number): Mesh => {
      const ring = new Mesh(new TorusGeometry(far * Math.cos(latitude), thick, 10, 96), this.frame);
      ring.position.z = far * Math.sin(latitude);
      return ring;
    };
    this.group.add(band(top, 2.6), band(-top, 2.6));
    for (let k = 0; k < 4; k++) {
      const rib = new Mesh(new TorusGeometry(far, 2.2, 8, 40, Math.PI / 2 - top), this.frame);
      rib.rotation.set(Math.PI / 2, 0, 0);
      rib.rotateOnWorldAxis(new Vector3(0, 1, 0), -top);
      const holder = new Group();
      holder.rotation.z = ((k + 0.5) * Math.PI) / 2;
      holder.add(rib);
      this.group.add(holder);
    }
    for (let k = 0; k < 12; k++) {
      const a = (k * Math.PI) / 6 + Math.PI / 12;
      const bar = new Mesh(new CylinderGeometry(1.2, 1.2, 2 * far * Math.sin(top), 8), this.frame);
      bar.rotation.x = Math.PI / 2;
      const reach = far * Math.cos(top);
      bar.position.set(reach * Math.cos(a), reach * Math.sin(a), 0);
      this.group.add(bar);
    }
    const end = this.mover.handle_length * MM;
    const stem = new Mesh(new CylinderGeometry(4, 5, end - far, 20), this.frame);
    stem.rotation.x = Math.PI / 2;
    stem.position.z = (far + end) / 2;
    const hub = new Mesh(new CylinderGeometry(9, 12, 5, 28), this.frame);
    hub.rotation.x = Math.PI / 2;
    hub.position.z = far;
    const ball = new Mesh(new SphereGeometry(GRIP, 32, 24), this.grip);
    ball.position.z = end;
    // A mark on the ball: without it nobody sees it spin.
    const mark = new Mesh(new TorusGeometry(GRIP, 1.1, 8, 24, Math.PI), this.frame);
    mark.rotation.set(Math.PI / 2, 0, 0);
    mark.position.z = end;
    this.group.add(stem, hub, ball, mark);
  }

  /** Core, column and plate. */
  private foot(): Group {
    const { distance, length } = this.mover.stator;
    const group = new Group();
    const inner = (distance - length / 2) * MM - 1;
    group.add(new Mesh(new SphereGeometry(inner, 40, 28), this.base));
    const profile = [
      [0, -inner],
      [20, -inner],
      [17, -inner - 14],
      [17, -inner - 44],
      [58, -inner - 50],
      [60, -inner - 56],
      [0, -inner - 56],
    ].map(([x, y]) => new Vector2(x, y));
    const stand = new Mesh(new LatheGeometry(profile.reverse(), 56).rotateX(Math.PI / 2), this.base);
    group.add(stand);
    return group;
  }
}

/** One instance per direction, its z axis outward. */
function placed<M extends Material>(
  geometry: BufferGeometry,
  material: M,
  directions: readonly (readonly [number, number, number])[],
  distance: number,
  upright = false,
): InstancedMesh<BufferGeometry, M> {
  const mesh = new InstancedMesh(geometry, material, directions.length);
  mesh.frustumCulled = false;
  const at = new Matrix4();
  directions.forEach((d, i) => {
    const out = new Vector3(...d).normalize();
    const turn = new Quaternion().setFromUnitVectors(UP, out);
    if (upright) {
      const east = new Vector3().crossVectors(UP, out).normalize();
      turn.setFromRotationMatrix(new Matrix4().makeBasis(east, new Vector3().crossVectors(out, east), out));
    }
    mesh.setMatrixAt(i, at.compose(out.multiplyScalar(distance), turn, new Vector3(1, 1, 1)));
  });
  return mesh;
}

/** A faint disc with the pole's letter. */
function letter(north: boolean): CanvasTexture {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  const paint = (): void => {
    const context = canvas.getContext("2d")!;
    context.clearRect(0, 0, 128, 128);
    context.fillStyle = css(north ? "--north" : "--south");
    context.globalAlpha = 0.16;
    context.fillRect(0, 0, 128, 128);
    context.globalAlpha = 1;
    context.font = `700 44px ${css("--font")}`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(north ? "N" : "S", 64, 66);
    texture.needsUpdate = true;
  };
  onThemeChange(paint);
  paint();
  return texture;
}
