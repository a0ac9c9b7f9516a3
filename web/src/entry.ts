// Numbers as they were typed: what is not one is refused, and nothing that was typed is changed or left out.

const WHOLE = /^(0|-?[1-9]\d*)$/;
const DECIMAL = /^-?\d+([.,]\d+)?$/;
const ANY = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;
const DIGITS = 15; // significant ones, that a computer's number holds exactly

/** The whole number that `text` is; null: it is none. */
export function readWhole(text: string): number | null {
  return WHOLE.test(text) && Number.isSafeInteger(Number(text)) ? Number(text) : null;
}

/** The number that `text` is, with a decimal point or comma; null: it is none, or might be read in two ways (1,000). */
export function readDecimal(text: string): number | null {
  return DECIMAL.test(text) && !/,\d{3}$/.test(text) ? exact(text.replace(",", ".")) : null;
}

/** The number that `text` is as programs write it, also 1e-3; null: it is none. */
export function readNumber(text: string): number | null {
  return ANY.test(text) ? exact(text) : null;
}

function exact(text: string): number | null {
  const digits = text.replace(/e.*$/i, "").replace(/[^\d]/g, "").replace(/^0+/, "");
  const value = Number(text);
  return digits.length <= DIGITS && Number.isFinite(value) ? value : null;
}
