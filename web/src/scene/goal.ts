// Where the hand wants the tool: a faint ring, and a thread from the tool to it. The gap is what one feels.

import {
  BufferAttribute,
  BufferGeometry,
  Group,
  Line,
  LineDashedMaterial,
  Mesh,
  MeshBasicMaterial,
  TorusGeometry,
  Vector3,
} from "three";
import { css, onThemeChange } from "../theme";

const MM = 1000;

export class Goal {
  readonly group = new Group();
  private readonly ring: Mesh<TorusGeometry, MeshBasicMaterial>;
  private readonly thread: Line<BufferGeometry, LineDashedMaterial>;
  private readonly up = new Vector3(0, 0, 1);

  constructor(changed: () => void) {
    this.ring = new Mesh(
      new TorusGeometry(9.5, 0.45, 5, 48),
      new MeshBasicMaterial({ transparent: true, opacity: 0.6, depthTest: false }),
    );
    this.ring.renderOrder = 4;
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
    this.thread = new Line(
      geometry,
      new LineDashedMaterial({ transparent: true, opacity: 0.8, dashSize: 1.2, gapSize: 0.8, depthTest: false }),
    );
    this.thread.renderOrder = 4;
    this.thread.frustumCulled = false;
    this.group.add(this.ring, this.thread);
    this.group.visible = false;
    const dress = (): void => {
      this.ring.material.color.set(css("--goal"));
      this.thread.material.color.set(css("--goal"));
      changed();
    };
    onThemeChange(dress);
    dress();
  }

  /** Goal and tool in metres; the ring lies across the radius, or is `level`. */
  move(goal: readonly number[], tool: readonly number[], level = false): void {
    this.group.visible = Number.isFinite(goal[0]! + tool[0]!);
    if (!this.group.visible) return;
    this.ring.position.set(goal[0]! * MM, goal[1]! * MM, goal[2]! * MM);
    this.ring.quaternion.setFromUnitVectors(this.up, level ? this.up : this.ring.position.clone().normalize());
    const ends = this.thread.geometry.getAttribute("position") as BufferAttribute;
    ends.setXYZ(0, goal[0]! * MM, goal[1]! * MM, goal[2]! * MM);
    ends.setXYZ(1, tool[0]! * MM, tool[1]! * MM, tool[2]! * MM);
    ends.needsUpdate = true;
    this.thread.geometry.computeBoundingBox();
    this.thread.computeLineDistances();
  }
}
