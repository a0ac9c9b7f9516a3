// Bundles the page into the Python package: two scripts, one style sheet, one document, nothing from elsewhere.
import { build } from "esbuild";
import { cp, mkdir, rm } from "node:fs/promises";
import { fileURLToPath } from "node:url";

const out = process.argv[2] ?? fileURLToPath(new URL("../src/haptorb/apps/console/static/", import.meta.url));

await rm(out, { recursive: true, force: true });
await mkdir(out, { recursive: true });
await build({
  entryPoints: [
    { in: "src/main.ts", out: "console" },
    { in: "src/socket.worker.ts", out: "socket" },
    { in: "src/style.css", out: "console" },
  ],
  absWorkingDir: fileURLToPath(new URL(".", import.meta.url)),
  outdir: out,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["es2022", "chrome100", "firefox100", "safari16"],
  legalComments: "linked",
  logLevel: "warning",
});
await cp(new URL("src/index.html", import.meta.url), `${out}/index.html`);
await cp(new URL("src/icon.svg", import.meta.url), `${out}/icon.svg`);
