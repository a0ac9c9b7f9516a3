// Meshes of a spherical motor: stator with coils coloured by current, and rotor with magnets and handle.

import {
  CanvasTexture,
  CircleGeometry,
  Color,
  CylinderGeometry,
  DoubleSide,
  Group,
  InstancedMesh,
  LatheGeometry,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  MeshPhongMaterial,
  SphereGeometry,
  SRGBColorSpace,
  TorusGeometry,
  Vector2,
  Vector3,
  type BufferGeometry,
} from "three";
import type { MotorScene, RoundPart } from "../session";
import { css, mapColour, onThemeChange } from "../theme";
import { fieldSensors, partsOf, placeEach, placePart, roundBody } from "./parts";

const MM_PER_M = 1000;
const GRIP_RADIUS_MM = 13; // ball of the handle, for the drawing only

export class Rotor {
  readonly group = new Group();
  readonly stator = new Group();
  private readonly coils: InstancedMesh;
  private readonly frame = new MeshLambertMaterial();
  private readonly grip = new MeshPhongMaterial({ specular: "#556", shininess: 40 });
  private readonly base = new MeshLambertMaterial();
  private readonly steel = new MeshPhongMaterial({ color: "#8c97a6", specular: "#8899aa", shininess: 60 });
  private readonly poles: { mesh: InstancedMesh<BufferGeometry, MeshPhongMaterial>; north: boolean }[] = [];
  private readonly colour = new Color();
  private last: ArrayLike<number> = [];
  private readonly magnet: RoundPart;
  private readonly coil: RoundPart;

  constructor(
    private readonly mover: MotorScene,
    /** current at full colour [A] */
    readonly range: number,
    changed: () => void,
  ) {
    const coils = partsOf(mover, "coil");
    const magnets = partsOf(mover, "magnet");
    // All have the same size and distance from the centre.
    [this.coil, this.magnet] = [coils[0]!, magnets[0]!];
    this.coils = this.makeCoils(coils);
    this.stator.add(this.coils, this.foot(), fieldSensors(mover));
    this.magnets(magnets);
    for (const ring of partsOf(mover, "ring")) (ring.moves ? this.group : this.stator).add(placePart(ring, this.steel));
    this.shell();
    const applyTheme = (): void => {
      this.frame.color.set(css("--base"));
      this.grip.color.set(css("--pen"));
      this.base.color.set(css("--base"));
      for (const { mesh, north } of this.poles) mesh.material.color.set(css(north ? "--north" : "--south"));
      this.glow(this.last);
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  /** Colour the coils by current; a channel drives several coils, some with reversed polarity. */
  glow(currents: ArrayLike<number>): void {
    this.last = Array.from(currents);
    this.mover.groups.forEach((row, k) => {
      let current = 0;
      row.forEach((sign, channel) => (current += sign * (currents[channel] ?? 0)));
      const [r, g, b] = mapColour((current || 0) / this.range);
      this.coils.setColorAt(k, this.colour.setRGB(r / 255, g / 255, b / 255, SRGBColorSpace));
    });
    if (this.coils.instanceColor) this.coils.instanceColor.needsUpdate = true;
  }

  /** Set the orientation: quaternion R_SR. */
  turn(q: readonly number[]): void {
    this.group.visible = Number.isFinite(q[0]!);
    this.group.quaternion.set(q[0]!, q[1]!, q[2]!, q[3]!);
    this.group.updateMatrixWorld();
  }

  /** Base of the handle and centre of its ball [mm]. */
  ends(): [Vector3, Vector3] {
    return [new Vector3(0, 0, this.radius), new Vector3(0, 0, this.mover.handle_length * MM_PER_M)].map((point) =>
      this.group.localToWorld(point),
    ) as [Vector3, Vector3];
  }

  private get radius(): number {
    return (distanceOf(this.magnet) + this.magnet.length / 2) * MM_PER_M;
  }

  private makeCoils(coils: readonly RoundPart[]): InstancedMesh {
    const material = new MeshLambertMaterial({ side: DoubleSide, flatShading: true });
    return placeEach(roundBody(this.coil, 28), material, coils.map((coil) => coil.position), coils.map((coil) => coil.axis));
  }

  private magnets(magnets: readonly RoundPart[]): void {
    const { outer_radius: radius, length } = this.magnet;
    for (const north of [true, false]) {
      const some = magnets.filter((magnet) => magnet.polarity > 0 === north);
      const axes = some.map((magnet) => magnet.axis);
      // A transparent disc with a solid rim, so that the coils behind it stay visible.
      const rim = new MeshPhongMaterial({ specular: "#445", shininess: 30, side: DoubleSide });
      const wall = new CylinderGeometry(radius * MM_PER_M, radius * MM_PER_M, length * MM_PER_M, 32, 1, true).rotateX(Math.PI / 2);
      const mesh = placeEach(wall, rim, some.map((magnet) => magnet.position), axes);
      this.poles.push({ mesh, north });
      const face = new MeshBasicMaterial({ map: poleTexture(north), transparent: true, depthWrite: false });
      const letters = placeEach(new CircleGeometry(radius * MM_PER_M, 32), face, some.map((magnet) => this.face(magnet)), axes, true);
      letters.renderOrder = 2;
      this.group.add(mesh, letters);
    }
  }

  /** Centre of a magnet's outer face [m]. */
  private face({ position, axis, length }: RoundPart): [number, number, number] {
    return position.map((x, i) => x + (axis[i]! * length) / 2) as [number, number, number];
  }

  private shell(): void {
    const { outer_radius } = this.magnet;
    const far = this.radius + 1;
    const highest = Math.max(...partsOf(this.mover, "magnet").map(({ axis }) => Math.asin(axis[2])));
    const top = highest + Math.asin(outer_radius / distanceOf(this.magnet)) + 0.06;
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
    const end = this.mover.handle_length * MM_PER_M;
    const stem = new Mesh(new CylinderGeometry(4, 5, end - far, 20), this.frame);
    stem.rotation.x = Math.PI / 2;
    stem.position.z = (far + end) / 2;
    const hub = new Mesh(new CylinderGeometry(9, 12, 5, 28), this.frame);
    hub.rotation.x = Math.PI / 2;
    hub.position.z = far;
    const ball = new Mesh(new SphereGeometry(GRIP_RADIUS_MM, 32, 24), this.grip);
    ball.position.z = end;
    // A mark on the ball makes its spin visible.
    const mark = new Mesh(new TorusGeometry(GRIP_RADIUS_MM, 1.1, 8, 24, Math.PI), this.frame);
    mark.rotation.set(Math.PI / 2, 0, 0);
    mark.position.z = end;
    this.group.add(stem, hub, ball, mark);
  }

  /** Core, column and plate. */
  private foot(): Group {
    const group = new Group();
    const inner = (distanceOf(this.coil) - this.coil.length / 2) * MM_PER_M - 1;
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

/** Distance from the motor's centre [m]. */
const distanceOf = ({ position }: RoundPart): number => Math.hypot(...position);

/** Texture of a faint disc with the letter of the pole. */
function poleTexture(north: boolean): CanvasTexture {
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
