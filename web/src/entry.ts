// Strict parsing of typed numbers: anything ambiguous or not a number is rejected, never corrected silently.

const WHOLE = /^(0|-?[1-9]\d*)$/;
const DECIMAL = /^-?\d+([.,]\d+)?$/;
const ANY = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i;
const MAX_SIGNIFICANT_DIGITS = 15; // that a double represents exactly

/** Parse an integer; null if `text` is not one. */
export function readWhole(text: string): number | null {
  return WHOLE.test(text) && Number.isSafeInteger(Number(text)) ? Number(text) : null;
}

/** Parse a number with decimal point or comma; null if `text` is not one, or is ambiguous (1,000). */
export function readDecimal(text: string): number | null {
  return DECIMAL.test(text) && !/,\d{3}$/.test(text) ? exact(text.replace(",", ".")) : null;
}

/** Parse a number in program notation, such as 1e-3; null if `text` is not one. */
export function readNumber(text: string): number | null {
  return ANY.test(text) ? exact(text) : null;
}

function exact(text: string): number | null {
  const digits = text.replace(/e.*$/i, "").replace(/[^\d]/g, "").replace(/^0+/, "");
  const value = Number(text);
  return digits.length <= MAX_SIGNIFICANT_DIGITS && Number.isFinite(value) ? value : null;
}
