// Colours that follow the system's light or dark: one place, read by the drawing and written into the style sheet's
// own variables by the style sheet itself.

const dark = matchMedia("(prefers-color-scheme: dark)");

export type Rgb = readonly [number, number, number];

export interface Theme {
  dark: boolean;
  /** the map from −1 (pulls) over 0 to +1 (pushes): blue to orange, told apart by every kind of colour vision */
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

/** A colour of the style sheet, as it is now. */
export function css(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

const channel = (hex: string, i: number): number => parseInt(hex.slice(1 + 2 * i, 3 + 2 * i), 16);

/** The map's colour at −1…1, 0…255 per channel. */
export function mapped(value: number, { map } = theme()): Rgb {
  const x = Math.min(1, Math.max(-1, value));
  let k = 1;
  while (k < map.length - 1 && map[k]![0] < x) k++;
  const [x0, c0] = map[k - 1]!;
  const [x1, c1] = map[k]!;
  const s = (x - x0) / (x1 - x0);
  return [0, 1, 2].map((i) => channel(c0, i) * (1 - s) + channel(c1, i) * s) as unknown as Rgb;
}

/** The map as a picture, 256 by 1, RGBA. */
export function mapPixels(): Uint8Array {
  const pixels = new Uint8Array(256 * 4);
  const now = theme();
  for (let i = 0; i < 256; i++) {
    pixels.set([...mapped((i / 255) * 2 - 1, now).map(Math.round), 255], 4 * i);
  }
  return pixels;
}

/** A colour for one of many channels: hues apart, neighbours light and dark in turn. */
export function channelColour(channel: number, of: number): string {
  if (of <= 3) return css(`--s${"xyz"[channel % 3]!}`);
  const light = (dark.matches ? [72, 56, 84] : [42, 55, 30])[channel % 3]!;
  return `hsl(${((channel * 360) / of).toFixed(0)} ${dark.matches ? 80 : 75}% ${light}%)`;
}
