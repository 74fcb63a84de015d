// The drawing of the arm from motion capture, updated with every status; also of the moments of a swing. From the side, or in perspective.

/* global ARM_RADII_M, GOAL_WORDS, armOutline */
import { el, svg, finite, number } from "./dom.js";
import { Plane, scene, withinReach } from "./scene.js";
import { Solid } from "./solid.js";

const TRAIL = 90; // positions of the tip
const SHADES = 6; // steps of opacity along the trail

export class Arm {
  constructor(place, robot) {
    this.place = place;
    this.robot = robot;
    this.trail = [];
    this.trained = null;
    this.aim = null;
    this.ghost = null;
    this.solid = null;
    new ResizeObserver(() => this.layOut()).observe(place);
    this.layOut();
  }

  // Draw everything again after a change of width, robot or policy.
  layOut() {
    const width = Math.max(280, Math.round(this.place.clientWidth));
    const plane = (this.plane = new Plane(width, this.robot));
    this.radii = ARM_RADII_M.map((radius) => radius * plane.scale);
    const thick = Math.max(5, 0.02 * plane.scale);
    const part = (tag, name, rest = {}) => (this[name] = svg(tag, { class: name, ...rest }));
    this.paths = Array.from({ length: SHADES }, (_, k) => svg("path", { class: `trail t${k}` }));
    const cart = { x: -0.03 * plane.scale, y: -0.6 * thick - 4, width: 0.06 * plane.scale, height: 1.2 * thick + 8, rx: 4 };
    this.joints = Array.from({ length: 4 }, () => svg("circle", { class: "joint", r: thick * 0.32 }));
    this.drawn = svg("svg", { viewBox: `0 0 ${width} ${plane.height}`, width, height: plane.height, role: "img", "aria-label": "Side view of rail, cart, arm and target" },
      scene(this.robot, plane, this.trained),
      part("rect", "shelf", { visibility: "hidden", height: 6 }),
      part("g", "closest"), part("polygon", "links"), part("g", "cart"), this.joints, this.paths,
      part("g", "goal", { visibility: "hidden" }),
      part("circle", "tip", { r: Math.max(4, thick * 0.5), visibility: "hidden" }),
      part("text", "no-arm", { x: width / 2, y: plane.v(0.8), "text-anchor": "middle" }),
      part("g", "preview", { visibility: "hidden" }));
    this.cart.append(svg("rect", cart));
    this.drawn.toggleAttribute("hidden", this.solid !== null);
    this.place.replaceChildren(this.drawn, ...(this.solid ? [this.solid.canvas] : []));
    this.ring(this.goal, "target");
    this.ring(this.preview, "aim");
    this.setGhost(this.ghost);
    if (this.status) this.draw(this.status);
    else this.solid?.draw();
    this.point(this.aim);
  }

  // Return a button that shows the arm in perspective instead of from the side.
  solidButton() {
    const button = el("button", { type: "button", class: "small", "aria-pressed": "false", title: "Show the arm in perspective. A drag turns it, a double click turns it back." }, "3D");
    button.addEventListener("click", () => {
      this.solid = this.solid ? null : new Solid(this);
      button.setAttribute("aria-pressed", String(this.solid !== null));
      this.layOut();
    });
    return button;
  }

  // Add a cross, a circle with the success radius and a label.
  ring(group, kind) {
    const r = Math.max(5, this.robot.success_radius_m * this.plane.scale);
    group.append(svg("circle", { class: kind, r }), svg("path", { class: kind, d: `M-5 0H5M0-5V5` }), svg("text", { class: kind, y: -r - 6, "text-anchor": "middle" }));
  }

  move(group, y_m, z_m, text, state) {
    const x = this.plane.h(y_m);
    group.setAttribute("visibility", "visible");
    group.setAttribute("transform", `translate(${x.toFixed(1)} ${this.plane.v(z_m).toFixed(1)})`);
    group.dataset.state = state;
    const label = group.querySelector("text");
    label.textContent = text;
    const half = 3.4 * text.length;
    label.setAttribute("x", Math.min(Math.max(0, half - x + 4), this.plane.width - half - x - 4).toFixed(1));
  }

  // Use another robot's limits.
  setRobot(robot) {
    this.robot = robot;
    this.layOut();
  }

  // Shade the range of targets that the policy was trained on.
  setTrained(trained) {
    if (JSON.stringify(trained) === JSON.stringify(this.trained)) return;
    this.trained = trained;
    this.layOut();
  }

  // Show the aim, or hide it if null.
  point(aim) {
    if (!aim && !this.aim) return;
    this.aim = aim;
    this.solid?.draw();
    if (!aim) return void this.preview.setAttribute("visibility", "hidden");
    const { text, within } = this.aimLabel();
    this.move(this.preview, aim.y_m, aim.z_m, text, within ? "within" : "out");
  }

  // Return the label of the aim, and whether it looks reachable.
  aimLabel() {
    const { y_m, z_m } = this.aim;
    const within = withinReach(this.robot, y_m, z_m);
    return { text: `y ${number(y_m, 3)}  z ${number(z_m, 3)} m${within ? "" : "  out of reach"}`, within };
  }

