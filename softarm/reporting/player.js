// Log player: the arm at a moment, charts and events. Data: softarm/recordings/player.py.
/* global uPlot, tableColour, unpackedBytes, unpackedLevels, sampleAt, chartAxis, chartSeries, paddedRange, ARM_RADII_M, GOAL_WORDS, armOutline, spotBetween */
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const at = (id) => document.getElementById(id);
  const scene = at("scene"), charts = at("charts"), slider = at("time");
  const { robot } = data;

  // ---- data

  const t = Array.from(new Uint32Array(unpackedBytes(data.stamps)), (v) => v / 1e3);
  const of = Object.fromEntries(Object.entries(data.series).map(([name, packed]) => [name, unpackedLevels(packed)]));
  const BODIES = ["cart", "link1", "link2", "link3", "link4", "link5"];
  const ys = BODIES.map((name) => of[`${name}_y`]), zs = BODIES.map((name) => of[`${name}_z`]);
  const end = t[t.length - 1], moments = data.events.map((event) => event[0]);

  const starts = Object.fromEntries(Object.entries(data.runs).map(([name, runs]) => [name, runs.map((run) => run[0])]));
  const tickAt = (time) => Math.max(0, sampleAt(t, time + 1e-6));
  const runAt = (name, time) => data.runs[name][Math.max(0, sampleAt(starts[name], time + 1e-6))] || [];

  function steps(name, pick) { // values of a run for every tick
    const values = new Array(t.length).fill(null), runs = data.runs[name];
    for (let k = 0; k < runs.length; k++) {
      const value = pick(runs[k]), to = k + 1 < runs.length ? runs[k + 1][0] : Infinity;
      if (value === null) continue;
      for (let i = Math.max(0, tickAt(runs[k][0])); i < t.length && t[i] < to - 1e-6; i++) if (t[i] >= runs[k][0] - 1e-6) values[i] = value;
    }
    return values;
  }
  const targetY = steps("goal", (run) => (run[4] && run[3] === "running" ? run[4][0] : null));
  const targetZ = steps("goal", (run) => (run[4] && run[3] === "running" ? run[4][1] : null));

  // ---- state of the player

  const first = data.runs.mode.find((run) => run[1] === "armed" || run[1] === "arming");
  const linked = () => /[#&]t=(\d+\.?\d*)/.exec(location.hash)?.[1]; // seconds, as text
  let now = Math.min(end, Number(linked() ?? first?.[0] ?? 0));
  let playing = false, painted = 0, held = null; // held: fixed view of the charts during a drag

  const number = (v, digits) => (v === null ? "–" : v.toFixed(digits).replace(/^-(?=[0.]+$)/, "").replace("-", "−"));
  const clock = (time) => {
    const minutes = Math.floor(time / 60), hours = Math.floor(minutes / 60), two = (v) => String(v).padStart(2, "0");
    return (hours ? `${hours}:${two(minutes % 60)}` : String(minutes)) + `:${(time % 60).toFixed(2).padStart(5, "0")}`;
  };
  const wall = (time) => new Date(data.begin_ms + time * 1000).toISOString().slice(11, 23);

  const isKnown = (v) => v !== null;

  function pen(canvas) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const drawn = canvas.getContext("2d");
    drawn.scale(ratio, ratio);
    drawn.font = "12px system-ui, sans-serif";
    drawn.lineJoin = drawn.lineCap = "round";
    return [drawn, width, height];
  }

  // ---- the arm

  const BY_STATE = { running: "requested", reached: "good", failed: "stop" };
  const frame = (() => { // area of the picture, in metres
    const side = Math.max(-robot.hard_m[0], robot.hard_m[1]) + 0.08, goals = data.runs.goal.filter((run) => run[4]);
    const farthest = (values) => values.reduce((most, v) => (Math.abs(v) > most ? Math.abs(v) : most), 0);
    const y = Math.max(side, ...ys.map((values) => farthest(values) + 0.05), ...goals.map((run) => Math.abs(run[4][0]) + 0.08));
    const lowest = zs[5].reduce((least, v) => (isKnown(v) && v < least ? v : least), robot.hinge_z_m - robot.arm_m);
    return { y, low: Math.min(lowest, ...goals.map((run) => run[4][1])) - 0.07, high: robot.hinge_z_m + 0.09 };
  })();

  function drawScene() {
    const [p, width, height] = pen(scene);
    const scale = Math.min(width / (2 * frame.y), height / (frame.high - frame.low));
    const X = (y) => width / 2 + y * scale, Y = (z) => height / 2 - (z - (frame.low + frame.high) / 2) * scale;
    const line = (points, colour, thick, dash = []) => {
      p.strokeStyle = tableColour(colour);
      p.lineWidth = thick;
      p.setLineDash(dash);
      p.beginPath();
      points.forEach(([y, z], i) => (i ? p.lineTo(X(y), Y(z)) : p.moveTo(X(y), Y(z))));
      p.stroke();
      p.setLineDash([]);
    };
    const disc = (y, z, radius, colour, alpha = 1) => {
      p.globalAlpha = alpha;
      p.fillStyle = tableColour(colour);
      p.beginPath();
      p.arc(X(y), Y(z), radius, 0, 7);
      p.fill();
      p.globalAlpha = 1;
    };
    const ring = ([y, z], radius, colour) => {
      const [x, v] = [X(y), Y(z)];
      p.strokeStyle = tableColour(colour);
      p.lineWidth = 2.5;
      p.beginPath();
      p.arc(x, v, radius, 0, 7);
      p.moveTo(x - 5, v);
      p.lineTo(x + 5, v);
      p.moveTo(x, v - 5);
      p.lineTo(x, v + 5);
      p.stroke();
    };
    const i = tickAt(now), hinge = robot.hinge_z_m, [, , , state, target, shelf] = runAt("goal", now);

    for (let y = -Math.floor(frame.y * 10) / 10; y <= frame.y; y += 0.1) line([[y, frame.low], [y, frame.high]], "line", 0.5);
    for (let z = Math.ceil(frame.low * 10) / 10; z <= frame.high; z += 0.1) line([[-frame.y, z], [frame.y, z]], "line", 0.5);
    line([[robot.hard_m[0], hinge], [robot.hard_m[1], hinge]], "soft", 5);
    for (const y of robot.hard_m) line([[y, hinge + 0.02], [y, hinge - 0.02]], "ink", 6);
    for (const y of robot.soft_m) line([[y, hinge + 0.04], [y, hinge - 0.03]], "warning", 2, [4, 2]);
    p.textAlign = "center";
    p.fillStyle = tableColour("soft");
    for (const y of robot.soft_m) p.fillText(`${y} m`, X(y), Y(hinge + 0.05));

    if (shelf) line([[shelf[0], shelf[1] - 0.004], [shelf[0] - 0.3, shelf[1] - 0.004]], "soft", Math.max(3, 0.008 * scale));
    const bodies = BODIES.map((_, b) => spotBetween(t, [ys[b], zs[b]], now));
    if (target) ring(target, robot.radius_m * scale, BY_STATE[state] || "soft");
    const from = tickAt(now - 2); // trail of the tip over two seconds
    for (let k = from; k < i; k++) {
      if (![zs[5][k], zs[5][k + 1]].every(isKnown) || t[k + 1] - t[k] > 0.5) continue;
      p.globalAlpha = 0.15 + 0.75 * ((t[k] - now + 2) / 2);
      line([[ys[5][k], zs[5][k]], [ys[5][k + 1], zs[5][k + 1]]], "measured", 2.5);
    }
    if (bodies[5] && isKnown(ys[5][i])) line([[ys[5][i], zs[5][i]], bodies[5]], "measured", 2.5);
    p.globalAlpha = 1;
    const seen = bodies.filter(Boolean);
    if (seen.length > 1) {
      const outline = armOutline(seen, ARM_RADII_M);
      p.fillStyle = tableColour("arm");
      p.beginPath();
      for (const [y, z] of outline) p.lineTo(X(y), Y(z));
      p.fill();
      line([...outline, outline[0]], "ink", 1.5);
    }
    for (const spot of bodies.slice(1, -1)) if (spot) disc(...spot, 2, "floor");
    if (bodies[0]) {
      p.fillStyle = tableColour("ink");
      p.fillRect(X(bodies[0][0]) - 0.03 * scale, Y(hinge + 0.02), 0.06 * scale, 0.04 * scale);
    }
    if (bodies[5]) disc(...bodies[5], 5, "measured");
    if (seen.length < BODIES.length) {
      p.fillStyle = tableColour("stop");
      p.textAlign = "left";
      p.fillText(seen.length ? `not tracked: ${BODIES.filter((_, b) => !bodies[b]).join(", ")}` : "no body tracked", 10, 18);
    }
  }

  // ---- charts

  const LEFT = 50, RIGHT = 8;
  const DASHES = { requested: [5, 3], floor: [2, 2] };
  const PANELS = [
    { name: "tip", unit: "m", digits: 3, curves: [["y", ys[5], "measured"], ["z", zs[5], "second"], ["target y", targetY, "requested"], ["target z", targetZ, "requested"]] },
    { name: "cart position", unit: "m", digits: 3, curves: [["measured", ys[0], "measured"]], marks: robot.soft_m },
    { name: "cart velocity", unit: "m/s", digits: 2, curves: [["requested", of.cart_requested, "requested"], ["sent", of.cart_sent, "sent"], ["measured", of.cart_measured, "measured"]] },
    { name: "pressure", unit: "kPa", digits: 2, curves: [["requested", of.pressure_requested, "requested"], ["sent", of.pressure_sent, "sent"], ["measured", of.pressure_measured, "measured"]] },
    { name: "lateness", unit: "ms", digits: 2, curves: [["tick", of.late_ms, "measured"], ["policy", of.policy_ms, "second"], ["age of mocap", of.mocap_age_ms, "floor"]] },
  ];
  const MODES = { armed: "good", arming: "accent", stopping: "warning", stopped: "stop", disarmed: "floor" };

  function view() {
    if (held) return held;
    const length = Number(at("window").value);
    if (!length || length >= end) return [0, Math.max(end, 1e-3)];
    const from = Math.min(Math.max(0, now - length / 2), end - length);
    return [from, from + length];
  }
  const timeOf = (x, [from, to]) => from + ((x - LEFT) / (charts.clientWidth - LEFT - RIGHT)) * (to - from);
  const modes = document.createElement("canvas"), cursor = document.createElement("div");
  let plots = [], shown = [0, 1];

  function panel({ name, unit, digits, curves, marks = [] }, k) {
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    const values = curves.map(() => document.createElement("output"));
    caption.append(`${name} (${unit})`, ...curves.map(([word, , colour], c) => {
      const entry = Object.assign(document.createElement("span"), { textContent: `${word} ` });
      entry.style.color = tableColour(colour);
      entry.append(values[c]);
      return entry;
    }));
    figure.append(caption);
    charts.append(figure);
    const lines = curves.map(([word, , colour]) => ({ name: word, colour, width: 1.5, dash: DASHES[colour] }));
    const limits = marks.map((mark) => ({ name: `${mark}`, colour: "warning", width: 1 }));
    const isLast = k === PANELS.length - 1;
    const plot = new uPlot({
      width: charts.clientWidth,
      height: isLast ? 110 : 88,
      padding: [6, RIGHT, 4, 0],
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false, range: () => shown }, y: { range: (_, low, high) => paddedRange(low !== null && unit === "ms" ? Math.min(low, 0) : low, high) } },
      axes: [
        chartAxis({ show: isLast, size: 24, space: 60, values: (_, at) => at.map((time) => `${Number(time.toFixed(6))} s`) }),
        chartAxis({ size: LEFT, gap: 3, space: 22 }),
      ],
      series: chartSeries([...lines, ...limits]),
    }, [t, ...curves.map(([, samples]) => samples), ...marks.map((mark) => t.map(() => mark))], figure);
    return { plot, read: (i) => curves.forEach(([, samples], c) => { values[c].textContent = number(samples[i], digits); }) };
  }

  function build() { // again after a change of width or colours
    plots.forEach(({ plot }) => plot.destroy());
    modes.className = "modes";
    cursor.className = "cursor";
    charts.replaceChildren(modes, cursor);
    shown = view();
    plots = PANELS.map(panel);
    drawModes();
    draw();
  }

  function drawModes() { // the mode as a band of colours, with a tick for each event
    const [p] = pen(modes), x = (time) => LEFT + ((time - shown[0]) / (shown[1] - shown[0])) * (charts.clientWidth - LEFT - RIGHT);
    p.fillStyle = tableColour("soft");
    p.fillText("mode", 8, 12);
    p.beginPath();
    p.rect(LEFT, 0, charts.clientWidth - LEFT - RIGHT, 20);
    p.clip();
    data.runs.mode.forEach(([since, mode], k) => {
      const until = k + 1 < data.runs.mode.length ? data.runs.mode[k + 1][0] : end;
      p.fillStyle = tableColour(MODES[mode] || "floor");
      p.fillRect(x(since), 4, Math.max(1, x(until) - x(since)), 7);
    });
    p.fillStyle = tableColour("ink");
    for (const moment of moments) p.fillRect(x(moment) - 0.5, 12, 1, 5);
  }

  function drawCharts() {
    const [from, to] = view(), i = tickAt(now);
    if (from !== shown[0] || to !== shown[1]) {
      shown = [from, to];
      plots.forEach(({ plot }) => plot.setScale("x", { min: from, max: to }));
      drawModes();
    }
    const left = LEFT + ((now - from) / (to - from)) * (charts.clientWidth - LEFT - RIGHT);
    cursor.hidden = left < LEFT - 1 || left > charts.clientWidth - RIGHT + 1;
    cursor.style.left = `${left}px`;
    plots.forEach(({ read }) => read(i));
  }

  // ---- texts

  const rows = data.events.map(([time, kind, text]) => {
    const button = document.createElement("button"), item = document.createElement("li");
    const stamp = Object.assign(document.createElement("span"), { className: "at", textContent: clock(time) });
    const words = Object.assign(document.createElement("span"), { className: kind, textContent: text });
    button.type = "button";
    button.title = `${wall(time)} UTC`;
    button.append(stamp, words);
    button.addEventListener("click", () => { go(time); });
    item.append(button);
    return item;
  });
  at("events").append(...rows);
  if (!rows.length) at("events").textContent = "no events";
  let marked = -1;

  function describe() {
    const [, mode] = runAt("mode", now), [, policy] = runAt("policy", now), [, wrong] = runAt("wrong", now);
    const [, count, kind, state, target] = runAt("goal", now), i = tickAt(now), list = at("now");
    const chip = Object.assign(document.createElement("span"), { className: `chip ${mode}`, textContent: mode });
    const word = state === "running" ? state : GOAL_WORDS[state] ?? state;
    let goal = count ? `goal ${count} (${kind}) ${word}` : "no goal yet";
    if (target) {
      const off = isKnown(zs[5][i]) ? Math.hypot(ys[5][i] - target[0], zs[5][i] - target[1]) : null;
      goal = `goal ${count}: y ${Number(target[0].toFixed(3))}, z ${Number(target[1].toFixed(3))} m, ${word}; tip ${isKnown(off) ? `${(off * 100).toFixed(1)} cm off` : "not seen"}`;
    }
    list.replaceChildren(chip, `policy ${policy || "none"}, ${goal}`);
    if (wrong) list.append("; ", Object.assign(document.createElement("span"), { className: "wrong", textContent: wrong.replaceAll(" ", ", ") }));
    const small = Object.assign(document.createElement("small"), { textContent: ` / ${clock(end)} · ${wall(now)} UTC` });
    at("clock").replaceChildren(clock(now), small);
    slider.value = now;
    slider.setAttribute("aria-valuetext", `${now.toFixed(2)} s, ${mode}`);
    const newest = sampleAt(moments, now + 1e-6);
    if (newest !== marked) {
      if (rows[marked]) rows[marked].firstChild.removeAttribute("aria-current");
      marked = newest;
      const row = rows[marked], box = at("events");
      if (row) {
        row.firstChild.setAttribute("aria-current", "true");
        box.scrollTop = row.offsetTop - box.offsetTop - box.clientHeight / 2;
      }
    }
    scene.setAttribute("aria-label", `${clock(now)}, ${mode}: ${goal}`);
  }

  function draw() {
    drawScene();
    drawCharts();
    describe();
  }
  let waiting = false;
  function soon() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }

  // ---- time

  function go(time) {
    now = Math.min(end, Math.max(0, time));
    soon();
  }
  function play(on) {
    playing = on;
    const button = document.querySelector('[data-do="play"]');
    button.textContent = on ? "❚❚" : "▶";
    button.setAttribute("aria-pressed", String(on));
    if (!on) return;
    if (now >= end) now = 0;
    painted = performance.now();
    requestAnimationFrame(advance);
  }
  function advance(stamp) {
    if (!playing) return;
    const passed = Math.max(0, stamp - painted) / 1000;
    painted = stamp;
    now = Math.min(end, now + passed * Number(at("speed").value));
    draw();
    if (now >= end) play(false); else requestAnimationFrame(advance);
  }
  function faster(by) {
    const speed = at("speed");
    speed.selectedIndex = Math.min(speed.length - 1, Math.max(0, speed.selectedIndex + by));
  }
  const still = (time) => { play(false); go(time); };
  const DO = {
    play: () => play(!playing),
    back: () => still(t[Math.max(0, tickAt(now) - 1)]),
    on: () => still(t[Math.min(t.length - 1, tickAt(now) + 1)]),
    "event-back": () => go(moments[sampleAt(moments, now - 0.02)] ?? 0),
    "event-on": () => go(moments[sampleAt(moments, now + 1e-4) + 1] ?? end),
  };
  const KEYS = { " ": DO.play, k: DO.play, n: DO["event-on"], p: DO["event-back"], Home: () => go(0), End: () => go(end), "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1) };

  for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", DO[button.dataset.do]);
  slider.max = end;
  if (end > 300) at("window").value = "60";
  slider.addEventListener("input", () => go(Number(slider.value)));
  at("window").addEventListener("change", soon);
  addEventListener("keydown", (event) => {
    const on = event.target, typed = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (event.ctrlKey || event.metaKey || event.altKey || on.tagName === "SELECT") return;
    if (typed === " " && (on.tagName === "BUTTON" || on.tagName === "SUMMARY")) return; // the key presses the focused button
    let what = KEYS[typed];
    if (event.key === "ArrowLeft") what = event.shiftKey ? () => still(now - 1) : DO.back;
    if (event.key === "ArrowRight") what = event.shiftKey ? () => still(now + 1) : DO.on;
    if (!what) return;
    event.preventDefault();
    what();
  });
  function drag(event) {
    go(timeOf(event.clientX - charts.getBoundingClientRect().left, held));
  }
  charts.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    held = view();
    charts.setPointerCapture(event.pointerId);
    drag(event);
  });
  charts.addEventListener("pointermove", (event) => { if (held) drag(event); });
  for (const over of ["pointerup", "pointercancel"]) charts.addEventListener(over, () => { held = null; soon(); });

  let width = charts.clientWidth;
  new ResizeObserver(() => {
    if (charts.clientWidth === width) return;
    width = charts.clientWidth;
    build();
  }).observe(charts);
  new ResizeObserver(soon).observe(scene);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  addEventListener("hashchange", () => {
    if (linked()) still(Number(linked()));
  });
  build();
})();
