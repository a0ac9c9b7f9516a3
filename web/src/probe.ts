// Read-only test interface `window.haptorb`: what the page currently shows, as numbers.

export interface Probe {
  readonly frames: number;
  readonly drawn: number;
  readonly dropped: number;
  readonly status: string;
  /** latency from pointer event to drawn force [ms] */
  readonly latencies: readonly number[];
  /** median times from the pointer event to its handler, to the response at the worker, to the response on the page,
   * and to the drawn response [ms] */
  readonly parts: { sent: number; answered: number; arrived: number; drawn: number };
  /** median time per frame of the 3D view and of the plots [ms] */
  readonly costs: { scene: number; plots: number };
  /** level of detail, and how often the backdrop was drawn */
  readonly level: string;
  readonly kept: number;
  readonly arrow: boolean;
  readonly range: number;
  readonly control: boolean;
  readonly samples: number;
  readonly heap: number;
  value(name: string): number[];
  forceAt(direction: [number, number, number]): { force: number; saturated: boolean };
  /** positions of the stylus on the page, from tip to far end [CSS px] */
  stylus(): { x: number; y: number }[];
  /** number of coils drawn, and drawn position of the mover [m], if the scene provides them */
  picture(): { coils: number; mover: number[] };
  /** drawn positions of the bodies of a world with memory [m]; null: not drawn */
  shapes(): (number[] | null)[];
  /** their centres on the canvas [CSS px] */
  spots(): { x: number; y: number }[];
  /** drawn position of the plug, and deflection of its hooks' tips [m] */
  plug(): { place: number[]; bent: number[] };
}

declare global {
  interface Window {
    readonly haptorb: Probe;
  }
}

export function exposeProbe(probe: Probe): void {
  Object.defineProperty(window, "haptorb", { value: Object.freeze(probe), writable: false, configurable: false });
}
