// Charts (uPlot) that share window, cursor and marks. A legend shows the newest values, or those under the pointer.

/* global uPlot, chartAxis, chartSeries, paddedRange, sampleAt, tableColour */
import { el, number, setText } from "./dom.js";

const STEPS_S = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120];
const DRAG_PX = 6; // a shorter drag is a click

// Names of the colours in reporting/shared/colours.css, with the line of each.
const LINES = { measured: { width: 1.75 }, sent: { width: 1.5 }, requested: { width: 1.5, dash: [5, 3] }, second: { width: 1.5 }, floor: { width: 1.25, dash: [2, 2] }, good: { width: 1.5, dash: [7, 4] } };
// A mark differs in colour, line and sign.
const MARKS = { began: ["accent", [2, 3], "▸"], reached: ["good", [], "✓"], failed: ["stop-text", [7, 4], "✕"], cancelled: ["soft", [1, 4], "–"] };
export const ROBOT = [
  { title: "Tip", unit: "m", digits: 3, span: [-0.5, 0.9], lines: [["tip_y_m", "y", "measured"], ["tip_z_m", "z", "second"]] },
  { title: "Cart position", unit: "m", digits: 3, span: [-0.3, 0.3], lines: [["cart_m", "measured", "measured"]] },
  { title: "Cart velocity", unit: "m/s", digits: 2, span: [-1, 1], lines: [["action_velocity_m_s", "requested", "requested"], ["sent_velocity_m_s", "sent", "sent"], ["cart_velocity_m_s", "measured", "measured"]] },
  { title: "Pressure", unit: "kPa", digits: 1, span: [0, 10], lines: [["action_pressure_kpa", "requested", "requested"], ["sent_pressure_kpa", "sent", "sent"], ["pressure_kpa", "measured", "measured"]] },
];

class Chart {
  constructor(spec, group, name) {
    this.spec = spec;
    this.group = group;
    this.values = spec.lines.map(() => el("output", {}, "–"));
    const names = spec.lines.map(([, line, kind], k) => el("span", { class: "line" }, el("i", { class: `swatch ${kind}` }), `${line} `, this.values[k]));
    this.canvas = el("div", { class: "canvas" });
    this.now = el("i", { class: "now", hidden: true });
    this.figure = el("figure", { class: name }, el("figcaption", {}, el("b", {}, spec.title), el("span", { class: "unit" }, spec.unit), ...names), this.canvas);
    group.place.append(this.figure);
    this.visible = true;
    new IntersectionObserver(([entry]) => this.setVisible(entry.isIntersecting)).observe(this.figure);
  }

  // Draw only charts on the screen; a chart that scrolls into view gets the newest data.
  setVisible(visible) {
    this.visible = visible;
    if (visible) this.redraw();
  }

  // Build the plot again after a change of size or colours.
  build() {
    this.plot?.destroy();
    const { group, spec } = this;
    const [low, high] = spec.span;
    this.plot = new uPlot({
      width: Math.max(180, this.canvas.clientWidth),
      height: Math.max(100, this.canvas.clientHeight),
      legend: { show: false },
      cursor: {
        sync: { key: group.key, filters: { pub: (type) => type === "mousemove" } },
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => group.zoom(null) },
        points: { size: 5 },
      },
      scales: { x: { time: false, range: () => group.window() }, y: { range: (_, from, to) => paddedRange(Math.min(from ?? low, low), Math.max(to ?? high, high)) } },
      axes: [
        chartAxis({ size: 24, gap: 3, incrs: STEPS_S, space: 44, values: (_, at, _axis, _space, step) => at.map((t) => group.label(t, step < 0.1 ? 2 : step < 1 ? 1 : 0)) }),
        chartAxis({ size: 42, gap: 3, space: 26, values: (_, at) => at.map((value) => String(Number(value.toFixed(6))).replace("-", "−")) }),
      ],
      series: chartSeries(spec.lines.map(([, name, colour]) => ({ name, colour, ...LINES[colour] }))),
      hooks: {
        setCursor: [(plot) => group.point(plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : null)],
        setSelect: [(plot) => this.select(plot)],
        draw: [(plot) => group.marks().forEach((mark) => drawMark(plot, mark))],
      },
    }, this.data ?? [[], ...spec.lines.map(() => [])], this.canvas);
    this.plot.over.append(this.now);
  }

  select(plot) {
    const { left, width } = plot.select;
    if (width === 0) return;
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (width >= DRAG_PX) this.group.zoom([plot.posToVal(left, "x"), plot.posToVal(left + width, "x")]);
  }

  // x: the times. columns: the curves by name.
  show(x, columns) {
    this.data = [x, ...this.spec.lines.map(([name]) => columns[name])];
    this.redraw();
  }

  redraw() {
    if (this.visible && this.data) this.plot?.setData(this.data);
  }

  // Show the values at a time, or the newest if null.
  read(time) {
    const [x, ...columns] = this.data ?? [[]];
    const row = time === null ? x.length - 1 : nearest(x, time);
    columns.forEach((column, k) => setText(this.values[k], number(column[row], this.spec.digits)));
  }

  // Move the line of the moment that is shown; hide it outside the window.
  setNow(time) {
    const px = this.plot?.valToPos(time, "x") ?? -1;
    this.now.hidden = px < 0 || px > this.plot.over.clientWidth;
    this.now.style.transform = `translateX(${px.toFixed(1)}px)`;
  }
}

