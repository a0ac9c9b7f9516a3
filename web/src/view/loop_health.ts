// Loop timing over the five seconds before the shown row, computed from the recorded samples.

import type { History } from "../history";
import type { Health } from "../panels/header";

const WINDOW_S = 5; // as in the console's server

export function loopHealth(history: History): Health | null {
  const [first, last] = history.window(history.newest - WINDOW_S, history.newest);
  const count = last - first;
  if (count < 2) return null;
  const column = (name: string): Float32Array => history.column(history.series.findIndex((one) => one.name === name), first, last);
  const times = history.times(first, last);
  const span = times[count - 1]! - times[0]!;
  let missed = 0;
  for (const one of column("missed").subarray(1)) missed += Number.isFinite(one) ? one : 0;
  const [valid, age] = [column("valid"), column("age")];
  const ages = percentile(age.filter((one, i) => valid[i] === 1 && Number.isFinite(one)), 0.99);
  const late = percentile(column("lateness").filter(Number.isFinite), 0.99);
  return {
    rate_hz: span > 0 ? (count - 1) / span : null,
    success: (count - 1) / (count - 1 + missed),
    lateness_p99_us: late === null ? null : 1e6 * late,
    pose_age_ms: ages === null ? null : 1e3 * ages,
    recording_trouble: "",
    warning: "",
    world_trouble: "",
    missing_pose: "",
    connections: [],
  };
}

function percentile(values: Float32Array, share: number): number | null {
  return values.length ? values.sort()[Math.floor(share * (values.length - 1))]! : null;
}
