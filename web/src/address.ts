/** Where the server is as this page reaches it: through HTTPS, below a path prefix, at another port. */

/** The address of the socket `path`, relative to this page: wss where the page came by https. */
export function socketAddress(path: string): string {
  const url = new URL(path, document.baseURI);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return url.href;
}
