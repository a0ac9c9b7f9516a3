// Force as the rumble of a gamepad. Still until switched on.

const PULSE = 80; // ms

export class Rumble {
  on = false;
  private last = 0;

  toggle(): boolean {
    this.on = !this.on;
    return this.on;
  }

  /** `share` of the greatest force, 0…1. */
  play(share: number, now: number): void {
    if (!this.on || now - this.last < PULSE || !(share > 0.02)) return;
    this.last = now;
    const s = Math.min(1, share);
    for (const pad of navigator.getGamepads()) {
      void pad?.vibrationActuator
        ?.playEffect("dual-rumble", { duration: 1.5 * PULSE, strongMagnitude: s, weakMagnitude: 0.5 * s })
        .catch(() => undefined);
    }
  }
}
