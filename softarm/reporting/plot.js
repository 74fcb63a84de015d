// Plot of recordings: the curves, and below them the first curve minus each other one. Data: plot.py.
/* global uPlot, tableColour, unpackedBytes, unpackedLevels, sampleAt, chartAxis, chartSeries, paddedRange */
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const place = document.getElementById("traces");
  if (!place || !data.items.length) return;
  const readout = document.getElementById("readout");
  const picks = data.choices.map((name) => document.getElementById(`pick-${name}`));
  const STRIP = 0.36, MIN_SAMPLES = 8;

  let item = null;      // decoded curves of the chosen recording
  let view = [0, 1];    // seconds
  let plots = [];
  let drag = null;      // {from, at, zoom, view} while the pointer is down
  let hover = null;     // time under the pointer

  // ---- data

  function stamps(t) {
    if (t.us) return Array.from(new Uint32Array(unpackedBytes(t.us)), (us) => t.start + us / 1e6);
    return Array.from({ length: t.n }, (_, i) => t.start + i * (t.step || 0));
  }

  function decode(raw) { // a gap is the first curve minus another
    const curves = Object.entries(raw.curves).map(([name, packed]) => [name, unpackedLevels(packed)]);
    const [[, first], ...others] = curves;
    const minus = (a, b) => (a === null || b === null ? null : a - b);
    return { ...raw, t: stamps(raw.t), curves, gaps: others.map(([name, values]) => [name, first.map((v, i) => minus(v, values[i]))]) };
  }

  function rms(values, from, to) {
    const known = values.slice(from, to).filter((value) => value !== null);
    return known.length ? Math.sqrt(known.reduce((sum, value) => sum + value * value, 0) / known.length) : null;
  }

  const number = (v) => (v === null || v === undefined ? "–" : String(Number(v.toPrecision(3))));

  // ---- charts

  function chart(title, curves, height, isStrip) {
    const { band } = item, [first] = item.curves[0];
    const range = (_, low, high) => (isStrip ? paddedRange(Math.min(low ?? 0, -band, 0), Math.max(high ?? 0, band, 0)) : paddedRange(low, high));
    const shade = (plot) => {
      const [top, bottom] = [band, -band].map((level) => plot.valToPos(level, "y", true));
      plot.ctx.fillStyle = tableColour("band");
      plot.ctx.fillRect(plot.bbox.left, top, plot.bbox.width, bottom - top);
    };
    const lines = curves.map(([name]) => ({ name, colour: name, width: name === first ? 2.6 : 1.5 }));
    return new uPlot({
      width: place.clientWidth,
      height,
      padding: [8, 8, 0, 0],
      legend: { show: false },
      cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
      scales: { x: { time: false, range: () => view }, y: { range } },
      axes: [
        chartAxis({ show: isStrip, size: 26, space: 60, values: (_, at) => at.map((t) => `${Number(t.toFixed(6))} s`) }),
        chartAxis({ size: 54, label: title, labelSize: 18, labelFont: "12px system-ui, sans-serif", values: (_, at) => at.map((value) => String(Number(value.toPrecision(6)))) }),
      ],
      series: chartSeries(lines),
      hooks: isStrip && band ? { drawAxes: [shade] } : {},
    }, [item.t, ...curves.map(([, values]) => values)], place);
  }

  function build() {
    plots.forEach((plot) => plot.destroy());
    const name = item.chosen[item.chosen.length - 1], strip = Math.round(STRIP * place.clientHeight);
    plots = [
      chart(item.unit ? `${name} (${item.unit})` : name, item.curves, place.clientHeight - strip, false),
      chart("residual", item.gaps, strip, true),
    ];
    describe();
  }

  function describe() { // in words, for sighted users and screen readers
    const [from, to] = [Math.max(0, sampleAt(item.t, view[0])), sampleAt(item.t, view[1]) + 2];
    const named = ([name, value]) => `${name} ${number(value)}`;
    const seconds = `${view[0].toFixed(2).replace(/^-0\.00$/, "0.00")} to ${view[1].toFixed(2)} s`;
    const left = item.gaps.map(([name, values]) => named([name, rms(values, from, to)])).join(", ");
    const gaps = `RMS of ${item.curves[0][0]} minus simulated, ${seconds}: ${left} ${item.unit}`;
    const chosen = item.chosen.map((value, i) => `${data.choices[i]} ${value}`).join(", ");
    place.setAttribute("aria-label", `${chosen} (${item.note}). ${gaps}`);
    let at = "";
    if (hover !== null) {
      const i = Math.max(0, sampleAt(item.t, hover));
      const values = item.curves.map(([name, curve]) => named([name, curve[i]])).join(", ");
      at = ` At ${item.t[i].toFixed(3)} s: ${values} ${item.unit}.`;
    }
    readout.textContent = `${gaps}.${at}`;
  }

  // ---- view

  const whole = () => [item.t[0], item.t.length > 1 ? item.t[item.t.length - 1] : item.t[0] + 1];

  function look(from, to) {
    const [start, end] = whole();
    const least = Math.min(end - start, (MIN_SAMPLES * (end - start)) / Math.max(1, item.t.length - 1));
    const length = Math.min(end - start, Math.max(least, to - from));
    const left = Math.min(Math.max(start, (from + to - length) / 2), end - length);
    view = [left, left + length];
    plots.forEach((plot) => plot.setScale("x", { min: view[0], max: view[1] }));
    describe();
  }

  function zoom(factor, centre = (view[0] + view[1]) / 2) {
    look(centre - (centre - view[0]) * factor, centre + (view[1] - centre) * factor);
  }

  const move = (share) => look(view[0] + share * (view[1] - view[0]), view[1] + share * (view[1] - view[0]));
  const DO = {
    in: () => zoom(0.5), out: () => zoom(2), left: () => move(-0.3), right: () => move(0.3),
    reset: () => look(...whole()),
  };

  // ---- choosing

  function options(select, values, chosen) {
    select.replaceChildren(...values.map((value) => new Option(value, value, false, value === chosen)));
    select.disabled = values.length < 2;
    return select.value;
  }

  function choose(selected) { // keep the selection if the new stage or trial has it
    let rest = data.items;
    picks.forEach((select, k) => {
      const values = [...new Set(rest.map((it) => it.chosen[k]))];
      const value = options(select, values, values.includes(selected[k]) ? selected[k] : values[0]);
      rest = rest.filter((it) => it.chosen[k] === value);
    });
    const trial = data.choices.indexOf("trial"), same = item && item.chosen[trial] === rest[0].chosen[trial];
    item = decode(rest[0]);
    view = same ? view : whole();
    build();
  }

  for (const select of picks) select.addEventListener("change", () => choose(picks.map((each) => each.value)));

  // ---- pointer, wheel, keys

  function pointed(event) { // pixels in the chart and seconds
    const box = plots[0].over.getBoundingClientRect();
    const x = Math.min(Math.max(event.clientX - box.left, 0), box.width);
    return { x, t: view[0] + (x / box.width) * (view[1] - view[0]) };
  }

  const mark = (left, width) => plots.forEach((plot) => plot.setSelect({ left, width, top: 0, height: plot.over.clientHeight }, false));

  place.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    const from = pointed(event);
    drag = { from, at: from, zoom: !event.shiftKey && event.button === 0, view };
    place.setPointerCapture(event.pointerId);
  });
  place.addEventListener("pointermove", (event) => {
    const at = pointed(event);
    hover = at.t;
    plots.forEach((plot) => plot.setCursor({ left: at.x, top: 0 }));
    if (!drag) return void describe();
    drag.at = at;
    if (drag.zoom) return void mark(Math.min(at.x, drag.from.x), Math.abs(at.x - drag.from.x));
    const by = ((drag.from.x - at.x) / plots[0].over.clientWidth) * (drag.view[1] - drag.view[0]);
    look(drag.view[0] + by, drag.view[1] + by);
  });
  place.addEventListener("pointerup", () => {
    const done = drag;
    drag = null;
    mark(0, 0);
    if (done && done.zoom && Math.abs(done.at.x - done.from.x) > 5) look(Math.min(done.from.t, done.at.t), Math.max(done.from.t, done.at.t));
  });
  place.addEventListener("pointercancel", () => { drag = null; mark(0, 0); });
  place.addEventListener("pointerleave", () => {
    hover = null;
    plots.forEach((plot) => plot.setCursor({ left: -10, top: -10 }));
    describe();
  });
  place.addEventListener("dblclick", DO.reset);
  place.addEventListener("wheel", (event) => { // the wheel alone scrolls the page
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, pointed(event).t);
  }, { passive: false });
  const KEYS = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", 0: "reset" };
  place.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || !KEYS[event.key]) return;
    event.preventDefault();
    DO[KEYS[event.key]]();
  });
  for (const button of document.querySelectorAll("[data-do]")) {
    button.addEventListener("click", DO[button.dataset.do]);
  }

  // ---- film of a mechanism

  for (const figure of document.querySelectorAll("figure.film")) {
    const film = figure.querySelector("svg");
    figure.querySelector("button").addEventListener("click", () => {
      if (film.animationsPaused()) film.unpauseAnimations(); else film.pauseAnimations();
    });
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) film.pauseAnimations();
  }

  // ---- size, colour scheme, printing

  choose(data.items[data.first].chosen);
  if (data.view) look(...data.view);
  let width = place.clientWidth;
  new ResizeObserver(() => {
    if (place.clientWidth === width) return;
    width = place.clientWidth;
    build();
  }).observe(place);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  addEventListener("beforeprint", () => { document.documentElement.dataset.print = ""; build(); });
  addEventListener("afterprint", () => { delete document.documentElement.dataset.print; build(); });
})();
