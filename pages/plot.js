// Recordings: one canvas, the curves above; beneath, the first of them minus each of the others. Data: plot.py.
// Written here, since what it must do beyond curves (keyboard, touch, panning, words for who hears the page, paper) is most of
// it: uPlot 1.6 would be 53 kB in each page beside these 13 and brings none of that.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const canvas = document.getElementById("traces");
  if (!canvas || !data.items.length) return;
  const readout = document.getElementById("readout");
  const picks = data.choices.map((name) => document.getElementById(`pick-${name}`));
  const LEFT = 72, RIGHT = 8, TOP = 8, BOTTOM = 26, BETWEEN = 14, STRIP = 0.3;
  const NAN = 65535, STEPS = 65534, MIN_SAMPLES = 8;

  let item = null;      // what is shown: decoded curves
  let view = [0, 1];    // seconds
  let drag = null;      // {x0, x1, from} while the pointer is down
  let hover = null;     // x of the pointer

  // ---- data

  function bytes(text) {
    return Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  }

  function curve(packed) {
    const step = (packed.high - packed.low) / STEPS;
    return Float64Array.from(new Uint16Array(bytes(packed.levels)), (v) => (v === NAN ? NaN : packed.low + v * step));
  }

  function stamps(t) {
    if (t.us) return Float64Array.from(new Uint32Array(bytes(t.us)), (us) => t.start + us / 1e6);
    return Float64Array.from({ length: t.n }, (_, i) => t.start + i * (t.step || 0));
  }

  function decode(raw) { // curves and gaps: [name, values] each; a gap is the first curve minus another
    const curves = Object.entries(raw.curves).map(([name, packed]) => [name, curve(packed)]);
    const [[, first], ...others] = curves;
    const gaps = others.map(([name, values]) => [name, first.map((v, i) => v - values[i])]);
    return { ...raw, t: stamps(raw.t), curves, gaps };
  }

  function after(t, at) { // index of the first stamp that is not before `at`
    let low = 0, high = t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] < at) low = middle + 1; else high = middle;
    }
    return low;
  }

  function extent(curves, from, to) {
    let low = Infinity, high = -Infinity;
    for (const [, values] of curves) {
      for (let i = from; i < to; i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
    }
    if (low > high) return [-1, 1];
    const margin = 0.06 * (high - low) || Math.abs(high) * 0.1 || 1;
    return [low - margin, high + margin];
  }

  function rms(values, from, to) {
    let sum = 0, n = 0;
    for (let i = from; i < to; i++) if (values[i] === values[i]) { sum += values[i] * values[i]; n++; }
    return n ? Math.sqrt(sum / n) : NaN;
  }

  const number = (v) => (v === v ? String(Number(v.toPrecision(3))) : "–");

  // ---- drawing

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const steps = [0.5, 1, 2, 5, 10].map((s) => s * power), fit = steps.findIndex((s) => s >= raw);
    const step = (high - low) / steps[fit] < 2.5 ? steps[fit - 1] : steps[fit]; // one mark alone says nothing
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high + step * 1e-9; k++) found.push(k * step);
    return [found, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  }

  function geometry() {
    const width = canvas.clientWidth, height = canvas.clientHeight, inner = height - TOP - BOTTOM - BETWEEN;
    const strip = Math.round(inner * STRIP);
    return {
      width, height, right: width - RIGHT,
      main: [TOP, TOP + inner - strip],
      strip: [height - BOTTOM - strip, height - BOTTOM],
      x: (t) => LEFT + ((t - view[0]) / (view[1] - view[0])) * (width - RIGHT - LEFT),
      t: (x) => view[0] + ((x - LEFT) / (width - RIGHT - LEFT)) * (view[1] - view[0]),
    };
  }

  function trace(pen, g, values, y, from, to) { // a polyline, or each pixel's extremes where samples crowd
    pen.beginPath();
    const crowded = to - from > 3 * (g.right - LEFT);
    let open = false, column = -1, low = 0, high = 0;
    const flush = () => {
      if (column < 0) return;
      if (open) pen.lineTo(column, y(low)); else pen.moveTo(column, y(low));
      pen.lineTo(column, y(high));
      open = true;
      column = -1;
    };
    for (let i = from; i < to; i++) {
      const v = values[i];
      if (v !== v) { flush(); open = false; continue; }
      const x = g.x(item.t[i]);
      if (!crowded) {
        if (open) pen.lineTo(x, y(v)); else pen.moveTo(x, y(v));
        open = true;
      } else if (Math.round(x) === column) {
        low = Math.min(low, v);
        high = Math.max(high, v);
      } else {
        flush();
        column = Math.round(x);
        low = high = v;
      }
    }
    flush();
    pen.stroke();
  }

  function panel(pen, g, place, range, colour, title) {
    const [top, bottom] = place;
    const y = (v) => bottom - ((v - range[0]) / (range[1] - range[0])) * (bottom - top);
    const [marks, decimals] = ticks(range[0], range[1], Math.max(3, (bottom - top) / 48));
    pen.lineWidth = 1;
    pen.textAlign = "right";
    for (const mark of marks) {
      pen.strokeStyle = colour("--line");
      pen.beginPath();
      pen.moveTo(LEFT, Math.round(y(mark)) + 0.5);
      pen.lineTo(g.right, Math.round(y(mark)) + 0.5);
      pen.stroke();
      pen.fillStyle = colour("--soft");
      pen.fillText(mark.toFixed(decimals), LEFT - 7, y(mark) + 4);
    }
    pen.save();
    pen.translate(11, (top + bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(title, 0, 0);
    pen.restore();
    return y;
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, g = geometry();
    if (!g.width) return;
    canvas.width = Math.round(g.width * ratio);
    canvas.height = Math.round(g.height * ratio);
    const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    pen.scale(ratio, ratio);
    pen.fillStyle = colour("--paper");
    pen.fillRect(0, 0, g.width, g.height);
    pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    pen.lineJoin = "round";

    const from = Math.max(0, after(item.t, view[0]) - 1), to = Math.min(item.t.length, after(item.t, view[1]) + 1);
    const name = item.chosen[item.chosen.length - 1];
    const title = item.unit ? `${name} (${item.unit})` : name;
    const y = panel(pen, g, g.main, extent(item.curves, from, to), colour, title);
    const [least, most] = extent(item.gaps, from, to), band = item.band;
    const range = [Math.min(least, -band * 1.1, 0), Math.max(most, band * 1.1, 0)];
    const r = panel(pen, g, g.strip, range, colour, "residual");

    pen.textAlign = "center";
    const [marks, decimals] = ticks(view[0], view[1], Math.max(2, (g.right - LEFT) / 90));
    for (const mark of marks) pen.fillText(`${mark.toFixed(decimals)} s`, Math.min(Math.max(g.x(mark), LEFT + 8), g.right - 14), g.height - 7);

    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, g.right - LEFT, g.height - BOTTOM);
    pen.clip();
    if (band) {
      pen.fillStyle = colour("--band");
      pen.fillRect(LEFT, r(band), g.right - LEFT, r(-band) - r(band));
    }
    for (const [curves, place] of [[item.curves, y], [item.gaps, r]]) {
      for (const [name, values] of curves) {
        pen.strokeStyle = colour(`--${name}`);
        pen.lineWidth = name === item.curves[0][0] ? 2.6 : 1.5;
        trace(pen, g, values, place, from, to);
      }
    }
    if (drag && drag.zoom) {
      pen.fillStyle = colour("--band");
      pen.fillRect(Math.min(drag.x0, drag.x1), 0, Math.abs(drag.x1 - drag.x0), g.height - BOTTOM);
    } else if (hover !== null) {
      pen.strokeStyle = colour("--floor");
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(hover, 0);
      pen.lineTo(hover, g.height - BOTTOM);
      pen.stroke();
    }
    pen.restore();
    tell(g, from, to);
  }

  function tell(g, from, to) { // the same in words, for the eye and for who hears the page
    const named = ([name, value]) => `${name} ${number(value)}`;
    const seconds = `${view[0].toFixed(2).replace(/^-0\.00$/, "0.00")} to ${view[1].toFixed(2)} s`;
    const left = item.gaps.map(([name, values]) => named([name, rms(values, from, to)])).join(", ");
    const gaps = `RMS of ${item.curves[0][0]} minus simulated, ${seconds}: ${left} ${item.unit}`;
    const what = item.chosen.map((value, i) => `${data.choices[i]} ${value}`).join(", ");
    canvas.setAttribute("aria-label", `${what} (${item.note}). ${gaps}`);
    let at = "";
    if (hover !== null) {
      const i = Math.min(item.t.length - 1, after(item.t, g.t(hover)));
      const values = item.curves.map(([name, curve]) => named([name, curve[i]])).join(", ");
      at = ` At ${item.t[i].toFixed(3)} s: ${values} ${item.unit}.`;
    }
    readout.textContent = `${gaps}.${at}`;
  }

  let waiting = false;
  function soon() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }

  // ---- what is in view

  const whole = () => [item.t[0], item.t.length > 1 ? item.t[item.t.length - 1] : item.t[0] + 1];

  function look(from, to) {
    const [start, end] = whole();
    const least = Math.min(end - start, (MIN_SAMPLES * (end - start)) / Math.max(1, item.t.length - 1));
    const length = Math.min(end - start, Math.max(least, to - from));
    const middle = (from + to) / 2;
    const left = Math.min(Math.max(start, middle - length / 2), end - length);
    view = [left, left + length];
    soon();
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

  function choose(wanted) { // keep what was chosen where the new stage or trial has it
    let rest = data.items;
    picks.forEach((select, k) => {
      const values = [...new Set(rest.map((it) => it.chosen[k]))];
      const value = options(select, values, values.includes(wanted[k]) ? wanted[k] : values[0]);
      rest = rest.filter((it) => it.chosen[k] === value);
    });
    const trial = data.choices.indexOf("trial"), same = item && item.chosen[trial] === rest[0].chosen[trial];
    item = decode(rest[0]);
    if (same) look(...view); else look(...whole());
  }

  for (const select of picks) select.addEventListener("change", () => choose(picks.map((each) => each.value)));

  // ---- pointer, wheel, keys

  const inside = (event) => {
    const x = event.clientX - canvas.getBoundingClientRect().left;
    return Math.min(Math.max(x, LEFT), canvas.clientWidth - RIGHT);
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    const x = inside(event);
    drag = { x0: x, x1: x, zoom: !event.shiftKey && event.button === 0, view: [...view] };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    hover = inside(event);
    if (drag) {
      drag.x1 = hover;
      if (!drag.zoom) {
        const by = ((drag.x0 - drag.x1) / (canvas.clientWidth - LEFT - RIGHT)) * (drag.view[1] - drag.view[0]);
        look(drag.view[0] + by, drag.view[1] + by);
      }
    }
    soon();
  });
  canvas.addEventListener("pointerup", () => {
    const done = drag, g = geometry();
    drag = null;
    if (done && done.zoom && Math.abs(done.x1 - done.x0) > 5) {
      const [a, b] = [g.t(done.x0), g.t(done.x1)];
      look(Math.min(a, b), Math.max(a, b));
    }
    soon();
  });
  canvas.addEventListener("pointercancel", () => { drag = null; soon(); });
  canvas.addEventListener("pointerleave", () => { hover = null; soon(); });
  canvas.addEventListener("dblclick", DO.reset);
  canvas.addEventListener("wheel", (event) => { // a plain wheel scrolls the page, as everywhere
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, geometry().t(inside(event)));
  }, { passive: false });
  const KEYS = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", 0: "reset" };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || !KEYS[event.key]) return;
    event.preventDefault();
    DO[KEYS[event.key]]();
  });
  for (const button of document.querySelectorAll("[data-do]")) {
    button.addEventListener("click", DO[button.dataset.do]);
  }

  // ---- surroundings: size, light and dark, paper

  new ResizeObserver(soon).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", soon);
  addEventListener("beforeprint", () => { document.documentElement.dataset.print = ""; draw(); });
  addEventListener("afterprint", () => { delete document.documentElement.dataset.print; draw(); });
  choose(data.items[data.first].chosen);
  if (data.view) look(...data.view);
})();
