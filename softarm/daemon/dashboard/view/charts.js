// Charts of the last minute (uPlot) with a shared cursor. The legend shows the newest value or the one under the pointer.

/* global uPlot, chartAxis, chartSeries */
import { el, number, setText } from "./dom.js";
import { SPAN_S } from "../link/history.js";

const HEIGHT_PX = 132;
const EVERY_MS = 100;

// Names of the colours in reporting/shared/colours.css, with the line of each.
const LINES = { measured: { width: 1.75 }, sent: { width: 1.5 }, requested: { width: 1.5, dash: [5, 3] }, second: { width: 1.5 }, floor: { width: 1.25, dash: [2, 2] } };
const CHARTS = [
  { title: "Tip", unit: "m", digits: 3, span: [-0.5, 0.9], lines: [["tip_y_m", "y", "measured"], ["tip_z_m", "z", "second"]] },
  { title: "Cart position", unit: "m", digits: 3, span: [-0.3, 0.3], lines: [["cart_m", "measured", "measured"]] },
  { title: "Cart velocity", unit: "m/s", digits: 2, span: [-1, 1], lines: [["action_velocity_m_s", "requested", "requested"], ["sent_velocity_m_s", "sent", "sent"], ["cart_velocity_m_s", "measured", "measured"]] },
  { title: "Pressure", unit: "kPa", digits: 1, span: [0, 10], lines: [["action_pressure_kpa", "requested", "requested"], ["sent_pressure_kpa", "sent", "sent"], ["pressure_kpa", "measured", "measured"]] },
  { title: "Control tick", unit: "ms", digits: 2, span: [0, 5], lines: [["late_ms", "late", "measured"], ["policy_ms", "policy", "second"]] },
  { title: "Age of readings", unit: "ms", digits: 1, span: [0, 40], lines: [["mocap_age_ms", "cameras", "measured"], ["pressure_age_ms", "pressure", "second"], ["rail_age_ms", "rail", "floor"]] },
];

class Chart {
  constructor(spec, place, onCursor) {
    this.spec = spec;
    this.values = spec.lines.map(() => el("output", {}, "–"));
    const names = spec.lines.map(([, name, kind], k) => el("span", { class: "line" }, el("i", { class: `swatch ${kind}` }), `${name} `, this.values[k]));
    this.canvas = el("div", { class: "canvas" });
    this.figure = el("figure", { class: "plot" }, el("figcaption", {}, el("b", {}, spec.title), el("span", { class: "unit" }, spec.unit), ...names), this.canvas);
    place.append(this.figure);
    this.onCursor = onCursor;
    this.visible = true;
    new IntersectionObserver(([entry]) => this.setVisible(entry.isIntersecting)).observe(this.figure);
  }

  // Draw only charts on the screen; a chart that scrolls into view gets the newest data.
  setVisible(visible) {
    this.visible = visible;
    if (visible && this.data) this.plot?.setData(this.data);
  }

  // Build the plot again after a change of width or colours.
  build() {
    this.plot?.destroy();
    const [low, high] = this.spec.span;
    this.plot = new uPlot({
      width: Math.max(200, this.canvas.clientWidth),
      height: HEIGHT_PX,
      legend: { show: false },
      cursor: { sync: { key: "minute" }, drag: { x: false, y: false }, points: { size: 5 } },
      scales: {
        x: { time: false, range: [-SPAN_S, 0] },
        y: { range: (_, from, to) => this.padded(Math.min(from ?? low, low), Math.max(to ?? high, high)) },
      },
      axes: [
        chartAxis({ size: 24, gap: 3, incrs: [10, 20, 30], space: 40, values: (_, at) => at.map((t) => (t === 0 ? "now" : `${number(t, 0)} s`)) }),
        chartAxis({ size: 42, gap: 3, space: 26, values: (_, at) => at.map((value) => String(Number(value.toFixed(6))).replace("-", "−")) }),
      ],
      series: chartSeries(this.spec.lines.map(([, name, colour]) => ({ name, colour, ...LINES[colour] }))),
      hooks: { setCursor: [(plot) => this.onCursor(plot.cursor.left >= 0 ? plot.cursor.idx : null)] },
    }, this.data ?? [[], ...this.spec.lines.map(() => [])], this.canvas);
  }

  padded(low, high) {
    const padding = 0.06 * (high - low);
    return [low - padding, high + padding];
  }

  draw(ages, columns) {
    this.data = [ages, ...this.spec.lines.map(([name]) => columns[name])];
    if (this.visible) this.plot?.setData(this.data);
  }

  // Show the values of a row, or of the newest row if null.
  read(row) {
    this.spec.lines.forEach((_, k) => {
      const column = this.data?.[k + 1] ?? [];
      setText(this.values[k], number(column[row ?? column.length - 1], this.spec.digits));
    });
  }
}

export class Charts {
  constructor(place, note, history) {
    this.place = place;
    this.note = note;
    this.history = history;
    this.row = null; // row under the pointer
    this.paused = false;
    this.drawn = 0;
    this.charts = CHARTS.map((spec) => new Chart(spec, place, (row) => this.point(row)));
    this.build();
    new ResizeObserver(() => this.place.clientWidth !== this.width && this.build()).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  // Without the chart library the rest of the page still works.
  build() {
    if (typeof uPlot === "undefined") return;
    this.width = this.place.clientWidth;
    this.charts.forEach((chart) => chart.build());
  }

  point(row) {
    this.row = row;
    this.read();
  }

  pause(paused) {
    this.paused = paused;
    this.draw(true);
  }

  // With what has come; at most ten times a second, and not while paused.
  draw(now = false) {
    if (document.hidden || this.paused || (!now && performance.now() - this.drawn < EVERY_MS)) return void this.read();
    this.drawn = performance.now();
    const { time } = this.history.columns;
    const newest = this.history.newest;
    const first = Math.max(0, time.findIndex((at) => at >= newest - SPAN_S));
    const ages = time.slice(first).map((at) => at - newest);
    const columns = Object.fromEntries(Object.entries(this.history.columns).map(([name, column]) => [name, column.slice(first)]));
    this.place.dataset.seconds = ages.length ? (-ages[0]).toFixed(1) : "0";
    this.ages = ages;
    this.newest = newest;
    this.charts.forEach((chart) => chart.draw(ages, columns));
    this.read();
  }

  read() {
    this.charts.forEach((chart) => chart.read(this.row));
    const at = this.row === null ? undefined : this.ages?.[this.row];
    const when = at === undefined ? "" : `${number(-at, 1, "s")} before ${this.paused ? "the pause" : "now"}`;
    if (typeof uPlot === "undefined") return void setText(this.note, "The chart library did not load. Reload the page.");
    setText(this.note, [this.paused ? "Paused. The log still records." : "", when].filter(Boolean).join(" "));
  }
}