  // Add the tip of every status to the trail, also of those that are not drawn.
  take(status) {
    this.trail.push(this.tipOf(status));
    if (this.trail.length > TRAIL) this.trail.shift();
  }

  tipOf({ bodies, observed }) {
    const [y, z] = bodies?.[5] ?? observed?.values.slice(2, 4) ?? [];
    return finite(y) && finite(z) ? [y, z] : null;
  }

  draw(status) {
    this.status = status;
    this.drawn.dataset.tick = status.tick;
    if (this.solid) return void this.solid.draw();
    const { bodies, cart } = this.moment(status);
    const tip = this.tipOf(status);
    this.cart.setAttribute("visibility", finite(cart) ? "visible" : "hidden");
    if (finite(cart)) this.cart.setAttribute("transform", `translate(${this.plane.h(cart).toFixed(1)} ${this.plane.v(this.robot.hinge_z_m).toFixed(1)})`);
    const outline = this.outline(bodies);
    this.links.setAttribute("points", outline);
    this.joints.forEach((joint, k) => this.dot(joint, bodies[k + 1]));
    this.dot(this.tip, tip);
    this["no-arm"].textContent = outline ? "" : "No motion capture";
    this.drawTrail();
    this.showGoal(this.targetOf(status));
    this.drawShelf(this.shelfOf(status));
  }

  // Return the tracked bodies, null where one is not, and the cart's position in m; of no status, none.
  moment(status) {
    const bodies = (status?.bodies ?? []).map((body) => (body && finite(body[0]) && finite(body[1]) ? body : null));
    return { bodies, cart: bodies[0]?.[0] ?? status?.observed?.values[0] ?? status?.rail_position_m };
  }

  // Return the outline of the arm as the points of a polygon; empty if fewer than two bodies are tracked.
  outline(bodies) {
    const seen = bodies.filter(Boolean);
    const outline = seen.length < 2 ? [] : armOutline(seen.map(([y, z]) => [this.plane.h(y), this.plane.v(z)]), this.radii);
    return outline.map((at) => at.map((px) => px.toFixed(1)).join(",")).join(" ");
  }

  // Show the arm at another moment, with the tip's distance to the target: {bodies, tip, target, text}; hide it if null.
  setGhost(ghost) {
    this.ghost = ghost;
    if (!ghost) return void this.closest.replaceChildren();
    const [x, y] = this.px(ghost.target).split(",").map(Number);
    const below = y + Math.max(5, this.robot.success_radius_m * this.plane.scale) + 16;
    this.closest.replaceChildren(
      svg("polygon", { class: "ghost", points: this.outline(ghost.bodies) }),
      svg("path", { class: "ghost", d: `M${this.px(ghost.tip)}L${this.px(ghost.target)}` }),
      svg("text", { class: "ghost", x, y: below, "text-anchor": "middle" }, ghost.text));
  }

  px([y, z]) {
    return `${this.plane.h(y).toFixed(1)},${this.plane.v(z).toFixed(1)}`;
  }

  dot(circle, at) {
    circle.setAttribute("visibility", at ? "visible" : "hidden");
    if (!at) return;
    circle.setAttribute("cx", this.plane.h(at[0]).toFixed(1));
    circle.setAttribute("cy", this.plane.v(at[1]).toFixed(1));
  }

  // Return the positions of the tip in pieces of one opacity, the oldest first.
  shades() {
    const each = TRAIL / SHADES;
    const from = TRAIL - this.trail.length;
    return Array.from({ length: SHADES }, (_, k) => this.trail.slice(Math.max(0, k * each - from - 1), Math.max(0, (k + 1) * each - from)).filter(Boolean));
  }

  drawTrail() {
    this.shades().forEach((piece, k) => this.paths[k].setAttribute("d", piece.length > 1 ? `M${piece.map((at) => this.px(at)).join("L")}` : ""));
  }

  // Return the shelf next to the target, front edge on the +y side: {front_m, z_m}; null if there is none.
  shelfOf(status) {
    const target = this.targetOf(status);
    const depth_m = status?.policy_info?.shelf_depth_m;
    if (!target || !finite(depth_m)) return null;
    return { front_m: target.y_m + depth_m, z_m: target.z_m - (this.robot.shelf_board_below_m ?? 0) };
  }

  drawShelf(shelf) {
    this.shelf.setAttribute("visibility", shelf ? "visible" : "hidden");
    if (!shelf) return;
    const [left, right] = [this.plane.h(-this.plane.wide), this.plane.h(shelf.front_m)];
    this.shelf.setAttribute("x", left);
    this.shelf.setAttribute("width", Math.max(0, right - left).toFixed(1));
    this.shelf.setAttribute("y", this.plane.v(shelf.z_m).toFixed(1));
  }

  // Return the target of a reach goal: {y_m, z_m, state, text}; null if there is none.
  targetOf(status) {
    const { goal, state } = status?.goal ?? {};
    if (goal?.kind !== "reach" || !finite(goal.y_m)) return null;
    return { y_m: goal.y_m, z_m: goal.z_m, state, text: GOAL_WORDS[state] ?? state };
  }

  showGoal(target) {
    if (!target) return void this.goal.setAttribute("visibility", "hidden");
    this.move(this.goal, target.y_m, target.z_m, target.text, target.state);
  }
}
