// The replay of one swing: the arm in slow motion with its closest moment, the result in words, and charts on the same time.
// Needs nothing from the daemon: a saved swing is this module with its data.

/* global spotBetween */
import { Arm } from "../view/arm.js";
import { Charts, ROBOT } from "../view/chart.js";
import { el, finite, number, sentence, setText, worded } from "../view/dom.js";
import { bodyColumns } from "./cut.js";

const SPEEDS = [["1", 1], ["1/2", 0.5], ["1/4", 0.25], ["1/10", 0.1]];
const SPEED = "1/4";
const TRAIL_S = 1.5;
const TRAIL_STEP_S = 1 / 40;
const FRAME_S = [0.03, 0.1]; // the shortest between two pictures; a longer one counts as the longest

const DISTANCE = { title: "Distance of the tip to the target", unit: "cm", digits: 1, span: [0, 10], lines: [["distance_cm", "tip", "measured"], ["limit_cm", "reached within", "good"]] };
const OUTCOMES = { reached: "✓ Reached", failed: "✕ Missed", cancelled: "– Cancelled" };

class SwingCharts extends Charts {
  constructor(place) {
    super(place, [DISTANCE, ...ROBOT], "swing", "curve");
    this.build();
  }

  show(swing) {
    this.swing = swing;
    this.view = null;
    const { t, goal, robot, curves } = swing;
    const distance = t.map((_, k) => Math.hypot(curves.tip_y_m[k] - goal.y_m, curves.tip_z_m[k] - goal.z_m) * 100);
    const whole = { ...curves, distance_cm: distance.map((cm, k) => (finite(cm) && curves.tip_y_m[k] !== null ? cm : null)), limit_cm: t.map(() => robot.success_radius_m * 100) };
    this.charts[0].figure.hidden = goal.kind !== "reach";
    this.charts.forEach((chart) => chart.show(t, whole));
  }

  whole() {
    return this.swing?.charts ?? [0, 1];
  }

  label(time, digits) {
    return `${number(time, digits)} s`;
  }

  marks() {
    return this.swing ? [{ at: 0, kind: "began" }, { at: this.swing.ended, kind: this.swing.state }] : [];
  }

  // Show a moment: the line in every chart, and its values while the pointer is elsewhere.
  moment(time) {
    this.time = time;
    this.charts.forEach((chart) => chart.setNow(time));
    this.read();
  }

  read() {
    this.charts.forEach((chart) => chart.read(this.at ?? this.time ?? null));
  }
}

export class Replay {
  constructor(place) {
    this.words = el("p", { class: "result" });
    this.drawing = el("div", { class: "drawing still" });
    this.button = el("button", { type: "button", class: "small play", onclick: () => this.play(!this.playing) });
    this.speed = el("select", { "aria-label": "Speed of the replay" }, SPEEDS.map(([text, value]) => el("option", { value, selected: text === SPEED }, `${text} ×`)));
    this.slider = el("input", { type: "range", step: 0.005, "aria-label": "Time since the request" });
    this.clock = el("output", { class: "clock" });
    this.slider.addEventListener("input", () => {
      this.play(false);
      this.go(this.slider.valueAsNumber);
    });
    const charts = el("div", { class: "plots" });
    place.replaceChildren(this.words, this.drawing, el("div", { class: "transport" }, this.button, this.speed, this.slider, this.clock), charts);
    this.charts = new SwingCharts(charts);
    this.onScreen = true;
    new IntersectionObserver(([entry]) => { this.onScreen = entry.isIntersecting; }).observe(this.drawing);
  }

  // Show a swing from its start; a user who wants little motion gets the closest moment instead.
  show(swing) {
    this.swing = swing;
    const { robot, goal, closest } = swing;
    if (this.arm) this.arm.setRobot(robot);
    else {
      this.arm = new Arm(this.drawing, robot);
      this.clock.after(this.arm.solidButton());
    }
    const text = closest && `closest ${number(closest.m * 100, 1)} cm`;
    this.columns = bodyColumns(swing);
    const tip = closest && spotBetween(swing.t, [swing.curves.tip_y_m, swing.curves.tip_z_m], closest.at);
    this.arm.setGhost(closest && { bodies: this.bodies(closest.at), tip, target: [goal.y_m, goal.z_m], text });
    this.words.className = `result ${swing.state}`;
    this.words.replaceChildren(el("b", {}, OUTCOMES[swing.state] ?? swing.state), ` ${meaning(swing)}`);
    Object.assign(this.slider, { min: swing.from, max: swing.to });
    this.charts.show(swing);
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.go(still && closest ? closest.at : swing.from);
    this.play(!still);
  }

  bodies(time) {
    return this.columns.map((columns) => spotBetween(this.swing.t, columns, time));
  }

  go(time) {
    const { swing } = this;
    this.time = time;
    const steps = Math.floor((time - Math.max(swing.t[0], time - TRAIL_S)) / TRAIL_STEP_S);
    this.arm.trail = Array.from({ length: steps }, (_, k) => spotBetween(swing.t, this.columns.at(-1), time - (steps - 1 - k) * TRAIL_STEP_S));
    const state = time < swing.ended ? "running" : swing.state;
    this.arm.draw({ tick: Math.round(time * 1000), bodies: this.bodies(time), goal: { goal: swing.goal, state } });
    this.charts.moment(time);
    this.slider.value = time;
    const said = `${number(time, 2)} s`;
    this.slider.setAttribute("aria-valuetext", said);
    setText(this.clock, said);
  }

  play(on) {
    this.playing = on;
    setText(this.button, on ? "Pause" : "Play");
    if (!on || this.frame) return;
    this.painted = null;
    this.frame = requestAnimationFrame((now) => this.advance(now));
  }

  // Advance by the time since the last frame; start again after the end.
  advance(now) {
    this.frame = null;
    if (!this.playing) return;
    this.frame = requestAnimationFrame((then) => this.advance(then));
    const passed = (now - (this.painted ?? now)) / 1000;
    if (this.painted !== null && passed < FRAME_S[0]) return;
    this.painted = now;
    const { from, to } = this.swing;
    const next = this.time + Math.min(passed, FRAME_S[1]) * Number(this.speed.value);
    if (this.onScreen) this.go(next > to ? from : next);
  }
}

// Return what a result means: the rule of the goal, and how near the tip came.
function meaning({ goal, state, text, robot, closest }) {
  const cm = number(robot.success_radius_m * 100, 1).replace(".0", "");
  const near = closest ? ` Closest: ${number(closest.m * 100, 1)} cm, ${number(closest.at, 2)} s after the request.` : "";
  const why = sentence(worded(text));
  if (goal.kind !== "reach") return state === "reached" ? "The policy has flown its whole episode." : `${why}.`;
  if (state === "reached") return `The tip came within ${cm} cm of the target. Passing through counts: the tip need not stay.${near}`;
  if (state === "failed") return `${why}. The tip has to come within ${cm} cm in ${number(robot.time_limit_s, 2)} s; passing through counts.${near}`;
  return `The goal ended before a result: ${worded(text)}.${near}`;
}