// Return the row whose time is nearest.
export function nearest(x, time) {
  const row = Math.max(0, sampleAt(x, time));
  return row + 1 < x.length && x[row + 1] - time < time - x[row] ? row + 1 : row;
}

function drawMark(plot, { at, kind }) {
  const { ctx, bbox, scales } = plot;
  if (!(at >= scales.x.min && at <= scales.x.max)) return;
  const [colour, dash, sign] = MARKS[kind] ?? MARKS.cancelled;
  const [px, ratio] = [plot.valToPos(at, "x", true), devicePixelRatio];
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = tableColour(colour);
  ctx.lineWidth = ratio;
  ctx.setLineDash(dash.map((length) => length * ratio));
  ctx.beginPath();
  ctx.moveTo(px, bbox.top);
  ctx.lineTo(px, bbox.top + bbox.height);
  ctx.stroke();
  ctx.font = `bold ${11 * ratio}px system-ui, sans-serif`;
  ctx.textAlign = px > bbox.left + bbox.width - 16 * ratio ? "right" : "left";
  ctx.fillText(sign, px + (ctx.textAlign === "left" ? 2 : -2) * ratio, bbox.top + 10 * ratio);
  ctx.restore();
}

// Return the key of the marks.
export const markKey = () => el("ul", { class: "key marks" }, [["began", "goal began"], ["reached", "reached"], ["failed", "missed"], ["cancelled", "cancelled"]].map(([kind, text]) => el("li", { class: kind }, el("b", { "aria-hidden": "true" }, MARKS[kind][2]), text)));

// Charts of one place. A subclass has whole(): the window without zoom, label(time, digits), and marks(): [{at, kind}].
export class Charts {
  // specs of the charts, key of the shared cursor, class name of a chart's figure. A subclass ends its constructor with build().
  constructor(place, specs, key, name) {
    this.place = place;
    this.key = key;
    this.view = null; // the zoomed window
    this.at = null; // time under the pointer
    this.charts = specs.map((spec) => new Chart(spec, this, name));
    new ResizeObserver(() => this.size() !== this.built && this.build()).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  size() {
    const { clientWidth, clientHeight } = this.charts[0].canvas;
    return `${clientWidth} ${clientHeight}`;
  }

  // Without the chart library the rest of the page still works.
  build() {
    if (typeof uPlot === "undefined") return;
    this.built = this.size();
    this.charts.forEach((chart) => chart.build());
  }

  window() {
    return this.view ?? this.whole();
  }

  // Show a part of the window, or all of it if null.
  zoom(view) {
    this.view = view;
    this.charts.forEach((chart) => chart.redraw());
    this.read();
  }

  point(time) {
    if (time === this.at) return;
    this.at = time;
    this.read();
  }

  read() {
    this.charts.forEach((chart) => chart.read(this.at));
  }
}
