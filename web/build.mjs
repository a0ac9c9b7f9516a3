// Bundles the pages into the Python package, so that they load nothing from other servers.
import { build } from "esbuild";
import { cp, mkdir, readFile, rm, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";

if (process.argv.length > 3 || process.argv[2]?.startsWith("-")) {
  console.error("usage: node build.mjs [FOLDER]; without FOLDER the pages go into src");
  process.exit(2);
}
const root = process.argv[2] ?? fileURLToPath(new URL("../src/", import.meta.url));

// three.js contains the shaders of all materials as text. The pages use no physical or toon materials, no shadows and no
// tone mapping; leaving out these shaders saves 11 kB.
const CHUNKS = /^var ((?:lights_physical|lights_toon|transmission|iridescence|clearcoat|envmap_physical|shadowmap|tonemapping)\w*) = "[^"]*";$/gm;
const unusedShaders = {
  name: "unused shaders",
  setup: ({ onLoad }) =>
    onLoad({ filter: /three\.module\.js$/ }, async ({ path }) => ({
      contents: (await readFile(path, "utf8")).replace(CHUNKS, 'var $1 = "";'),
    })),
};

/** Bundle the pages of one program into the folder `out`; `documents`: [source, name, optional change of the text]. */
async function bundle(out, entryPoints, documents) {
  await rm(out, { recursive: true, force: true });
  await mkdir(out, { recursive: true });
  await build({
    entryPoints,
    absWorkingDir: fileURLToPath(new URL(".", import.meta.url)),
    outdir: out,
    bundle: true,
    minify: true,
    format: "esm",
    target: ["es2022", "chrome100", "firefox100", "safari16"],
    legalComments: "linked",
    plugins: [unusedShaders],
    logLevel: "warning",
  });
  for (const [from, name, change] of documents) {
    if (change) await writeFile(`${out}/${name}`, change(await readFile(new URL(`src/${from}`, import.meta.url), "utf8")));
    else await cp(new URL(`src/${from}`, import.meta.url), `${out}/${name}`);
  }
}

await bundle(
  `${root}/haptorb/web/console_static`,
  [
    { in: "src/main.ts", out: "console" },
    { in: "src/socket.worker.ts", out: "socket" },
    { in: "src/style.css", out: "console" },
  ],
  [["index.html", "index.html"], ["icon.svg", "icon.svg"]],
);
await bundle(
  `${root}/haptorb_study/static`,
  [
    { in: "src/study/participant.ts", out: "participant" },
    { in: "src/study/experimenter.ts", out: "experimenter" },
    { in: "src/study/study.css", out: "study" },
  ],
  [["study/participant.html", "participant.html"], ["study/experimenter.html", "experimenter.html"], ["icon.svg", "icon.svg"]],
);

// The player of a recording uses the console's document with a different script.
await bundle(
  `${root}/haptorb/web/view_static`,
  [
    { in: "src/view/view.ts", out: "view" },
    { in: "src/view/player.ts", out: "player" },
    { in: "src/view/view.css", out: "view" },
    { in: "src/view/player.css", out: "player" },
  ],
  [
    ["view/view.html", "view.html"],
    ["index.html", "player.html", (text) => text.replaceAll("static/console.", "static/player.")],
    ["icon.svg", "icon.svg"],
  ],
);

// The report has script and style inline in one file; the chooser shows the console in an iframe.
await bundle(
  `${root}/haptorb_design/static`,
  [
    { in: "src/design/report.ts", out: "report" },
    { in: "src/design/report.css", out: "report" },
    { in: "src/design/chooser.ts", out: "chooser" },
    { in: "src/design/chooser.css", out: "chooser" },
  ],
  [["design/chooser.html", "chooser.html"], ["icon.svg", "icon.svg"]],
);
