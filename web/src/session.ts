// What the server says about itself before the first frame.

export interface Column {
  name: string;
  offset: number;
  width: number;
  unit: string;
  /** of each number in a CSV file, with its own unit, as recordings have them */
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

/** What a device gives to the hand: the first three numbers of a wrench, or the last three. */
export type Gives = "force" | "torque";

/** How the device is drawn; `kind` names the scene, and what else there is belongs to that. */
export interface Scene {
  kind: string;
  gives: Gives;
  /** where the mover is when nobody moves it [m] */
  rest?: [number, number, number];
  /** what the device file says of coils and magnets; the mover's as they are at rest */
  parts?: RoundPart[];
  sensors?: [number, number, number][];
  marks?: [number, number, number][];
  /** polygons that bound the workspace [m] */
  edges?: [number, number, number][][];
  /** what the device file does not state */
  notes?: string[];
}

/** A coil or a magnet, round about `axis`; lengths in metres. */
export interface RoundPart {
  name: string;
  role: "coil" | "magnet" | "ring";
  /** of a coil: the name of its current */
  channel: string;
  position: [number, number, number];
  axis: [number, number, number];
  inner_radius: number;
  outer_radius: number;
  length: number;
  /** positive: its north pole is at the axis' end */
  polarity: number;
  moves: boolean;
  /** false: the device file does not say how large it is */
  stated: boolean;
}

/** A stylus with a magnet over a dome; lengths in metres, angles in radians. */
export interface DomeScene extends Scene {
  kind: "dome";
  dome_radius: number;
  /** thickness; 0: the device file does not state it */
  dome_wall: number;
  contact_distance: number;
  shell_thickness: number;
  workspace: number;
  core_radius: number;
  /** worn: on a fingertip, not in a pen */
  magnet: { worn: boolean; outer_radius: number; length: number; tip_distance: number };
}

/** Coils anywhere, and a tool with magnets over a level plate; lengths in metres. */
export interface PlateScene extends Scene {
  kind: "plate";
  /** of the plate */
  height: number;
  /** greatest distance of the tool along x and y */
  half_width: [number, number];
  /** of the tool's origin when its tip touches the plate */
  contact_height: number;
  /** how far above contact forces are rendered */
  thickness: number;
  /** where the tool's origin is while its magnets are at the places of `parts` */
  tool: { origin: [number, number, number]; tip_distance: number };
}

/** A rotor with magnets around a stator with coils, and a handle; lengths in metres, angles in radians. */
export interface MotorScene extends Scene {
  kind: "motor";
  workspace: number;
  handle_length: number;
  /** for every coil, its share of each channel's current */
  groups: number[][];
}

/** What the motor moves, in metres; see the server's `target.py`. */
export interface TargetScene {
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

/** A body of a world with memory: sizes in metres, and where in the row's memory its place and attitude begin. */
export interface Shape {
  name: string;
  kind: "sphere" | "capsule" | "cylinder" | "box" | "ellipsoid" | "mesh";
  size: number[];
  /** what it is to the hand, for its colour */
  role: "held" | "moves" | "fixed" | "path" | "";
  /** centre and quaternion where it begins, and, without a place, stays; may be empty */
  at: number[];
  /** of a mesh: x, y, z of its corners, and which three make a triangle */
  points: number[];
  corners: number[];
  place: number | null;
  attitude: number | null;
}

/** A session in which designs are felt and rated; what is hidden is not in it. */
export interface FeelState {
  title: string;
  person: string;
  people: string[];
  hidden: boolean;
  scale: [number, number];
  number: number;
  label: string;
  /** which feeling it is: a rating names it */
  feeling: string;
  score: number | null;
  /** whether something could be felt of it so far: it can be rated */
  felt: boolean;
  a: number;
  b: number;
  designs: { number: number; label: string; score: number | null; remarks: string[] }[];
  /** all torques of the handle times `now`; `hand`: force in the hand per force on the part */
  gain: { now: number; low: number; high: number; reason: string; hand: number };
  finished: boolean;
}

export interface Session {
  version: string;
  started: string;
  simulated: boolean;
  /** whether the pointer on this page is the tracker; else dragging moves nothing */
  steered: boolean;
  /** after so long without a sign of life a page that holds the mover loses it [s] */
  patience: number;
  device: { name: string; title: string; source: string };
  /** the picture: "dome", "motor", "plate", or another name, which is drawn as axes and a marker */
  scene: Scene;
  /** how the mover can move a target; empty where the world acts on it directly */
  modes: string[];
  /** the models of coils and magnets that the controller can invert, the default first */
  models: string[];
  columns: Column[];
  /** what to say of the part of the wrench that is rendered, by the column `part`; empty where there is no choice */
  parts: string[];
  /** what holds a wrench back, in words, by the column `saturated` */
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
  world: { name: string; values: Values; model: string; scene: TargetScene | null; shapes: Shape[]; remarks: string[] };
  feel: FeelState | null;
  /** the guard's reasons by code: a word, and what happened and what to do */
  trips: Record<string, { word: string; text: string }>;
}

/** What the address says behind its #: whoever knows it may use this console. */
export const token = (): string => location.hash.slice(1);

/** The server does not know this page's token. */
export class UnknownToken extends Error {}

const PATIENCE = 10_000; // for the server's answer [ms]

/** Rejects with a UnknownToken if this page is not known, else with an Error. */
export async function session(): Promise<Session> {
  const headers = { authorization: `Bearer ${token()}` };
  const answer = await fetch("api/session", { headers, signal: AbortSignal.timeout(PATIENCE) });
  if (answer.status === 403) throw new UnknownToken(await answer.text());
  if (!answer.ok) throw new Error(`the server responded with ${answer.status} to /api/session`);
  return (await answer.json()) as Session;
}
