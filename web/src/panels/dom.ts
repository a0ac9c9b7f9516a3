// Short words for the document.

export function at<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no element '${id}'`);
  return element as T;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Write only what changed: the browser need not lay out again. */
export function write(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** What should be said of a world: strain and stress of its hooks, in red where the material would yield. */
export function writeRemarks(element: HTMLElement, remarks: string[]): void {
  write(element, remarks.join(" "));
  element.dataset["tone"] = remarks.some((remark) => remark.includes("BEYOND YIELD")) ? "bad" : "";
}

/** A number with `digits` decimals and a true minus; a dash for what is not known. */
export function formatNumber(value: number, digits: number): string {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}
