// Charts of the last seconds or minutes, with the begin and end of every goal. A zoomed chart does not move.

import { el, number, setText } from "./dom.js";
import { Charts, ROBOT, markKey, nearest } from "./chart.js";

const WINDOWS_S = [3, 10, 60, 600];
const EVERY_MS = 100; // of the windows up to a minute
const LOOP = [
  { title: "Control tick", unit: "ms", digits: 2, span: [0, 5], lines: [["late_ms", "late", "measured"], ["policy_ms", "policy", "second"]] },
  { title: "Age of readings", unit: "ms", digits: 1, span: [0, 40], lines: [["mocap_age_ms", "cameras", "measured"], ["pressure_age_ms", "pressure", "second"], ["rail_age_ms", "rail", "floor"]] },
];

export class LiveCharts extends Charts {
  // goals() returns every goal with its request and end.
  constructor(place, { title, windows, note }, history, goals) {
    super(place, [...ROBOT, ...LOOP], "live", "plot");
    Object.assign(this, { title, note, history, goals });
    this.seconds = 60;
    this.paused = false;
    this.drawn = 0;
    this.buttons = WINDOWS_S.map((seconds) => el("button", { type: "button", class: "small", "data-seconds": seconds, onclick: () => this.choose(seconds) }, inWords(seconds)));
    windows.append(...this.buttons);
    place.after(markKey());
    this.choose(this.seconds);
    this.build();
  }

  // Show another number of seconds; the daemon stores more than the page has loaded.
  choose(seconds) {
    this.seconds = seconds;
    setText(this.title, `Last ${inWords(seconds)}`);
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.seconds === String(seconds)));
    this.zoom(null);
    this.history.cover(seconds).then(() => (this.paused ? this.take() : this.draw(true)));
  }

  pause(paused) {
    this.paused = paused;
    this.draw(true);
  }

  zoom(view) {
    super.zoom(view);
    this.draw(true);
  }

  // Draw the new rows, at most ten times a second; nothing while paused or zoomed.
  draw(now = false) {
    const every = EVERY_MS * Math.max(1, this.seconds / 60);
    if (document.hidden || this.paused || this.view || (!now && performance.now() - this.drawn < every)) return void this.read();
    this.take();
  }

  // Draw the rows of the window.
  take() {
    this.drawn = performance.now();
    const { time } = this.history.columns;
    this.newest = this.paused ? this.newest : this.history.newest;
    const first = Math.max(0, time.findIndex((at) => at >= this.newest - this.seconds));
    const after = time.findIndex((at) => at > this.newest);
    const last = after < 0 ? time.length : after;
    this.ages = time.slice(first, last).map((at) => at - this.newest);
    const columns = Object.fromEntries(Object.entries(this.history.columns).map(([name, column]) => [name, column.slice(first, last)]));
    this.place.dataset.seconds = this.ages.length ? (-this.ages[0]).toFixed(1) : "0";
    this.charts.forEach((chart) => chart.show(this.ages, columns));
    this.read();
  }

  whole() {
    return [-this.seconds, 0];
  }

  label(time, digits) {
    return time === 0 ? "now" : `${number(time, digits)} s`;
  }

  marks() {
    const at = (event) => Date.parse(event.time) / 1000 - this.newest;
    return this.goals().flatMap(({ request, end }) => [{ at: at(request), kind: "began" }, ...(end ? [{ at: at(end), kind: end.what }] : [])]);
  }

  read() {
    super.read();
    if (typeof uPlot === "undefined") return void setText(this.note, "The chart library did not load. Reload the page.");
    const age = this.at === null || !this.ages?.length ? undefined : this.ages[nearest(this.ages, this.at)];
    const held = this.paused ? "the pause" : this.view ? "the zoom" : "now";
    const when = age === undefined ? "" : `${number(-age, 1, "s")} before ${held}`;
    const why = this.view ? "Zoomed. A double click shows all." : this.paused ? "Paused. The log still records." : "";
    setText(this.note, [why, when].filter(Boolean).join(" "));
  }
}

const inWords = (seconds) => (seconds < 600 ? `${seconds} s` : `${seconds / 60} min`);
