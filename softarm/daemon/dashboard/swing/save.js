// A swing as one HTML file that needs no network: the page's own styles and scripts, inlined, with the data.

import { clock } from "../view/dom.js";

const ROOT = "swing/replay.js";
const IMPORT = /(from\s+)"(\.[^"]+)"/g;
const POLICY = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:";

const text = async (url) => {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: the daemon answered ${answer.status}`);
  return answer.text();
};

// Return every module that a module needs, by name, with imports by name.
async function modules(name, found = {}) {
  if (name in found) return found;
  found[name] = "";
  const source = await text(`/dashboard/${name}`);
  const named = (path) => new URL(path, `http://page/${name}`).pathname.slice(1);
  found[name] = source.replace(IMPORT, (_, from, path) => `${from}"${named(path)}"`);
  for (const [, , path] of source.matchAll(IMPORT)) await modules(named(path), found);
  return found;
}

const inlined = (code) => code.replaceAll("</script", "<\\/script");
const json = (value) => JSON.stringify(value).replaceAll("<", "\\u003c");

// Return the page of a swing as text.
async function pageOf(swing) {
  const styles = await Promise.all([...document.querySelectorAll("link[rel=stylesheet]")].map((link) => text(link.href)));
  const scripts = await Promise.all([...document.querySelectorAll("script[src]:not([type])")].map((script) => text(script.src)));
  const imports = Object.fromEntries(Object.entries(await modules(ROOT)).map(([name, code]) => [name, `data:text/javascript;charset=utf-8,${encodeURIComponent(code)}`]));
  const { y_m, z_m } = swing.goal;
  const title = `Swing${Number.isFinite(y_m) ? ` to y ${y_m}, z ${z_m} m` : ""}, ${clock(swing.at, true)}`;
  return `<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="${POLICY}">
<title>${title} · softarm</title>
<style>${styles.join("\n")}</style>
<script>${scripts.map(inlined).join("\n")}</script>
<script type="importmap">${json({ imports })}</script>
</head>
<body>
<main class="saved"><section class="card" aria-labelledby="title"><h1 id="title">${title}</h1><div id="replay"></div></section></main>
<footer>softarm ${swing.robot.version}${swing.robot.simulated ? ", simulated robot" : ""}</footer>
<script type="application/json" id="data">${json(swing)}</script>
<script type="module">
import { Replay } from "${ROOT}";
new Replay(document.getElementById("replay")).show(JSON.parse(document.getElementById("data").textContent));
</script>
</body>
</html>
`;
}

// Give the page of a swing to the browser as a download.
export async function save(swing) {
  const url = URL.createObjectURL(new Blob([await pageOf(swing)], { type: "text/html" }));
  const name = `softarm-swing-${swing.at.replace(/\..*$/, "").replace(/[-:]/g, "")}.html`;
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}
