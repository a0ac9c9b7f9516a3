// Coils, magnets and field sensors of a device, with sizes and positions from the device file.

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

const MM_PER_M = 1000;
const UP = new Vector3(0, 0, 1);
const CHIP_SIZE_MM = 3; // package of a field sensor, for the drawing only: a device file states just its position

type Position = readonly [number, number, number];

/** Parts with this role, of stator and mover. */
export const partsOf = (scene: Scene, role: RoundPart["role"]): RoundPart[] =>
  (scene.parts ?? []).filter((part) => part.role === role);

/** Geometry of an axisymmetric part about its own z axis [mm]. */
export function roundBody({ inner_radius, outer_radius, length }: RoundPart, segments = 72): LatheGeometry {
  const [inner, outer, half] = [inner_radius * MM_PER_M, outer_radius * MM_PER_M, (length * MM_PER_M) / 2];
  // Duplicate every edge, so that normals are not smoothed across it.
  const profile = [[inner, -half], [outer, -half], [outer, -half], [outer, half], [outer, half], [inner, half]];
  if (inner > 0) profile.push([inner, half], [inner, -half]);
  return new LatheGeometry(profile.map(([x, y]) => new Vector2(x, y)), segments).rotateX(Math.PI / 2);
}

/** Mesh of `part` in its position. */
export function placePart(part: RoundPart, material: Material, segments?: number): Mesh {
  const mesh = new Mesh(roundBody(part, segments), material);
  mesh.name = part.role;
  mesh.position.set(...part.position).multiplyScalar(MM_PER_M);
  mesh.quaternion.setFromUnitVectors(UP, new Vector3(...part.axis).normalize());
  return mesh;
}

/** One instance of `geometry` per position [m], with its z axis along `axes`, or radially outward. */
export function placeEach<M extends Material>(
  geometry: BufferGeometry,
  material: M,
  places: readonly Position[],
  axes: readonly Position[] = places,
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
    mesh.setMatrixAt(i, at.compose(new Vector3(...place).multiplyScalar(MM_PER_M), turn, new Vector3(1, 1, 1)));
  });
  return mesh;
}

/** Field sensors as chips in the positions of the device file. */
export function fieldSensors(scene: Scene): InstancedMesh {
  const material = new MeshLambertMaterial();
  const applyTheme = (): void => void material.color.set(css("--sensor"));
  onThemeChange(applyTheme);
  applyTheme();
  return placeEach(new BoxGeometry(CHIP_SIZE_MM, CHIP_SIZE_MM, CHIP_SIZE_MM / 3), material, scene.sensors ?? []);
}
