// The parts of a device at their true sizes and places, as the server describes them from the device file.

import {
  BoxGeometry,
  type BufferGeometry,
  InstancedMesh,
  LatheGeometry,
  type Material,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  Quaternion,
  Vector2,
  Vector3,
} from "three";
import type { RoundPart, Scene } from "../session";
import { css, onThemeChange } from "../theme";

const MM = 1000;
const UP = new Vector3(0, 0, 1);
const CHIP = 3; // mm: a field sensor's package, of which a device file gives the place only

type Place = readonly [number, number, number];

/** The parts of one role; of the stator or of the mover. */
export const partsOf = (scene: Scene, role: RoundPart["role"]): RoundPart[] =>
  (scene.parts ?? []).filter((part) => part.role === role);

/** The body of a round part about its own z axis [mm]. */
export function roundBody({ inner_radius, outer_radius, length }: RoundPart, segments = 72): LatheGeometry {
  const [inner, outer, half] = [inner_radius * MM, outer_radius * MM, (length * MM) / 2];
  // Every edge twice, so that faces meet sharply.
  const profile = [[inner, -half], [outer, -half], [outer, -half], [outer, half], [outer, half], [inner, half]];
  if (inner > 0) profile.push([inner, half], [inner, -half]);
  return new LatheGeometry(profile.map(([x, y]) => new Vector2(x, y)), segments).rotateX(Math.PI / 2);
}

/** `part` at its place. */
export function placePart(part: RoundPart, material: Material, segments?: number): Mesh {
  const mesh = new Mesh(roundBody(part, segments), material);
  mesh.name = part.role;
  mesh.position.set(...part.position).multiplyScalar(MM);
  mesh.quaternion.setFromUnitVectors(UP, new Vector3(...part.axis).normalize());
  return mesh;
}

/** One instance of `geometry` for each place [m], its z axis along `axes`, or outward. */
export function placeEach<M extends Material>(
  geometry: BufferGeometry,
  material: M,
  places: readonly Place[],
  axes: readonly Place[] = places,
  upright = false,
): InstancedMesh<BufferGeometry, M> {
  const mesh = new InstancedMesh(geometry, material, places.length);
  mesh.frustumCulled = false;
  const at = new Matrix4();
  places.forEach((place, i) => {
    const out = new Vector3(...axes[i]!).normalize();
    const turn = new Quaternion().setFromUnitVectors(UP, out);
    if (upright) {
      const east = new Vector3().crossVectors(UP, out).normalize();
      turn.setFromRotationMatrix(new Matrix4().makeBasis(east, new Vector3().crossVectors(out, east), out));
    }
    mesh.setMatrixAt(i, at.compose(new Vector3(...place).multiplyScalar(MM), turn, new Vector3(1, 1, 1)));
  });
  return mesh;
}

/** The field sensors: chips whose places are the device file's. */
export function chips(scene: Scene): InstancedMesh {
  const material = new MeshLambertMaterial();
  const dress = (): void => void material.color.set(css("--sensor"));
  onThemeChange(dress);
  dress();
  return placeEach(new BoxGeometry(CHIP, CHIP, CHIP / 3), material, scene.sensors ?? []);
}
