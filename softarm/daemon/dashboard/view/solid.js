// The arm in perspective, on a canvas: the outline of the side view revolved, with rail, cart, shelf, target and trail. A drag turns it.

/* global ARM_RADII_M, armOutline */
import { el, finite } from "./dom.js";

const SIDES = 14; // of the arm's cross-section
const STEPS = 6; // rings of the arm between two bodies; even, so that the tip ends in a point
const VIEW = { turn: -0.6, tilt: 0.22 }; // rad; with 0 and 0 the eye sees the side view
const TILT = [-0.3, 1.45];
const EYE_M = 2.4; // distance of the eye from the middle of the drawing
const PX_PER_RAD = 220;
const LIGHT = [0.67, -0.33, 0.67];
const AMBIENT = 0.6;
const RAIL_M = 0.014; // half of the rail's width
const CART_M = [0.045, 0.032, 0.022]; // half of the cart
const SHELF_M = [0.12, 0.006]; // half of the board's depth and thickness

// Rotate a point (x towards the reader, y along the rail, z up), in m; return [right, up, towards the eye].
export function rotate({ turn, tilt }, [x, y, z]) {
  const near = x * Math.cos(turn) + y * Math.sin(turn);
  return [y * Math.cos(turn) - x * Math.sin(turn), z * Math.cos(tilt) - near * Math.sin(tilt), near * Math.cos(tilt) + z * Math.sin(tilt)];
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => a.map((value, k) => value - b[k]);
const middle = (points) => [0, 1, 2].map((k) => points.reduce((sum, point) => sum + point[k], 0) / points.length);
const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];

// Return a face of four corners with its normal, which points away from a point inside.
function face(corners, inside) {
  const normal = cross(minus(corners[2], corners[0]), minus(corners[3], corners[1]));
  const centre = middle(corners);
  const size = (Math.hypot(...normal) || 1) * (dot(normal, minus(centre, inside)) < 0 ? -1 : 1);
  return { corners, centre, normal: normal.map((value) => value / size) };
}

// Return the faces of a box from its centre and the halves of its sides.
function box([x, y, z], [a, b, c]) {
  const corner = (i, j, k) => [x + i * a, y + j * b, z + k * c];
  const around = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
  return [-1, 1].flatMap((end) => [around.map(([i, j]) => corner(end, i, j)), around.map(([i, j]) => corner(i, end, j)), around.map(([i, j]) => corner(i, j, end))])
    .map((corners) => face(corners, [x, y, z]));
}

// Return the faces of a flat outline revolved around its middle line; its points k from the start and from the end lie opposite each other.
export function revolved(outline) {
  const rings = outline.slice(0, Math.ceil(outline.length / 2)).map(([y, z], k) => {
    const [to_y, to_z] = outline.at(-1 - k);
    const [centre_y, centre_z, half_y, half_z] = [(y + to_y) / 2, (z + to_z) / 2, (y - to_y) / 2, (z - to_z) / 2];
    const radius = Math.hypot(half_y, half_z);
    return Array.from({ length: SIDES }, (_, side) => {
      const angle = (2 * Math.PI * side) / SIDES;
      return [radius * Math.sin(angle), centre_y + half_y * Math.cos(angle), centre_z + half_z * Math.cos(angle)];
    });
  });
  return rings.slice(1).flatMap((ring, k) => {
    const inside = middle(rings[k]);
    return ring.map((_, side) => face([rings[k][side], rings[k][(side + 1) % SIDES], ring[(side + 1) % SIDES], ring[side]], inside));
  });
}

