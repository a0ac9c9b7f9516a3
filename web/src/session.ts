// Session description: what the server sends before the first frame (`haptorb.web.session`).

export interface Column {
  name: string;
  offset: number;
  width: number;
  unit: string;
  /** CSV column heads with units, one per value, as in recordings */
  heads: string[];
  about: string;
}

export interface Parameter {
  name: string;
  unit: string;
  low: number;
  high: number;
  default: number | number[];
  about: string;
}

export interface World {
  name: string;
  about: string;
  parameters: Parameter[];
}

export type Values = Record<string, number | number[]>;

/** The part of the wrench that a device renders: its first three components, or its last three. */
export type RenderedQuantity = "force" | "torque";

/** Description of the device's drawing; `kind` selects the scene, which defines the further fields. */
export interface Scene {
  kind: string;
  gives: RenderedQuantity;
  /** rest position of the mover [m] */
  rest?: [number, number, number];
  /** coils and magnets from the device file; those of the mover in its rest position */
  parts?: RoundPart[];
  sensors?: [number, number, number][];
  marks?: [number, number, number][];
  /** polygons that bound the workspace [m] */
  edges?: [number, number, number][][];
  /** dimensions that the device file omits */
  notes?: string[];
}

/** A coil or magnet, axisymmetric about `axis`; lengths in metres. */
export interface RoundPart {
  name: string;
  role: "coil" | "magnet" | "ring";
  /** name of a coil's channel */
  channel: string;
  position: [number, number, number];
  axis: [number, number, number];
  inner_radius: number;
  outer_radius: number;
  length: number;
  /** positive: the north pole faces along `axis` */
  polarity: number;
  moves: boolean;
  /** false: the device file omits its size */
  stated: boolean;
}

/** Stylus with a magnet over a dome; lengths in metres, angles in radians. */
export interface DomeScene extends Scene {
  kind: "dome";
  dome_radius: number;
  /** wall thickness; 0: omitted in the device file */
  dome_wall: number;
  contact_distance: number;
  shell_thickness: number;
  workspace: number;
  core_radius: number;
  /** worn: the magnet is on a fingertip, not in a stylus */
  magnet: { worn: boolean; outer_radius: number; length: number; tip_distance: number };
}

/** Coil array and a tool with magnets over a horizontal plate; lengths in metres. */
export interface PlateScene extends Scene {
  kind: "plate";
  /** z of the plate */
  height: number;
  /** half width of the workspace along x and y */
  half_width: [number, number];
  /** z of the tool's origin when its tip touches the plate */
  contact_height: number;
  /** height above contact up to which forces are rendered */
  thickness: number;
  /** origin of the tool for the magnet positions in `parts` */
  tool: { origin: [number, number, number]; tip_distance: number };
}

/** Rotor with magnets and a handle around a stator with coils; lengths in metres, angles in radians. */
export interface MotorScene extends Scene {
  kind: "motor";
  workspace: number;
  handle_length: number;
  /** (coils, channels): factor from each channel's current to the coil's */
  groups: number[][];
}

/** The object that the motor moves, in metres; fields as in `object_scene` of `haptorb.web.session`. */
export interface ObjectScene {
  hooks: number;
  root: number;
  back: number;
  width: number;
  along: number[];
  section: number[];
  at: number[];
  bends: number[][];
  outline: [number, number][];
  floor: number;
  force: number;
}

/** A body of a world with memory: sizes in metres, and indices of its position and quaternion in the row's memory. */
export interface Shape {
  name: string;
  kind: "sphere" | "capsule" | "cylinder" | "box" | "ellipsoid" | "mesh";
  size: number[];
  /** determines the colour */
  role: "held" | "moves" | "fixed" | "path" | "";
  /** initial position and quaternion, fixed if `place` is null; may be empty */
  at: number[];
  /** of a mesh: x, y, z of its vertices, and vertex indices of its triangles */
  points: number[];
  corners: number[];
  place: number | null;
  attitude: number | null;
}

/** State of a feel session, in which a person rates designs; hidden names and values are omitted. */
export interface FeelState {
  title: string;
  person: string;
  people: string[];
  hidden: boolean;
  scale: [number, number];
  number: number;
  label: string;
  /** identifies this presentation; a rating refers to it */
  feeling: string;
  score: number | null;
  /** whether the person has felt the design, and may rate it */
  felt: boolean;
  a: number;
  b: number;
  designs: { number: number; label: string; score: number | null; remarks: string[] }[];
  /** `now`: factor on all torques of the handle; `hand`: force at the hand per force on the part */
  torque_scale: { now: number; low: number; high: number; reason: string; hand: number };
  finished: boolean;
}

export interface Session {
  version: string;
  started: string;
  simulated: boolean;
  /** whether the page's pointer is the tracker; otherwise dragging has no effect */
  steered: boolean;
  /** heartbeat timeout of a page that holds the mover [s] */
  heartbeat_timeout: number;
  device: { name: string; title: string; source: string };
  /** "dome", "motor" or "plate"; any other kind is drawn as axes and a marker */
  scene: Scene;
  /** modes of the linkage between mover and object; empty where the world acts on the mover directly */
  modes: string[];
  /** controller models, the default first */
  models: string[];
  columns: Column[];
  /** remark on the rendered part of the wrench, indexed by the column `part`; empty where there is no choice */
  parts: string[];
  /** names of the limits, indexed by the column `saturated` */
  saturations: string[];
  coils: string[];
  limits: {
    force: number;
    torque: number;
    expiry: number;
    current: number[];
    warn: number;
    derate: number;
    stop: number;
  };
  worlds: World[];
  world: { name: string; values: Values; model: string; scene: ObjectScene | null; shapes: Shape[]; remarks: string[] };
  feel: FeelState | null;
  /** trip reasons by code: a word, and a text with the cause and what to do */
  trips: Record<string, { word: string; text: string }>;
}

/** The token in the address's fragment, which authorises requests. */
export const token = (): string => location.hash.slice(1);

/** The server rejected this page's token. */
export class UnknownToken extends Error {}

const RESPONSE_TIMEOUT_MS = 10_000;

/** Fetch the session description; rejects with UnknownToken if the token is rejected, otherwise with an Error. */
export async function fetchSession(): Promise<Session> {
  const headers = { authorization: `Bearer ${token()}` };
  const answer = await fetch("api/session", { headers, signal: AbortSignal.timeout(RESPONSE_TIMEOUT_MS) });
  if (answer.status === 403) throw new UnknownToken(await answer.text());
  if (!answer.ok) throw new Error(`the server responded with ${answer.status} to /api/session`);
  return (await answer.json()) as Session;
}
