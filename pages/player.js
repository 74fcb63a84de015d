// A log, played: the arm at a moment, charts around it, what happened beside it. Data: softarm/recordings/player.py.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const at = (id) => document.getElementById(id);
  const scene = at("scene"), charts = at("charts"), slider = at("time");
  const { robot } = data;

  // ---- data

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const NAN = 65535, STEPS = 65534;
  function curve(packed) {
    const step = (packed.high - packed.low) / STEPS;
    return Float64Array.from(new Uint16Array(bytes(packed.levels)), (v) => (v === NAN ? NaN : packed.low + v * step));
  }
  const t = Float64Array.from(new Uint32Array(bytes(data.stamps)), (v) => v / 1e4);
  const of = Object.fromEntries(Object.entries(data.series).map(([name, packed]) => [name, curve(packed)]));
  const BODIES = ["cart", "link1", "link2", "link3", "link4", "link5"];
  const ys = BODIES.map((name) => of[`${name}_y`]), zs = BODIES.map((name) => of[`${name}_z`]);
  const end = t[t.length - 1], moments = data.events.map((event) => event[0]);

  function last(stamp, list, time) { // index of the last of a list whose stamp is not after a time; -1: none
    let low = 0, high = list.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (stamp(list[middle]) <= time) low = middle + 1; else high = middle;
    }
    return low - 1;
  }
  const tickAt = (time) => Math.max(0, last((v) => v, t, time + 1e-6));
  const runAt = (name, time) => data.runs[name][Math.max(0, last((run) => run[0], data.runs[name], time + 1e-6))] || [];

  function steps(name, pick) { // a run as a curve of its own: a value for every tick
    const values = new Float64Array(t.length).fill(NaN), runs = data.runs[name];
    for (let k = 0; k < runs.length; k++) {
      const value = pick(runs[k]), to = k + 1 < runs.length ? runs[k + 1][0] : Infinity;
      if (value === null) continue;
      for (let i = Math.max(0, tickAt(runs[k][0])); i < t.length && t[i] < to - 1e-6; i++) if (t[i] >= runs[k][0] - 1e-6) values[i] = value;
    }
    return values;
  }
  const targetY = steps("goal", (run) => (run[4] && run[3] === "running" ? run[4][0] : null));
  const targetZ = steps("goal", (run) => (run[4] && run[3] === "running" ? run[4][1] : null));

  // ---- what is shown

  const first = data.runs.mode.find((run) => run[1] === "armed" || run[1] === "arming");
  const asked = /[#&]t=([0-9.]+)/.exec(location.hash);
  let now = Math.min(end, asked ? Number(asked[1]) : first ? first[0] : 0);
  let playing = false, painted = 0, held = null; // held: the charts' view while a pointer drags in them

  const number = (v, digits) => (v === v ? v.toFixed(digits) : "–");
  const clock = (time) => {
    const minutes = Math.floor(time / 60), hours = Math.floor(minutes / 60), two = (v) => String(v).padStart(2, "0");
    return (hours ? `${hours}:${two(minutes % 60)}` : String(minutes)) + `:${(time % 60).toFixed(2).padStart(5, "0")}`;
  };
  const wall = (time) => new Date(data.begin_ms + time * 1000).toISOString().slice(11, 23);

  function style() {
    const found = getComputedStyle(document.documentElement), font = getComputedStyle(document.body).fontFamily;
    return { colour: (name) => found.getPropertyValue(`--${name}`).trim(), font };
  }

  function pen(canvas, look, ground) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const drawn = canvas.getContext("2d");
    drawn.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawn.fillStyle = look.colour(ground);
    drawn.fillRect(0, 0, width, height);
    drawn.font = `12px ${look.font}`;
    drawn.lineJoin = drawn.lineCap = "round";
    return [drawn, width, height];
  }

  // ---- the arm

  const BY_STATE = { running: "nominal", reached: "good", failed: "stop" };
  const frame = (() => { // what has to be in the picture, in metres
    const side = Math.max(-robot.hard_m[0], robot.hard_m[1]) + 0.08, goals = data.runs.goal.filter((run) => run[4]);
    const farthest = (values) => values.reduce((most, v) => (Math.abs(v) > most ? Math.abs(v) : most), 0);
    const y = Math.max(side, ...ys.map((values) => farthest(values) + 0.05), ...goals.map((run) => Math.abs(run[4][0]) + 0.08));
    const lowest = zs[5].reduce((least, v) => (v < least ? v : least), robot.hinge_z_m - robot.arm_m);
    return { y, low: Math.min(lowest, ...goals.map((run) => run[4][1])) - 0.07, high: robot.hinge_z_m + 0.09 };
  })();

  function drawScene(look) {
    const [p, width, height] = pen(scene, look, "panel");
    const scale = Math.min(width / (2 * frame.y), height / (frame.high - frame.low));
    const X = (y) => width / 2 + y * scale, Y = (z) => height / 2 - (z - (frame.low + frame.high) / 2) * scale;
    const line = (points, colour, thick, dash = []) => {
      p.strokeStyle = look.colour(colour);
      p.lineWidth = thick;
      p.setLineDash(dash);
      p.beginPath();
      points.forEach(([y, z], i) => (i ? p.lineTo(X(y), Y(z)) : p.moveTo(X(y), Y(z))));
      p.stroke();
      p.setLineDash([]);
    };
    const disc = (y, z, radius, colour, alpha = 1) => {
      p.globalAlpha = alpha;
      p.fillStyle = look.colour(colour);
      p.beginPath();
      p.arc(X(y), Y(z), radius, 0, 7);
      p.fill();
      p.globalAlpha = 1;
    };
    const i = tickAt(now), hinge = robot.hinge_z_m, [, , , state, target, shelf] = runAt("goal", now);

    for (let y = -Math.floor(frame.y * 10) / 10; y <= frame.y; y += 0.1) line([[y, frame.low], [y, frame.high]], "line", 0.5);
    for (let z = Math.ceil(frame.low * 10) / 10; z <= frame.high; z += 0.1) line([[-frame.y, z], [frame.y, z]], "line", 0.5);
    line([[robot.hard_m[0], hinge + 0.03], [robot.hard_m[1], hinge + 0.03]], "floor", 5);
    for (const y of robot.hard_m) line([[y, hinge + 0.06], [y, hinge]], "stop", 4);
    for (const y of robot.soft_m) line([[y, hinge + 0.06], [y, frame.low]], "nominal", 1.2, [3, 5]);
    p.textAlign = "center";
    p.fillStyle = look.colour("soft");
    for (const y of robot.soft_m) p.fillText(`${y} m`, X(y), Y(hinge + 0.067));

    if (shelf) line([[shelf[0], shelf[1] - 0.004], [shelf[0] - 0.3, shelf[1] - 0.004]], "soft", Math.max(3, 0.008 * scale));
    if (target) {
      const colour = BY_STATE[state] || "soft";
      disc(target[0], target[1], robot.radius_m * scale, colour, 0.25);
      disc(target[0], target[1], 3.5, colour);
    }
    const from = tickAt(now - 2); // the tip's trail, two seconds of it
    for (let k = from; k < i; k++) {
      if (zs[5][k] !== zs[5][k] || zs[5][k + 1] !== zs[5][k + 1] || t[k + 1] - t[k] > 0.5) continue;
      p.globalAlpha = 0.15 + 0.75 * ((t[k] - now + 2) / 2);
      line([[ys[5][k], zs[5][k]], [ys[5][k + 1], zs[5][k + 1]]], "patched", 2.5);
    }
    p.globalAlpha = 1;
    const seen = BODIES.map((_, b) => b).filter((b) => ys[b][i] === ys[b][i] && zs[b][i] === zs[b][i]);
    for (const [colour, more] of [["ink", 2], ["paper", -1]]) { // a beam with an edge, thinner towards its tip
      for (let k = 0; k + 1 < seen.length; k++) {
        const [a, b] = [seen[k], seen[k + 1]];
        line([[ys[a][i], zs[a][i]], [ys[b][i], zs[b][i]]], colour, Math.max(5, (0.058 - 0.0022 * a) * scale) + more);
      }
    }
    for (const b of seen.slice(1, -1)) disc(ys[b][i], zs[b][i], 2, "floor");
    if (seen.includes(0)) {
      p.fillStyle = look.colour("ink");
      p.fillRect(X(ys[0][i]) - 0.045 * scale, Y(hinge + 0.045), 0.09 * scale, 0.05 * scale);
    }
    if (seen.includes(5)) disc(ys[5][i], zs[5][i], 5, "patched");
    if (seen.length < BODIES.length) {
      p.fillStyle = look.colour("stop");
      p.textAlign = "left";
      p.fillText(seen.length ? `not seen: ${BODIES.filter((_, b) => !seen.includes(b)).join(", ")}` : "the cameras saw nothing", 10, 18);
    }
  }

  // ---- charts

  const LEFT = 46, RIGHT = 8, TOP = 24, BOTTOM = 22, HEAD = 19;
  const PANELS = [
    { name: "tip", unit: "m", digits: 3, curves: [["y", ys[5], "patched"], ["z", zs[5], "ceiling"], ["target y", targetY, "nominal", [4, 4]], ["target z", targetZ, "good", [4, 4]]] },
    { name: "cart", unit: "m", digits: 3, curves: [["place", ys[0], "patched"]], marks: robot.soft_m },
    { name: "cart", unit: "m/s", digits: 2, curves: [["wanted", of.cart_wanted, "floor"], ["sent", of.cart_sent, "nominal"], ["axis", of.cart_measured, "patched"]] },
    { name: "pressure", unit: "kPa", digits: 2, curves: [["wanted", of.pressure_wanted, "floor"], ["sent", of.pressure_sent, "nominal"], ["measured", of.pressure_measured, "patched"]] },
    { name: "lateness", unit: "ms", digits: 2, curves: [["tick late", of.late_ms, "stop"], ["cameras' age", of.mocap_age_ms, "patched"], ["policy took", of.policy_ms, "ceiling"]] },
  ];
  const MODES = { armed: "good", arming: "patched", stopping: "nominal", stopped: "stop", disarmed: "floor" };

  function view() {
    if (held) return held;
    const length = Number(at("window").value);
    if (!length || length >= end) return [0, Math.max(end, 1e-3)];
    const from = Math.min(Math.max(0, now - length / 2), end - length);
    return [from, from + length];
  }
  const timeOf = (x, [from, to]) => from + ((x - LEFT) / (charts.clientWidth - LEFT - RIGHT)) * (to - from);

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((s) => s * power).find((s) => s >= raw), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) found.push(k * step);
    return [found, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  }

  function range(panel, from, to) {
    let low = Infinity, high = -Infinity;
    for (const [, values] of panel.curves) {
      for (let i = from; i <= to; i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
    }
    for (const mark of panel.marks || []) { low = Math.min(low, mark); high = Math.max(high, mark); }
    if (panel.unit === "ms") low = Math.min(low, 0);
    if (low > high) return [-1, 1];
    const room = 0.08 * (high - low) || Math.abs(high) * 0.1 || 1;
    return [low - room, high + room];
  }

  function trace(p, values, x, y, from, to) { // a polyline; where samples crowd, each pixel's extremes
    let open = false, column = null, low = 0, high = 0;
    const flush = () => {
      if (column === null) return;
      if (open) p.lineTo(column, y(low)); else p.moveTo(column, y(low));
      if (high !== low) p.lineTo(column, y(high));
      open = true;
      column = null;
    };
    p.beginPath();
    for (let i = from; i <= to; i++) {
      const v = values[i];
      if (v !== v) { flush(); open = false; continue; }
      const pixel = Math.round(x(t[i]) * 2) / 2;
      if (pixel === column) { low = Math.min(low, v); high = Math.max(high, v); continue; }
      flush();
      column = pixel;
      low = high = v;
    }
    flush();
    p.stroke();
  }

  let ground = null, groundOf = ""; // the charts without their cursor: drawn anew when the view is another

  function drawCharts(look) {
    const shown = view(), [from, to] = [Math.max(0, tickAt(shown[0])), Math.min(t.length - 1, tickAt(shown[1]) + 1)];
    const width = charts.clientWidth, height = charts.clientHeight, right = width - RIGHT;
    const x = (time) => LEFT + ((time - shown[0]) / (shown[1] - shown[0])) * (right - LEFT);
    const each = (height - TOP - BOTTOM) / PANELS.length;
    const key = [shown, width, height, window.devicePixelRatio, look.colour("paper")].join();
    if (key !== groundOf) {
      groundOf = key;
      drawGround(look, shown, from, to, x, each);
    }
    const [p] = pen(charts, look, "paper");
    p.setTransform(1, 0, 0, 1, 0, 0);
    p.drawImage(ground, 0, 0);
    const ratio = window.devicePixelRatio || 1, i = tickAt(now), cursor = x(now);
    p.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (cursor >= LEFT - 1 && cursor <= right + 1) {
      p.fillStyle = look.colour("ink");
      p.fillRect(cursor - 0.75, TOP - 6, 1.5, height - TOP - BOTTOM + 6);
    }
    PANELS.forEach((panel, k) => { // names with their values: the legend
      let left = LEFT;
      const base = TOP + k * each + 13;
      p.textAlign = "left";
      p.fillStyle = look.colour("ink");
      p.fillText(`${panel.name} (${panel.unit})`, left, base);
      left += p.measureText(`${panel.name} (${panel.unit})`).width + 12;
      for (const [name, values, colour] of panel.curves) {
        const text = `${name} ${number(values[i], panel.digits)}`;
        if (left + p.measureText(text).width > right) break;
        p.fillStyle = look.colour(colour);
        p.fillText(text, left, base);
        left += Math.max(p.measureText(text).width, p.measureText(`${name} −00.00`).width) + 12;
      }
    });
  }

  function drawGround(look, shown, from, to, x, each) {
    ground = ground || document.createElement("canvas");
    const ratio = window.devicePixelRatio || 1, width = charts.clientWidth, height = charts.clientHeight, right = width - RIGHT;
    ground.width = Math.round(width * ratio);
    ground.height = Math.round(height * ratio);
    const p = ground.getContext("2d");
    p.scale(ratio, ratio);
    p.fillStyle = look.colour("paper");
    p.fillRect(0, 0, width, height);
    p.font = `12px ${look.font}`;
    p.lineJoin = "round";
    p.save();
    p.beginPath();
    p.rect(LEFT, 0, right - LEFT, height);
    p.clip();
    data.runs.mode.forEach(([since, mode], k) => {
      const until = k + 1 < data.runs.mode.length ? data.runs.mode[k + 1][0] : end;
      p.fillStyle = look.colour(MODES[mode] || "floor");
      p.fillRect(x(since), 4, Math.max(1, x(until) - x(since)), 7);
    });
    p.fillStyle = look.colour("ink");
    for (const moment of moments) p.fillRect(x(moment) - 0.5, 12, 1, 5);
    p.restore();
    p.fillStyle = look.colour("soft");
    p.textAlign = "right";
    p.fillText("mode", LEFT - 6, 12);
    PANELS.forEach((panel, k) => {
      const top = TOP + k * each + HEAD, bottom = TOP + (k + 1) * each - 7, [low, high] = range(panel, from, to);
      const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
      const [marks, decimals] = ticks(low, high, Math.max(3, (bottom - top) / 22));
      p.textAlign = "right";
      for (const mark of marks) {
        p.fillStyle = look.colour("line");
        p.fillRect(LEFT, Math.round(y(mark)), right - LEFT, 1);
        p.fillStyle = look.colour("soft");
        p.fillText(mark.toFixed(decimals), LEFT - 6, y(mark) + 4);
      }
      p.save();
      p.beginPath();
      p.rect(LEFT, top - 2, right - LEFT, bottom - top + 4);
      p.clip();
      for (const mark of panel.marks || []) {
        p.fillStyle = look.colour("nominal");
        p.fillRect(LEFT, Math.round(y(mark)), right - LEFT, 1);
      }
      for (const [, values, colour, dash] of panel.curves) {
        p.strokeStyle = look.colour(colour);
        p.setLineDash(dash || []);
        p.lineWidth = 1.5;
        trace(p, values, x, y, from, to);
      }
      p.restore();
    });
    const [marks, decimals] = ticks(shown[0], shown[1], Math.max(2, (right - LEFT) / 100));
    p.textAlign = "center";
    p.fillStyle = look.colour("soft");
    for (const mark of marks) p.fillText(`${mark.toFixed(decimals)} s`, Math.min(Math.max(x(mark), LEFT + 12), right - 16), height - 6);
  }

  // ---- words

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
  if (!rows.length) at("events").textContent = "nothing";
  let marked = -1;

  function tell() {
    const [, mode] = runAt("mode", now), [, policy] = runAt("policy", now), [, wrong] = runAt("wrong", now);
    const [, count, kind, state, target] = runAt("goal", now), i = tickAt(now), list = at("now");
    const chip = Object.assign(document.createElement("span"), { className: `chip ${mode}`, textContent: mode });
    let goal = count ? `goal ${count} (${kind}) ${state}` : "no goal yet";
    if (target) {
      const off = Math.hypot(ys[5][i] - target[0], zs[5][i] - target[1]);
      goal = `goal ${count}: y ${Number(target[0].toFixed(3))}, z ${Number(target[1].toFixed(3))} m, ${state}; tip ${off === off ? `${(off * 100).toFixed(1)} cm off` : "not seen"}`;
    }
    list.replaceChildren(chip, `policy ${policy || "none"}, ${goal}`);
    if (wrong) list.append("; ", Object.assign(document.createElement("span"), { className: "wrong", textContent: wrong.replaceAll(" ", ", ") }));
    const small = Object.assign(document.createElement("small"), { textContent: ` / ${clock(end)} · ${wall(now)} UTC` });
    at("clock").replaceChildren(clock(now), small);
    slider.value = now;
    slider.setAttribute("aria-valuetext", `${now.toFixed(2)} s, ${mode}`);
    const newest = last((v) => v, moments, now + 1e-6);
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
    const look = style();
    drawScene(look);
    drawCharts(look);
    tell();
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
    "event-back": () => go(moments[last((v) => v, moments, now - 0.02)] ?? 0),
    "event-on": () => go(moments[last((v) => v, moments, now + 1e-4) + 1] ?? end),
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
    if (typed === " " && (on.tagName === "BUTTON" || on.tagName === "SUMMARY")) return; // presses what has the focus
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

  new ResizeObserver(soon).observe(charts);
  new ResizeObserver(soon).observe(scene);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", soon);
  addEventListener("hashchange", () => {
    const wanted = /[#&]t=([0-9.]+)/.exec(location.hash);
    if (wanted) still(Number(wanted[1]));
  });
  draw();
})();
