// The static part of the drawing: plane, rail with its limits, reachable area.

import { svg, number } from "./dom.js";

const HALF_WIDTH_M = 0.74; // visible on each side of the rail's centre
const NARROW_PX = 520;
const LOW_M = 0.44; // lower edge of the drawing
const ABOVE_M = 0.075; // visible above the rail
const AXIS_PX = 46; // height of the axis below

// Converts metres to pixels of a drawing of the given width.
export class Plane {
  constructor(width, robot) {
    this.width = width;
    this.narrow = width < NARROW_PX;
    this.wide = this.narrow ? 0.86 * HALF_WIDTH_M : HALF_WIDTH_M;
    this.scale = width / (2 * this.wide);
    this.top = robot.hinge_z_m + ABOVE_M;
    this.bottom = this.v(LOW_M);
    this.height = Math.round(this.bottom + AXIS_PX);
    this.low = LOW_M;
  }

  h(y_m) {
    return this.width / 2 + y_m * this.scale;
  }

  v(z_m) {
    return (this.top - z_m) * this.scale;
  }

  // Return the point in metres, rounded to the millimetre.
  at(x, y) {
    const round = (value) => Math.round(value * 1000) / 1000;
    return { y_m: round((x - this.width / 2) / this.scale), z_m: round(this.top - y / this.scale) };
  }
}

// Return whether a target looks reachable. The daemon decides; this only styles the aim.
export function withinReach(robot, y_m, z_m) {
  const { y_min_m, y_max_m, z_min_m, z_max_m } = robot.workspace;
  const [low, high] = robot.rail_limit_m;
  const nearest = Math.min(Math.max(y_m, low), high);
  const far = Math.hypot(y_m - nearest, z_m - robot.hinge_z_m) > robot.reach_m;
  return y_m >= y_min_m && y_m <= y_max_m && z_m >= z_min_m && z_m <= z_max_m && !far;
}

// Return the outline of the reachable workspace as an SVG path.
function reachable(robot, plane) {
  const { y_min_m, y_max_m, z_min_m, z_max_m } = robot.workspace;
  const [low, high] = robot.rail_limit_m;
  const reach = robot.reach_m;
  const top = [];
  const below = [];
  for (let k = 0; k <= 160; k++) {
    const y = y_min_m + (k / 160) * (y_max_m - y_min_m);
    const aside = Math.max(low - y, y - high, 0);
    if (aside > reach) continue;
    const deep = Math.sqrt(reach * reach - aside * aside);
    const from = Math.max(z_min_m, robot.hinge_z_m - deep);
    const to = Math.min(z_max_m, robot.hinge_z_m + deep);
    if (from > to) continue;
    top.push([y, to]);
    below.unshift([y, from]);
  }
  return `M${[...top, ...below].map(([y, z]) => `${plane.h(y).toFixed(1)} ${plane.v(z).toFixed(1)}`).join("L")}Z`;
}

function grid(plane) {
  const parts = [];
  const { narrow } = plane;
  const step = narrow ? 2 : 1;
  for (let k = -7; k <= 7; k++) {
    const x = plane.h(k / 10);
    parts.push(svg("line", { class: k === 0 ? "grid zero" : "grid", x1: x, x2: x, y1: 0, y2: plane.bottom }));
    if (k % (2 * step) === 0) parts.push(svg("text", { x, y: plane.bottom + 15, "text-anchor": "middle" }, number(k / 10, 1, "", true)));
  }
  for (let k = Math.ceil(plane.low * 10); k / 10 < plane.top; k++) {
    const y = plane.v(k / 10);
    parts.push(svg("line", { class: "grid", x1: 0, x2: plane.width, y1: y, y2: y }));
    if (k % step === 0 || !narrow) parts.push(svg("text", { x: 4, y: y - 3 }, k === 10 ? "1.0 m, z up" : number(k / 10, 1)));
  }
  const foot = plane.bottom + 34;
  parts.push(
    svg("text", { class: "axis", x: plane.width / 2, y: foot, "text-anchor": "middle" }, narrow ? "− ← y, m → +" : "− ←   y along the rail, m   → +"),
    narrow ? null : svg("text", { class: "axis", x: 4, y: foot }, "← pressure bends this way"),
  );
  return parts;
}

function rail(robot, plane) {
  const z = plane.v(robot.hinge_z_m);
  const [low, high] = robot.rail_limit_m;
  const [first, last] = robot.rail_travel_m;
  const tall = Math.max(9, 0.022 * plane.scale);
  const soft = [low, high].map((y) => svg("line", { class: "soft-limit", x1: plane.h(y), x2: plane.h(y), y1: z - 2 * tall, y2: z + 1.3 * tall }));
  const hard = [first, last].map((y, k) =>
    svg("rect", { class: "hard-limit", x: plane.h(y) - (k ? 0 : 6), y: z - tall, width: 6, height: 2 * tall }));
  const limits = `soft limits ${number(low, 2, "", true)} and ${number(high, 2, "", true)} m, end stops ${number(first, 2, "", true)} and ${number(last, 2, "", true)} m`;
  return [
    svg("title", {}, `Rail: ${limits}`),
    svg("line", { class: "rail", x1: plane.h(first), x2: plane.h(last), y1: z, y2: z }),
    ...hard,
    ...soft,
    plane.narrow ? null : svg("text", { x: plane.h(low) - 4, y: z - 1.2 * tall, "text-anchor": "end" }, "soft limit"),
    plane.narrow ? null : svg("text", { x: plane.h(last) + 12, y: z + 4 }, "end stop"),
  ];
}

// Return the static drawing as one group. trained: the policy's {target_y_m, target_z_m}, or null.
export function scene(robot, plane, trained) {
  const able = reachable(robot, plane);
  const parts = [...grid(plane), svg("path", { class: "within-reach", d: able })];
  if (trained) {
    const [left, right] = trained.target_y_m.map((y) => plane.h(y));
    const [low, high] = trained.target_z_m.map((z) => plane.v(z));
    parts.push(svg("clipPath", { id: "able" }, svg("path", { d: able })), svg("rect", { class: "trained", x: left, y: high, width: right - left, height: low - high, "clip-path": "url(#able)" }));
  }
  return svg("g", {}, parts, svg("g", {}, rail(robot, plane)));
}
