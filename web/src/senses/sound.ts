// Force as sound: pitch and loudness follow the magnitude, stereo position the direction; off by default.

export class Sound {
  private context: AudioContext | null = null;
  private tone: OscillatorNode | null = null;
  private loudness: GainNode | null = null;
  private side: StereoPannerNode | null = null;
  on = false;

  toggle(): boolean {
    this.on = !this.on;
    if (this.on && !this.context) this.build();
    void (this.on ? this.context?.resume() : this.context?.suspend());
    return this.on;
  }

  /** `share`: force relative to its limit, 0…1; `pan`: −1 (left) to 1 (right). */
  play(share: number, pan: number): void {
    if (!this.on || !this.context) return;
    const s = Number.isFinite(share) ? Math.min(1, Math.max(0, share)) : 0;
    const soon = this.context.currentTime;
    this.tone!.frequency.setTargetAtTime(110 * 2 ** (3 * s), soon, 0.02);
    this.loudness!.gain.setTargetAtTime(s < 0.005 ? 0 : 0.03 + 0.17 * s, soon, 0.03);
    this.side!.pan.setTargetAtTime(Math.min(1, Math.max(-1, pan || 0)), soon, 0.03);
  }

  private build(): void {
    this.context = new AudioContext();
    this.tone = new OscillatorNode(this.context, { type: "triangle", frequency: 110 });
    this.loudness = new GainNode(this.context, { gain: 0 });
    this.side = new StereoPannerNode(this.context);
    this.tone.connect(this.loudness).connect(this.side).connect(this.context.destination);
    this.tone.start();
  }
}