export class Solid {
  // arm: the drawing whose robot, plane and moment are shown.
  constructor(arm) {
    this.arm = arm;
    this.view = { ...VIEW };
    this.canvas = el("canvas", { class: "solid", role: "img", "aria-label": "Rail, cart, arm and target in perspective. A drag turns the view." });
    this.canvas.addEventListener("pointerdown", (event) => this.canvas.setPointerCapture(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => this.canvas.hasPointerCapture(event.pointerId) && this.turn(event.movementX, event.movementY));
    this.canvas.addEventListener("dblclick", () => this.look(VIEW));
  }

  // Height in the middle of the drawing.
  get middle_m() {
    return (this.arm.plane.top + this.arm.plane.low) / 2;
  }

  // Height of a plane under rail and cart, above arm and shelf.
  get underRail_m() {
    return this.arm.robot.hinge_z_m - CART_M[2] - 0.001;
  }

  turn(right_px, down_px) {
    const { turn, tilt } = this.view;
    this.look({ turn: turn - right_px / PX_PER_RAD, tilt: Math.min(Math.max(tilt + down_px / PX_PER_RAD, TILT[0]), TILT[1]) });
  }

  look(view) {
    this.view = { ...view };
    this.draw();
  }

  // Return a point's pixels and its pixels per metre.
  place([x, y, z]) {
    const { plane } = this.arm;
    const [right, up, near] = rotate(this.view, [x, y, z - this.middle_m]);
    const scale = (plane.scale * EYE_M) / Math.max(0.1, EYE_M - near);
    return [plane.width / 2 + right * scale, plane.bottom / 2 - up * scale, scale];
  }

  draw() {
    const { arm: { plane }, canvas } = this;
    const fine = window.devicePixelRatio || 1;
    Object.assign(canvas, { width: Math.round(plane.width * fine), height: Math.round(plane.height * fine) });
    this.style = getComputedStyle(canvas);
    this.ink = canvas.getContext("2d");
    this.ink.scale(fine, fine);
    this.drawPlane();
    this.drawFaces();
    this.drawMarks();
  }

  colour(name) {
    return this.style.getPropertyValue(`--${name}`).trim();
  }

  path(points, closed = false) {
    this.ink.beginPath();
    points.forEach((point, k) => this.ink[k ? "lineTo" : "moveTo"](...this.place(point).slice(0, 2)));
    if (closed) this.ink.closePath();
  }

  line(points, name, width_px, { closed = false, dash = [], alpha = 1 } = {}) {
    if (points.length < 2) return;
    this.path(points, closed);
    Object.assign(this.ink, { strokeStyle: this.colour(name), lineWidth: width_px, globalAlpha: alpha, lineJoin: "round" });
    this.ink.setLineDash(dash);
    this.ink.stroke();
    this.ink.globalAlpha = 1;
    this.ink.setLineDash([]);
  }

  // Draw the plane of motion with its grid of 10 cm and the frames of the soft limits.
  drawPlane() {
    const { plane, robot } = this.arm;
    const [side, low, top] = [Math.floor(plane.wide * 10) / 10, Math.ceil(plane.low * 10) / 10, Math.floor(robot.hinge_z_m * 10) / 10];
    for (let k = Math.round(-side * 10); k <= side * 10; k++) this.line([[0, k / 10, low], [0, k / 10, top]], "line", k ? 1 : 1.75);
    for (let k = Math.round(low * 10); k <= top * 10; k++) this.line([[0, -side, k / 10], [0, side, k / 10]], "line", 1);
    const z = robot.hinge_z_m;
    for (const y of robot.rail_limit_m) {
      const frame = [[-0.06, -0.05], [0.06, -0.05], [0.06, 0.05], [-0.06, 0.05]];
      this.line(frame.map(([x, up]) => [x, y, z + up]), "warning", 1.5, { closed: true, dash: [4, 3] });
    }
  }

  // Return every face of rail, shelf, cart and arm, with the name of its colour.
  faces() {
    const { robot, plane, status } = this.arm;
    const z = robot.hinge_z_m;
    const [first, last] = robot.rail_travel_m;
    const moment = this.arm.moment(status);
    const named = (name, faces) => faces.map((one) => ({ ...one, name }));
    const faces = [];
    // The rail on each side of the cart: a face as long as the rail has no order with the cart's.
    const sides = finite(moment.cart) ? [[first, moment.cart - CART_M[1]], [moment.cart + CART_M[1], last]] : [[first, last]];
    for (const [low, high] of sides) faces.push(...named("soft", box([0, (low + high) / 2, z], [RAIL_M, (high - low) / 2, RAIL_M])));
    for (const y of [first, last]) faces.push(...named("ink", box([0, y, z], [2.2 * RAIL_M, 0.006, 2.2 * RAIL_M])));
    const shelf = this.arm.shelfOf(status);
    if (shelf) faces.push(...named("board", box([0, (shelf.front_m - plane.wide) / 2, shelf.z_m - SHELF_M[1]], [SHELF_M[0], (shelf.front_m + plane.wide) / 2, SHELF_M[1]])));
    if (finite(moment.cart)) faces.push(...named("ink", box([0, moment.cart, z], CART_M)));
    const seen = moment.bodies.filter(Boolean);
    if (seen.length > 1) faces.push(...named("arm", revolved(armOutline(seen, ARM_RADII_M, STEPS)).filter((one) => !this.isRail(one)))); // its upper end is inside the cart
    return faces;
  }

  // Return whether a face is at the height of rail and cart, above arm and shelf.
  isRail({ centre }) {
    return centre[2] >= this.underRail_m;
  }

  // Draw the faces that are turned to the eye, the farthest first; of the two sides of the plane under the rail, the eye's own last.
  drawFaces() {
    const centred = ({ centre: [x, y, z] }) => rotate(this.view, [x, y, z - this.middle_m]);
    const towards = (one) => dot(rotate(this.view, one.normal), minus([0, 0, EYE_M], one.at)) > 0;
    const isEyeAbove = this.middle_m + EYE_M * Math.sin(this.view.tilt) > this.underRail_m;
    const last = (one) => Number(this.isRail(one) === isEyeAbove);
    const faces = this.faces().map((one) => ({ ...one, at: centred(one) })).filter(towards).sort((a, b) => last(a) - last(b) || a.at[2] - b.at[2]);
    const colours = Object.fromEntries(["soft", "ink", "board", "arm"].map((name) => [name, rgb(this.colour(name))]));
    for (const { corners, normal, name } of faces) {
      const light = AMBIENT + (1 - AMBIENT) * Math.max(0, dot(normal, LIGHT));
      this.ink.fillStyle = this.ink.strokeStyle = `rgb(${colours[name].map((value) => Math.round(value * light)).join(" ")})`;
      this.ink.lineWidth = 0.75; // closes the seam between two faces
      this.path(corners, true);
      this.ink.fill();
      this.ink.stroke();
    }
  }

  drawMarks() {
    const { arm } = this;
    const { status, ghost } = arm;
    const flat = ([y, z]) => [0, y, z];
    if (ghost) {
      const seen = ghost.bodies.filter(Boolean);
      if (seen.length > 1) this.line(armOutline(seen, ARM_RADII_M, STEPS).map(flat), "floor", 1.5, { closed: true, dash: [4, 3] });
      if (ghost.tip) this.line([ghost.tip, ghost.target].map(flat), "second", 2);
      const [x, down, scale] = this.place(flat(ghost.target));
      this.text(ghost.text, x, down + arm.robot.success_radius_m * scale + 16, "ink");
    }
    arm.shades().forEach((piece, k, { length }) => this.line(piece.map(flat), "measured", 1.75, { alpha: 0.75 * ((k + 1) / length) ** 1.5 }));
    const tip = status && arm.tipOf(status);
    if (tip) this.ball(tip, 0.011, "measured", 1);
    const target = arm.targetOf(status);
    if (target) this.ball([target.y_m, target.z_m], arm.robot.success_radius_m, target.state === "reached" ? "good" : "requested", 0.18, target.text);
    if (arm.aim) {
      const { text, within } = arm.aimLabel();
      this.ball([arm.aim.y_m, arm.aim.z_m], arm.robot.success_radius_m, within ? "ink" : "stop-text", 0.1, text);
    }
    if (arm.moment(status).bodies.filter(Boolean).length < 2) this.text("No motion capture", arm.plane.width / 2, arm.plane.bottom / 2, "warning");
  }

  // Draw a ball, filled with the given opacity, with a text above.
  ball([y, z], radius_m, name, alpha, text = "") {
    const [x, down, scale] = this.place([0, y, z]);
    this.ink.beginPath();
    this.ink.arc(x, down, radius_m * scale, 0, 2 * Math.PI);
    Object.assign(this.ink, { fillStyle: this.colour(name), strokeStyle: this.colour(name), globalAlpha: alpha, lineWidth: 2 });
    this.ink.fill();
    this.ink.globalAlpha = 1;
    this.ink.stroke();
    if (text) this.text(text, x, down - radius_m * scale - 6, name);
  }

  text(text, x, y, name) {
    Object.assign(this.ink, { font: `650 12px ${this.style.fontFamily}`, textAlign: "center", lineWidth: 4, strokeStyle: this.colour("panel"), fillStyle: this.colour(name) });
    this.ink.strokeText(text, x, y);
    this.ink.fillText(text, x, y);
  }
}

// Return the three values of a colour #rrggbb.
function rgb(text) {
  return [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16));
}
