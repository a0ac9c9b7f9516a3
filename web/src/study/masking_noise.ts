// Noise on headphones, so that the device cannot be heard. Its effective value is stated, not guessed.

const SECONDS = 8; // of noise, repeated: long enough that nobody handlers the repetition

export class MaskingNoise {
  private context: AudioContext | null = null;
  private loudness: GainNode | null = null;

  constructor(
    private readonly noise: "pink" | "white",
    private readonly volume: number,
  ) {}

  /** Must be called from a click or a key: browsers allow sound only then. */
  start(): void {
    if (this.context) {
      void this.context.resume();
      return;
    }
    this.context = new AudioContext();
    const rate = this.context.sampleRate;
    const buffer = this.context.createBuffer(1, SECONDS * rate, rate);
    buffer.copyToChannel(noise(this.noise, SECONDS * rate), 0);
    // 0 dB is the effective value of the loudest sine, 1/√2 of full scale.
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

/** `count` samples with the effective value 1. */
export function noise(kind: "pink" | "white", count: number): Float32Array<ArrayBuffer> {
  const samples = new Float32Array(count);
  // Pink: first-order filters summed (Kellet), which falls by 3 dB per octave from 10 Hz on.
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
