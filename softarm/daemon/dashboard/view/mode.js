// The robot's mode and the active faults, each as text, shape and colour.

import { $, el, svg, setText, render, number, clock, worded, sentence } from "./dom.js";

const ROUND = "M8 1.5a6.5 6.5 0 1 1 0 13a6.5 6.5 0 1 1 0-13z";
const MODES = {
  disarmed: ["Disarmed", "The drive is off and the muscle is vented.", `${ROUND}M8 4a4 4 0 1 0 0 8a4 4 0 1 0 0-8z`],
  arming: ["Arming", "Waiting for the drive and the regulator.", "M8 1.5a6.5 6.5 0 0 1 0 13zM8 1.5a6.5 6.5 0 0 0 0 13v-1.6a4.9 4.9 0 0 1 0-9.8z"],
  armed: ["Armed", "The arm moves when it gets a target. Keep clear of the arm.", "M3.5 1.8L14 8L3.5 14.2z"],
  stopping: ["Stopping", "The cart brakes and holds, the muscle vents. The robot disarms when the arm is still.", "M2 3h12L8 14z"],
  stopped: ["Emergency stop", "", "M5 1h6l4 4v6l-4 4H5l-4-4V5z"],
  unknown: ["No data", "Waiting for the daemon.", "M7 2h2v8H7zM7 12h2v2H7z"],
};
const ESTOP = {
  engaged: "The drive is off. The cause of the stop is still present. Remove it, then press Acknowledge, which also resets a device in fault.",
  latched: "The drive is off and the cause is gone. Make sure that the arm is free, then press Acknowledge.",
};
const SIGNS = {
  stop: ["Stop", "M5 1h6l4 4v6l-4 4H5l-4-4V5z"],
  soft_stop: ["Soft stop", "M2 3h12L8 14z"],
  warn: ["Warning", "M8 1.5L15 14H1z"],
  refusal: ["", "M3 2l5 5l5-5l1 1l-5 5l5 5l-1 1l-5-5l-5 5l-1-1l5-5l-5-5z"],
  device: ["Device", "M2 3h12v8H2zM5 12.5h6V14H5z"],
};

const sign = (path) => svg("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, svg("path", { d: path, "fill-rule": "evenodd" }));

// Return each reason once: refusals of arming, active events, problems of devices.
function reasonsOf(status) {
  const refused = status.mode === "disarmed" || status.mode === "stopped" ? status.arming_refusals : [];
  const all = refused.map((text) => ({ kind: "refusal", text }));
  const add = (kind, text, named = text) => all.some((one) => one.text.includes(text)) || all.push({ kind, text: named });
  for (const { response, text } of status.events) add(response, text);
  for (const [device, text] of Object.entries({ ...status.problems, recorder: status.recorder.problem })) if (text) add("device", text, `${device}: ${text}`);
  return all;
}

export class ModeView {
  constructor() {
    this.spoken = null;
  }

  draw(status) {
    const [name, means, path] = MODES[status.mode] ?? MODES.unknown;
    const pill = $("mode");
    pill.dataset.mode = status.mode;
    render(pill, [status.mode], () => [sign(path), el("span", {}, name)]);
    setText($("mode-title"), name);
    setText($("mode-means"), status.mode === "stopped" ? ESTOP[status.estop] ?? "" : means);
    this.reasons(status);
    if (this.spoken !== null && this.spoken !== name) setText($("spoken"), `${name}. ${status.mode === "stopped" ? ESTOP[status.estop] ?? "" : means}`);
    this.spoken = name;
  }

  reasons(status) {
    const all = reasonsOf(status);
    const title = all.some(({ kind }) => kind === "refusal") ? "Cannot be armed" : "Notices";
    const last = status.last_stop && status.mode !== "armed" ? `Last stop${status.last_stop_at ? ` at ${clock(status.last_stop_at)}` : ""}: ${worded(status.last_stop)}` : null;
    render($("reasons"), [all, last, status.mode], () => [
      all.length ? el("h3", {}, title) : null,
      all.length ? el("ul", { class: "reasons" }, all.map(({ kind, text }) => this.reason(kind, text))) : null,
      status.mode === "disarmed" && !all.length ? el("p", { class: "ready" }, sign("M6 12.6L1.6 8.2l1.5-1.5L6 9.6l6.9-6.9l1.5 1.5z"), "Ready to arm.") : null,
      last ? el("p", { class: "hint" }, last) : null,
    ]);
  }

  // Show the fault and, on a separate line, the next step: the text after the last colon, or after a device's last semicolon.
  reason(kind, text) {
    const [word, path] = SIGNS[kind] ?? SIGNS.warn;
    const cut = text.lastIndexOf(kind === "device" ? "; " : ": ");
    const [fault, next] = cut > 12 ? [text.slice(0, cut), text.slice(cut + 2)] : [text, ""];
    return el("li", { class: `reason ${kind}` }, sign(path), el("div", {}, word ? el("b", { class: "word" }, word) : null, ` ${sentence(worded(fault))}`, next ? el("span", { class: "next" }, `Next: ${worded(next)}`) : null));
  }
}

// Show the newest goal: target, state and requester.
export function drawGoal(status, requester) {
  const { goal, state, reason, closest_m, time_s } = status.goal;
  const values = status.observed?.values ?? [];
  const what = !goal ? "none" : goal.kind === "reach" ? `y ${number(goal.y_m, 3)}, z ${number(goal.z_m, 3)} m` : goal.kind;
  const words = { none: "–", running: "running", reached: "reached ✓", failed: "missed ✕", cancelled: "cancelled" };
  const rows = [
    ["Goal", what], ["State", `${words[state] ?? state}${goal ? `, ${number(time_s, 1, "s")}` : ""}`],
    ["Closest", finiteCm(closest_m)], ["Requested from", (goal && requester) || "–"],
    ["Tip", `y ${number(values[2], 3)}, z ${number(values[3], 3)} m`], ["Cart position", number(values[0] ?? status.rail_position_m, 3, "m")],
    ["Pressure", number(values[7], 1, "kPa")], ["Policy", status.policy || "–"],
  ];
  render($("goal"), [rows, reason], () => [
    ...rows.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))),
    reason ? el("div", { class: "whole" }, el("dt", {}, "Why"), el("dd", {}, sentence(worded(reason)))) : null,
  ]);
}

const finiteCm = (metres) => (metres === null || metres === undefined ? "–" : number(metres * 100, 1, "cm"));
