// DOM elements, numbers and texts. Texts of the daemon never become markup.

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

// Set a text only if it differs, which keeps selections and does not trigger screen readers.
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// Replace the children only if the key has changed.
export function render(node, key, make) {
  const shown = JSON.stringify(key);
  if (node.dataset.shown === shown) return;
  node.dataset.shown = shown;
  node.replaceChildren(...[make()].flat().filter(Boolean));
}

// Replace the children that differ and keep the equal ones and those of the same data-key, wherever they stand now. A click on an element that is replaced
// while the button is down is lost.
export function update(node, children) {
  const unused = [...node.children];
  const kept = children.map((child) => {
    const index = unused.findIndex((old) => alike(old, child));
    return index < 0 ? child : unused.splice(index, 1)[0];
  });
  for (const old of unused) old.remove();
  let next = node.firstElementChild; // the first old child that is not yet placed
  kept.forEach((child, k) => {
    if (child === next) next = next.nextElementSibling;
    else node.insertBefore(child, next);
    if (child !== children[k] && (child.tagName === "UL" || child.dataset.key)) update(child, [...children[k].children]);
  });
}

const alike = (old, child) => (old.tagName === "UL" && child.tagName === "UL") || (old.dataset.key && old.dataset.key === child.dataset.key) || old.isEqualNode(child);

export const finite = (value) => typeof value === "number" && Number.isFinite(value);

// Format a number with its unit; a missing value becomes a dash.
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
  // Browsers disagree on the date format of a locale.
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((part) => String(part).padStart(2, "0")).join("-");
  return `${day} ${hours}`;
}

// The daemon's messages name verbs and requests; the page names its buttons.
const HERE = [
  [/run `softarm acknowledge` or press Acknowledge on the dashboard/g, "press Acknowledge"],
  [/arm it first \(`softarm arm`, or Arm on the dashboard\)/g, "press Arm first"],
  [/`softarm policy use NAME`, or Policies on the dashboard/g, "under Policies"],
  [/`softarm goal cancel`, or Cancel goal on the dashboard/g, "press Cancel goal"],
  [/GET \/api\/policies lists/g, "Policies lists"],
];
export const worded = (text) => HERE.reduce((worded, [request, button]) => worded.replace(request, button), text);
// Capitalise the first letter, unless the text starts with a key of the API.
export const sentence = (text) => (/^[a-z]+(?![a-z]*[_:=])\b/.test(text) && !/^[yz] /.test(text) ? text.charAt(0).toUpperCase() + text.slice(1) : text);
// Return the reasons of a refusal, or the error, as sentences.
export const words = (error) => (error.reasons ?? [String(error)]).map((one) => sentence(worded(one))).join(". ");
