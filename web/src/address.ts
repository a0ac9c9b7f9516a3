// Server addresses derived from the page's own, so that HTTPS, a path prefix and a forwarded port work.

/** URL of the WebSocket `path`, relative to this page; wss if the page was loaded over https. */
export function socketAddress(path: string): string {
  const url = new URL(path, document.baseURI);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return url.href;
}
