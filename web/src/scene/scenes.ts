// Scenes by the name that the server sends; axes and a marker for any other name.

import { Readouts } from "../panels/readouts";
import { MotorReadouts } from "../panels/motor_readouts";
import { PlaceReadouts } from "../panels/place_readouts";
import type { DomeScene, MotorScene, PlateScene, Session } from "../session";
import { AxesDrawing } from "./axes_drawing";
import type { DeviceScene } from "./device_scene";
import { partsOf } from "./parts";
import { PlateDrawing } from "./plate_drawing";
import { MotorDrawing } from "./motor_drawing";
import { DomeDrawing } from "./dome_drawing";

const MM_PER_M = 1000;

const DOME: DeviceScene = {
  held: "stylus",
  radial: true,
  colours: "force",
  home: () => ({ azimuth: -62, elevation: 26, distance: 262, centre: [0, 0, 43] }),
  drawing: (stage, session) => new DomeDrawing(stage, session.scene as DomeScene, session.limits),
  readouts: (session) => new Readouts(session),
};

const MOTOR: DeviceScene = {
  held: "handle",
  radial: false,
  colours: "currents",
  home: () => ({ azimuth: -62, elevation: 24, distance: 560, centre: [-30, -16, 0] }),
  drawing: (stage, session) => new MotorDrawing(stage, session.scene as MotorScene, session.limits),
  readouts: (session) => new MotorReadouts(session),
};

const AXES: DeviceScene = {
  held: "marker",
  radial: false,
  colours: "none",
  home: (session) => {
    const [x, y, z] = session.scene.rest ?? [0, 0, 0];
    const corners = (session.scene.edges ?? []).flat();
    const reach = Math.max(0, ...corners.map((at) => Math.hypot(at[0] - x, at[1] - y, at[2] - z) * MM_PER_M));
    const distance = Math.max(262, (innerWidth < 600 ? 5 : 3.9) * reach); // phones in portrait are narrow
    return { azimuth: -62, elevation: 26, distance, centre: [x * MM_PER_M, y * MM_PER_M, z * MM_PER_M] };
  },
  drawing: (stage, session) => new AxesDrawing(stage, session.scene, session.limits),
  readouts: (session) => new PlaceReadouts(session),
};

const PLATE: DeviceScene = {
  held: "tool",
  radial: false,
  colours: "currents",
  home: (session) => {
    // Fit coils and workspace into the view.
    const scene = session.scene as PlateScene;
    const coils = partsOf(scene, "coil");
    const across = coils.map(({ position: [x, y], outer_radius }) => Math.hypot(x, y) + outer_radius);
    const bottom = Math.min(0, ...coils.map(({ position: [, , z], length, outer_radius }) => z - Math.max(length / 2, outer_radius / 2)));
    const reach = Math.max(Math.hypot(...scene.half_width) * MM_PER_M + 30, Math.max(...across) * MM_PER_M + 20);
    const distance = (innerWidth < 600 ? 4.3 : 3.3) * reach; // phones in portrait are narrow
    return { azimuth: -62, elevation: 34, distance, centre: [0, 0, ((bottom + scene.contact_height + scene.thickness) / 2) * MM_PER_M] };
  },
  drawing: (stage, session) => new PlateDrawing(stage, session.scene as PlateScene, session.limits),
  readouts: (session) => new PlaceReadouts(session),
};

const SCENES: Record<string, DeviceScene> = { dome: DOME, motor: MOTOR, plate: PLATE };

export const sceneOf = (session: Session): DeviceScene => SCENES[session.scene.kind] ?? AXES;
