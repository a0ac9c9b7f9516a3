// Full-page notice that replaces the page while it cannot be used: the reason, and what to do.

import { at, write } from "./dom";

export interface PageNotice {
  title: string;
  text: string;
}

export const MISSING_TOKEN: PageNotice = {
  title: "Open the address that the terminal printed",
  text:
    "Open the full address, with the part after the #. It changes with every start; only a page that has it can move the " +
    "device.",
};

export const NO_RESPONSE: PageNotice = {
  title: "The program does not respond",
  text: "Start `haptorb run`, and open the address that it prints.",
};

/** Notice for a page that the server rejected because too many are open; `reason` is the server's. */
export const tooManyPages = (reason: string): PageNotice => ({
  title: "This page has to wait",
  text: `${sentence(reason || "Too many pages are open already")} Then it continues by itself. Use another page to stop.`,
});

/** Show `notice` instead of the page; null: show the page. */
export function coverPage(notice: PageNotice | null): void {
  document.body.classList.toggle("locked", notice !== null);
  at("lock").hidden = notice === null;
  if (!notice) return;
  write(at("lock-title"), notice.title);
  write(at("lock-text"), notice.text);
}

const sentence = (words: string): string => `${words[0]!.toUpperCase()}${words.slice(1)}.`;
