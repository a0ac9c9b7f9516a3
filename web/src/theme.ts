// Light or dark colours for canvas and 3D drawing, from the system's setting and the variables of the style sheet.

const dark = matchMedia("(prefers-color-scheme: dark)");

export type Rgb = readonly [number, number, number];

export interface Theme {
  dark: boolean;
  /** colour map from −1 (pulls) to +1 (pushes): blue to orange, safe for all kinds of colour vision */
  map: readonly (readonly [number, string])[];
}

const LIGHT_MAP = [
  [-1, "#0b3c7d"],
  [-0.6, "#2f78bd"],
  [-0.25, "#9cc4e4"],
  [0, "#f3f1ec"],
  [0.25, "#f7c48b"],
  [0.6, "#dd7b1d"],
  [1, "#8a3a00"],
] as const;

const DARK_MAP = [
  [-1, "#a8d8ff"],
  [-0.6, "#4a9fe8"],
  [-0.25, "#1f5690"],
  [0, "#2a2e35"],
  [0.25, "#8a4a10"],
  [0.6, "#ee8a25"],
  [1, "#ffd9a0"],
] as const;

export function theme(): Theme {
  return { dark: dark.matches, map: dark.matches ? DARK_MAP : LIGHT_MAP };
}

export function onThemeChange(then: () => void): void {
  dark.addEventListener("change", then);
}

/** Current value of a variable of the style sheet. */
export function css(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

const channel = (hex: string, i: number): number => parseInt(hex.slice(1 + 2 * i, 3 + 2 * i), 16);

/** Colour of the map at −1…1; 0…255 per channel. */
export function mapColour(value: number, { map } = theme()): Rgb {
  const x = Math.min(1, Math.max(-1, value));
  let k = 1;
  while (k < map.length - 1 && map[k]![0] < x) k++;
  const [x0, c0] = map[k - 1]!;
  const [x1, c1] = map[k]!;
  const s = (x - x0) / (x1 - x0);
  return [0, 1, 2].map((i) => channel(c0, i) * (1 - s) + channel(c1, i) * s) as unknown as Rgb;
}

/** The colour map as a 256 × 1 RGBA image. */
export function mapPixels(): Uint8Array {
  const pixels = new Uint8Array(256 * 4);
  const now = theme();
  for (let i = 0; i < 256; i++) {
    pixels.set([...mapColour((i / 255) * 2 - 1, now).map(Math.round), 255], 4 * i);
  }
  return pixels;
}

/** Colour of channel `channel` of `of`: evenly spaced hues, with alternating lightness between neighbours. */
export function channelColour(channel: number, of: number): string {
  if (of <= 3) return css(`--s${"xyz"[channel % 3]!}`);
  const light = (dark.matches ? [72, 56, 84] : [42, 55, 30])[channel % 3]!;
  return `hsl(${((channel * 360) / of).toFixed(0)} ${dark.matches ? 80 : 75}% ${light}%)`;
}
