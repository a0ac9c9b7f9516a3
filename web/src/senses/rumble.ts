// Force as gamepad rumble; off by default.

const PULSE_INTERVAL_MS = 80;
const MIN_FORCE_FRACTION = 0.02; // no rumble below

export class Rumble {
  on = false;
  private last = 0;

  toggle(): boolean {
    this.on = !this.on;
    return this.on;
  }

  /** `share`: force relative to its limit, 0…1. */
  play(share: number, now: number): void {
    if (!this.on || now - this.last < PULSE_INTERVAL_MS || !(share > MIN_FORCE_FRACTION)) return;
    this.last = now;
    const s = Math.min(1, share);
    for (const pad of navigator.getGamepads()) {
      void pad?.vibrationActuator
        ?.playEffect("dual-rumble", { duration: 1.5 * PULSE_INTERVAL_MS, strongMagnitude: s, weakMagnitude: 0.5 * s })
        .catch(() => undefined);
    }
  }
}
