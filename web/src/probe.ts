// A read-only window for tests: what the page shows now, as numbers.

export interface Probe {
  readonly frames: number;
  readonly drawn: number;
  readonly dropped: number;
  readonly status: string;
  /** from the pointer's event to the force that answers it, drawn [ms] */
  readonly latencies: readonly number[];
  /** and on the way: medians from the event to the page's own knowledge of it, to the answer at the socket, to the
   * answer on the page, to its drawing [ms] */
  readonly parts: { sent: number; answered: number; arrived: number; drawn: number };
  /** median time per frame for the picture and for the plots [ms] */
  readonly costs: { scene: number; plots: number };
  /** how much is drawn, and how often what stands still was drawn to be kept */
  readonly level: string;
  readonly kept: number;
  readonly arrow: boolean;
  readonly range: number;
  readonly control: boolean;
  readonly samples: number;
  readonly heap: number;
  value(name: string): number[];
  forceAt(direction: [number, number, number]): { force: number; saturated: boolean };
  /** where the stylus is on the screen: tip and far end [CSS px of the page] */
  stylus(): { x: number; y: number }[];
  /** how many coils are drawn, and where the mover is drawn [m], where the scene tells it */
  picture(): { coils: number; mover: number[] };
  /** where the bodies of a world with memory are drawn [m]; null: not drawn */
  shapes(): (number[] | null)[];
  /** where their middles are on their canvas [CSS px] */
  spots(): { x: number; y: number }[];
  /** where the plug is drawn, and how far its hooks' tips are bent [m] */
  plug(): { place: number[]; bent: number[] };
}

declare global {
  interface Window {
    readonly haptorb: Probe;
  }
}

export function expose(probe: Probe): void {
  Object.defineProperty(window, "haptorb", { value: Object.freeze(probe), writable: false, configurable: false });
}
