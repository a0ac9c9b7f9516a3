// Masking noise on headphones against the sound of the device, with a defined RMS level.

const LOOP_DURATION_S = 8; // of the noise, long enough that the repetition is not audible

export class MaskingNoise {
  private context: AudioContext | null = null;
  private loudness: GainNode | null = null;

  constructor(
    private readonly noise: "pink" | "white",
    private readonly volume: number,
  ) {}

  /** Start; must be called in a click or key handler, because browsers allow sound only then. */
  start(): void {
    if (this.context) {
      void this.context.resume();
      return;
    }
    this.context = new AudioContext();
    const rate = this.context.sampleRate;
    const buffer = this.context.createBuffer(1, LOOP_DURATION_S * rate, rate);
    buffer.copyToChannel(noise(this.noise, LOOP_DURATION_S * rate), 0);
    // 0 dB is the RMS level of a full-scale sine, 1/√2 of full scale.
    this.loudness = new GainNode(this.context, { gain: Math.SQRT1_2 * 10 ** (this.volume / 20) });
    const source = new AudioBufferSourceNode(this.context, { buffer, loop: true });
    source.connect(this.loudness).connect(this.context.destination);
    source.start();
  }

  stop(): void {
    void this.context?.suspend();
  }

  get playing(): boolean {
    return this.context?.state === "running";
  }

  get state(): string {
    return `Noise is played during the study (${this.noise}, ${this.volume} dB of full scale). Put the headphones on.`;
  }
}

/** Generate `count` samples with an RMS level of 1. */
export function noise(kind: "pink" | "white", count: number): Float32Array<ArrayBuffer> {
  const samples = new Float32Array(count);
  // Pink noise: sum of first-order filters (Kellet), −3 dB per octave above 10 Hz.
  const states = new Float64Array(6);
  const poles = [0.99886, 0.99332, 0.969, 0.8665, 0.55, -0.7616];
  const gains = [0.0555179, 0.0750759, 0.153852, 0.3104856, 0.5329522, -0.016898];
  let [sum, before] = [0, 0];
  for (let n = 0; n < count; n++) {
    const white = 2 * Math.random() - 1;
    let value = white;
    if (kind === "pink") {
      value = 0.5362 * white + before;
      before = 0.115926 * white;
      for (let k = 0; k < 6; k++) value += states[k] = poles[k]! * states[k]! + gains[k]! * white;
    }
    samples[n] = value;
    sum += value * value;
  }
  const scale = 1 / Math.sqrt(sum / count);
  for (let n = 0; n < count; n++) samples[n]! *= scale;
  return samples;
}
