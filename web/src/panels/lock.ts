// Instead of everything else: why this page shows nothing, and what to do. Nothing dead is left that looks alive.

import { at, write } from "./dom";

export interface Lock {
  title: string;
  text: string;
}

export const UNKNOWN: Lock = {
  title: "Open the address that the terminal printed",
  text:
    "Open the full address, with the part after the #. It changes with every start; only a page that has it can move the " +
    "device.",
};

export const UNREACHED: Lock = {
  title: "The program does not respond",
  text: "Start `haptorb run`, and open the address that it prints.",
};

/** So many pages that this one must wait; `reason` is the server's. */
export const full = (reason: string): Lock => ({
  title: "This page has to wait",
  text: `${sentence(reason || "Too many pages are open already")} Then it continues by itself. Use another page to stop.`,
});

/** Cover the page with `lock`, or show it again. */
export function cover(lock: Lock | null): void {
  document.body.classList.toggle("locked", lock !== null);
  at("lock").hidden = lock === null;
  if (!lock) return;
  write(at("lock-title"), lock.title);
  write(at("lock-text"), lock.text);
}

const sentence = (words: string): string => `${words[0]!.toUpperCase()}${words.slice(1)}.`;
