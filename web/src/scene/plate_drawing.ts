// Drawing of a coil array with a plate: coils, and a tool with magnets over a horizontal plate. Dragging moves the tool
// at constant height; wheel and keys lift or press it.

import {
  BufferGeometry,
  Color,
  Float32BufferAttribute,
  Group,
  LineBasicMaterial,
  LineLoop,
  type Mesh,
  MeshLambertMaterial,
  SRGBColorSpace,
  Vector3,
} from "three";
import type { Sample } from "../sample";
import type { PlateScene, Session } from "../session";
import { css, mapColour, onThemeChange } from "../theme";
import type { HandGoal } from "../wire";
import { AxesDrawing } from "./axes_drawing";
import { intersectLevelPlane } from "./drag";
import { ArrayTool } from "./mover_drawing";
import { partsOf, placePart } from "./parts";
import type { Stage } from "./stage";

const MM_PER_M = 1000;
const MIN_LIFT_M = -6e-3; // hand goal below contact
const MAX_LIFT_M = 6e-3; // hand goal above the height up to which forces are rendered
const KEY_STEP_M = 1e-3; // also of the wheel
const MIN_VISIBLE_CHANGE = 0.04; // of the current, relative to full colour

/** Coils, coloured by current, and the edge of the workspace on the plate. */
class Board {
  readonly group = new Group();
  private readonly coils: Mesh<BufferGeometry, MeshLambertMaterial>[];
  private readonly shares: number[] = [];
  private readonly colour = new Color();

  constructor(
    scene: PlateScene,
    /** current at full colour [A] */
    private readonly range: number,
    changed: () => void,
  ) {
    this.coils = partsOf(scene, "coil").map(
      (coil) => placePart(coil, new MeshLambertMaterial(), 40) as Mesh<BufferGeometry, MeshLambertMaterial>,
    );
    const [x, y] = scene.half_width.map((side) => side * MM_PER_M) as [number, number];
    const z = scene.height * MM_PER_M;
    const corners = [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]].flat();
    const edge = new LineBasicMaterial({ transparent: true, opacity: 0.55 });
    const rim = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(corners, 3));
    this.group.add(...this.coils, new LineLoop(rim, edge));
    const applyTheme = (): void => {
      edge.color.set(css("--text"));
      this.coils.forEach((_, k) => this.paint(k));
      changed();
    };
    onThemeChange(applyTheme);
    applyTheme();
  }

  /** Colour the coils by `currents` [A]; returns whether a colour changed visibly. */
  glow(currents: ArrayLike<number>): boolean {
    let different = false;
    this.coils.forEach((_, k) => {
      const share = (currents[k] || 0) / this.range;
      if (Math.abs(share - (this.shares[k] ?? 0)) < MIN_VISIBLE_CHANGE) return;
      this.shares[k] = share;
      this.paint(k);
      different = true;
    });
    return different;
  }

  private paint(k: number): void {
    const [r, g, b] = mapColour(this.shares[k] ?? 0);
    this.coils[k]!.material.color.copy(this.colour.setRGB(r / 255, g / 255, b / 255, SRGBColorSpace));
  }
}

export class PlateDrawing extends AxesDrawing {
  override readonly hint = "drag the tool";
  override readonly keys = [
    ["← → ↑ ↓", "move the tool along the plate by 1 mm as seen here (with Shift: 5 mm)"],
    ["+ −", "lift or press the tool; or the wheel during a drag"],
  ] as const;
  override readonly range: number;
  private readonly board: Board;

  constructor(
    stage: Stage,
    private readonly plate: PlateScene,
    limits: Session["limits"],
  ) {
    const touch = (): void => stage.touch();
    const range = Math.max(...limits.current) / 2;
    const board = new Board(plate, range, touch);
    super(stage, plate, limits, new ArrayTool(plate, touch), board.group);
    this.range = range;
    this.board = board;
    stage.canvas.ariaLabel =
      "Coils and a tool over a plate. Arrow keys move it along the plate, plus and minus lift or press it, question mark lists all keys.";
  }

  override show(sample: Sample): boolean {
    const glows = this.board.glow(sample.list("current_measured"));
    if (glows) this.stage.touch();
    return super.show(sample) || glows;
  }

  override forget(): void {
    this.board.glow([]);
    super.forget();
  }

  /** Drag in the horizontal plane through the tool. */
  override drag(x: number, y: number): HandGoal {
    this.grasped = true;
    const to = intersectLevelPlane(this.stage.ray(x + this.grabOffset.x, y + this.grabOffset.y), this.handGoal.z * MM_PER_M)?.divideScalar(MM_PER_M);
    if (to) this.handGoal.set(to.x, to.y, this.handGoal.z);
    return this.clampHandGoal();
  }

  override press(notches: number): HandGoal {
    this.grasped = true;
    this.handGoal.z += notches * KEY_STEP_M;
    return this.clampHandGoal();
  }

  override nudge(right: number, up: number): HandGoal {
    this.grasped = true;
    const { matrixWorld } = this.stage.camera;
    const across = new Vector3().setFromMatrixColumn(matrixWorld, 0).setZ(0).normalize();
    this.handGoal.addScaledVector(across, right * KEY_STEP_M);
    this.handGoal.addScaledVector(new Vector3(-across.y, across.x, 0), up * KEY_STEP_M);
    return this.clampHandGoal();
  }

  private clampHandGoal(): HandGoal {
    const { half_width, contact_height, thickness } = this.plate;
    const [x, y] = half_width;
    this.handGoal.clamp(
      new Vector3(-x, -y, contact_height + MIN_LIFT_M),
      new Vector3(x, y, contact_height + thickness + MAX_LIFT_M),
    );
    return this.currentHandGoal();
  }
}
