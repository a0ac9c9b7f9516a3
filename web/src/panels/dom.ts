// DOM helpers.

/** Element by id; throws if the page has none. */
export function at<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no element '${id}'`);
  return element as T;
}

/** Create an element with properties and children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Set text only if it changed, to avoid a new layout. */
export function write(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Show the remarks on a world, such as stress of its hooks; in red if the material would yield. */
export function writeRemarks(element: HTMLElement, remarks: string[]): void {
  write(element, remarks.join(" "));
  element.dataset["tone"] = remarks.some((remark) => remark.includes("BEYOND YIELD")) ? "bad" : "";
}

/** Format with `digits` decimals and a minus sign (U+2212); a dash if the value is not finite. */
export function formatNumber(value: number, digits: number): string {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}
