// Every produced file loaded and posed by three.js in headless Chromium: each vertex must land where our own linear blend
// skinning puts it, within 1e-4 of the character's height.
//
//   node threejs.mjs FOLDER

import { existsSync, readFileSync } from "node:fs";
import { createServer } from "node:http";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { readCases, report } from "./cases.mjs";

const TOLERANCE = 1e-4; // of the height
const HERE = path.dirname(fileURLToPath(import.meta.url));
const BROWSERS = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".glb": "model/gltf-binary", ".gltf": "model/gltf+json" };

/** Serves the page, three.js and the folder of outputs on a free port of this machine. */
function serve(folder) {
  const roots = { "/page/": HERE, "/three/": path.join(HERE, "node_modules/three"), "/outputs/": folder };
  const server = createServer((request, response) => {
    const url = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    const prefix = Object.keys(roots).find((candidate) => url.startsWith(candidate));
    const file = prefix && path.join(roots[prefix], url.slice(prefix.length));
    if (!file || !file.startsWith(roots[prefix]) || !existsSync(file)) {
      response.writeHead(404).end();
      return;
    }
    response.writeHead(200, { "content-type": TYPES[path.extname(file)] ?? "application/octet-stream" });
    response.end(readFileSync(file));
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

function launch() {
  const executablePath = BROWSERS.find((candidate) => candidate && existsSync(candidate));
  if (!executablePath) {
    console.error("Chromium was not found: `apt-get install chromium`, or set CHROMIUM to a Chrome or Chromium program.");
    process.exit(1);
  }
  // The second line keeps the browser from calling home, which a closed network refuses many times a second.
  const args = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
    "--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync"];
  return chromium.launch({ executablePath, headless: true, args });
}

async function check(page, { name, output, pose }, folder) {
  if (!pose) return { name, problems: ["no pose was made for it"] };
  const expected = JSON.parse(readFileSync(path.join(folder, pose), "utf8"));
  try {
    const measured = await page.evaluate(([url, pose]) => window.measurePose(url, pose), [`/outputs/${output}`, expected]);
    if (measured.problem) return { name, problems: [measured.problem] };
    const relative = measured.largest / expected.height;
    if (!(relative <= TOLERANCE)) return { name, problems: [`a vertex is ${relative.toExponential(2)} of the height away`] };
    return { name, problems: [], relative };
  } catch (error) {
    return { name, problems: [String(error.message).split("\n")[0]] };
  }
}

const { folder, cases } = readCases(process.argv);
const server = await serve(folder);
const browser = await launch();
const page = await browser.newPage();
const results = [];
try {
  await page.goto(`http://127.0.0.1:${server.address().port}/page/threejs.html`);
  await page.waitForFunction(() => window.ready === true, null, { timeout: 30_000 });
  for (const item of cases) results.push(await check(page, item, folder));
} finally {
  await browser.close();
  server.close();
}
const worst = Math.max(0, ...results.map((result) => result.relative ?? 0));
console.log(`three.js: largest distance ${worst.toExponential(2)} of the height over ${results.length} files`);
report("three.js", results);
