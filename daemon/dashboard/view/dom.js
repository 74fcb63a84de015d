// Elements and the numbers in them. Text is set as text: nothing that the daemon says becomes markup.

const SVG = "http://www.w3.org/2000/svg";

function fill(node, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

export const $ = (id) => document.getElementById(id);
export const el = (tag, properties = {}, ...children) => fill(document.createElement(tag), properties, children);
export const svg = (tag, properties = {}, ...children) => fill(document.createElementNS(SVG, tag), properties, children);

// Sets a text only if it is another one: screen readers and selections are left alone.
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// Replaces children only if what they show has changed.
export function show(node, key, make) {
  const told = JSON.stringify(key);
  if (node.dataset.shown === told) return;
  node.dataset.shown = told;
  node.replaceChildren(...[make()].flat().filter(Boolean));
}

export const finite = (value) => typeof value === "number" && Number.isFinite(value);

// A number with its unit; what is missing is a dash.
export function number(value, digits, unit = "", signed = false) {
  if (!finite(value)) return "–";
  let text = value.toFixed(digits);
  if (Number(text) === 0) text = text.replace("-", "");
  text = text.replace("-", "−");
  if (signed && Number(value.toFixed(digits)) > 0) text = `+${text}`;
  return unit ? `${text} ${unit}` : text;
}

export const seconds = (value) => (value < 60 ? number(value, 1, "s") : value < 3600 ? `${Math.floor(value / 60)} min ${Math.floor(value % 60)} s` : `${number(value / 3600, 1)} h`);

export function bytes(value) {
  if (!finite(value)) return "–";
  for (const [size, unit, digits] of [[1e9, "GB", 1], [1e6, "MB", 1], [1e3, "kB", 0]]) if (value >= size) return number(value / size, digits, unit);
  return `${value} B`;
}

export function clock(time, withDay = false) {
  const date = new Date(time);
  if (Number.isNaN(date.valueOf())) return "–";
  const hours = date.toLocaleTimeString("en-GB");
  const today = date.toDateString() === new Date().toDateString();
  if (today && !withDay) return hours;
  // Spelt out: browsers do not agree on how a locale writes a day.
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((part) => String(part).padStart(2, "0")).join("-");
  return `${day} ${hours}`;
}

// What the daemon says to programs, said to a person at this page.
const HERE = [
  [/POST \/api\/acknowledge/g, "press Acknowledge"],
  [/choose another with PUT \/api\/policy/g, "choose another under Policies"],
  [/GET \/api\/policies lists/g, "Policies lists"],
  [/see GET \/api\/health; /g, ""],
  [/POST \/api\/arm/g, "press Arm"],
];
export const worded = (text) => HERE.reduce((said, [program, person]) => said.replace(program, person), text);
// With a capital letter, unless a name of the API begins it.
export const sentence = (text) => (/^[a-z]+(?![a-z]*[_:=])\b/.test(text) && !/^[yz] /.test(text) ? text.charAt(0).toUpperCase() + text.slice(1) : text);
