// Marker of the hand goal: a faint ring, and a dashed line from the mover to it, whose length shows the deviation.

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

const MM_PER_M = 1000;

export class HandGoalMarker {
  readonly group = new Group();
  private readonly ring: Mesh<TorusGeometry, MeshBasicMaterial>;
  private readonly line: Line<BufferGeometry, LineDashedMaterial>;
  private readonly up = new Vector3(0, 0, 1);

  constructor(changed: () => void) {
    this.ring = new Mesh(
      new TorusGeometry(9.5, 0.45, 5, 48),
      new MeshBasicMaterial({ transparent: true, opacity: 0.6, depthTest: false }),
    );
    this.ring.renderOrder = 4;
    const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
    this.line = new Line(
      geometry,
      new LineDashedMaterial({ transparent: true, opacity: 0.8, dashSize: 1.2, gapSize: 0.8, depthTest: false }),
    );
    this.line.renderOrder = 4;
    this.line.frustumCulled = false;
    this.group.add(this.ring, this.line);
    this.group.visible = false;
    const applyTheme = (): void => {
      this.ring.material.color.set(css("--goal"));
      this.line.material.color.set(css("--goal"));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  /** Set hand goal and mover position [m]; the ring is normal to the radius, or horizontal if `level`. */
  move(goal: readonly number[], tool: readonly number[], level = false): void {
    this.group.visible = Number.isFinite(goal[0]! + tool[0]!);
    if (!this.group.visible) return;
    this.ring.position.set(goal[0]! * MM_PER_M, goal[1]! * MM_PER_M, goal[2]! * MM_PER_M);
    this.ring.quaternion.setFromUnitVectors(this.up, level ? this.up : this.ring.position.clone().normalize());
    const ends = this.line.geometry.getAttribute("position") as BufferAttribute;
    ends.setXYZ(0, goal[0]! * MM_PER_M, goal[1]! * MM_PER_M, goal[2]! * MM_PER_M);
    ends.setXYZ(1, tool[0]! * MM_PER_M, tool[1]! * MM_PER_M, tool[2]! * MM_PER_M);
    ends.needsUpdate = true;
    this.line.geometry.computeBoundingBox();
    this.line.computeLineDistances();
  }
}
