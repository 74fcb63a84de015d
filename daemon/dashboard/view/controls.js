// The buttons: what each asks of the daemon, when it can be pressed, and what came of it.

import { ask, post } from "../link/api.js";
import { $, el, say, worded, sentence } from "./dom.js";

export const ROLE_SAYS = {
  none: "You are not logged in.",
  stop: "Your login may stop, nothing else.",
  view: "Your login may look and stop, nothing else: log in with the token of api.token_file.",
};

const goal = (body) => () => post("api/goal", body);
// why(status): why not now; an empty text: it can be pressed.
const BUTTONS = {
  "do-arm": {
    done: "Arming.",
    send: () => post("api/arm"),
    why: ({ mode }) => ({ arming: "It is being armed.", armed: "It is armed already.", stopping: "It is stopping: wait until it is disarmed.", stopped: "Acknowledge the emergency stop first." })[mode],
  },
  "do-disarm": { done: "Disarming.", send: () => post("api/disarm"), why: ({ mode }) => (["armed", "arming"].includes(mode) ? "" : "It is not armed.") },
  "do-acknowledge": {
    done: "Acknowledged: disarmed.",
    send: () => post("api/acknowledge"),
    why: ({ mode, estop }) => (mode !== "stopped" ? "There is no emergency stop to acknowledge." : estop === "engaged" ? "What stopped it is still there." : ""),
  },
  "do-hold": { done: "Holding.", send: goal({ kind: "hold" }), why: ({ mode }) => (mode === "armed" ? "" : "Arm it first.") },
  "do-run": { done: "Running.", send: goal({ kind: "run" }), why: ({ mode }) => (mode === "armed" ? "" : "Arm it first.") },
  "do-cancel": {
    done: "Goal taken back: it holds.",
    send: () => ask("DELETE", "api/goal"),
    why: ({ mode, goal: { state } }) => (mode === "armed" && state === "running" ? "" : "No goal is running."),
  },
  "do-reach": { why: ({ mode }) => (mode === "armed" ? "" : "Arm it first.") },
};

// Says what came of something, beneath the drawing; reasons are the daemon's.
export function told(kind, title, reasons = []) {
  const list = reasons.length ? el("ul", {}, reasons.map((reason) => el("li", {}, sentence(worded(reason))))) : null;
  $("said").replaceChildren(el("div", { class: `notice ${kind}` }, el("b", {}, title), list));
}

export async function attempt(title, send, done) {
  try {
    const answer = await send();
    const warnings = answer?.warnings ?? [];
    told(warnings.length ? "warned" : "done", done ?? title, warnings);
    return answer;
  } catch (error) {
    told("refused", error.status === 0 ? `${title}: not known whether it was done` : `${title}: refused`, error.reasons ?? [String(error)]);
    return null;
  }
}

export class Controls {
  constructor() {
    this.role = "command";
    this.live = false;
    for (const [id, button] of Object.entries(BUTTONS)) {
      const node = $(id);
      node.addEventListener("click", (event) => {
        const why = this.why(button);
        if (!why || (id === "do-reach" && this.role === "command" && this.live)) return void (button.send && attempt(node.textContent, button.send, button.done));
        event.preventDefault();
        say($("why-not"), `${node.textContent}: ${why}`);
      });
    }
  }

  // Why a button cannot be pressed now; empty: it can.
  why(button) {
    if (this.role !== "command") return ROLE_SAYS[this.role ?? "none"];
    if (!this.live || !this.status) return "No data from the daemon.";
    return button.why(this.status) || "";
  }

  draw(status, live, role) {
    Object.assign(this, { status, live, role });
    for (const [id, button] of Object.entries(BUTTONS)) {
      const node = $(id);
      const why = this.why(button);
      if (node.title !== why) node.title = why;
      if (node.getAttribute("aria-disabled") !== String(Boolean(why))) node.setAttribute("aria-disabled", String(Boolean(why)));
    }
    const shared = role === "command" ? "" : ROLE_SAYS[role ?? "none"];
    if (shared) say($("why-not"), shared);
    else if (this.mode !== status?.mode) say($("why-not"), "");
    this.mode = status?.mode;
    $("do-arm").classList.toggle("primary", status?.mode === "disarmed" && status.arming_refusals.length === 0);
    $("do-acknowledge").classList.toggle("primary", status?.mode === "stopped" && status.estop === "latched");
  }

  // A target, wherever it comes from.
  reach({ y_m, z_m }) {
    const title = `Target y ${Number.isFinite(y_m) ? y_m.toFixed(3) : "?"}, z ${Number.isFinite(z_m) ? z_m.toFixed(3) : "?"} m`.replace(/-/g, "−");
    if (!Number.isFinite(y_m) || !Number.isFinite(z_m)) return told("refused", `${title}: not sent`, ["y and z have to be numbers, in metres"]);
    if (this.role !== "command") return told("refused", `${title}: not sent`, [ROLE_SAYS[this.role ?? "none"]]);
    return attempt(title, goal({ kind: "reach", y_m, z_m }), `${title}: taken`);
  }
}
