// The buttons: the request of each, when it is enabled, and the result.

import { ask, post } from "../link/api.js";
import { $, el, setText, worded, sentence } from "./dom.js";

export const ROLE_LIMITS = {
  none: "You are not logged in.",
  stop: "Your token may only stop the robot.",
  view: "Your token may only view and stop. To control the robot, log in with the token of api.token_file.",
};

const FAULTS = ["rail_fault", "regulator_fault"]; // which an acknowledgement resets
const goal = (body) => () => post("api/goal", body);
// why(status) returns why the button is disabled, or an empty text.
const BUTTONS = {
  "do-arm": {
    done: "Arming.",
    send: () => post("api/arm"),
    why: ({ mode }) => ({ arming: "The robot is arming.", armed: "The robot is already armed.", stopping: "The robot is stopping. Wait until it is disarmed.", stopped: "Acknowledge the emergency stop first." })[mode],
  },
  "do-disarm": { done: "Disarming.", send: () => post("api/disarm"), why: ({ mode }) => (["armed", "arming"].includes(mode) ? "" : "The robot is not armed.") },
  "do-acknowledge": {
    done: "Acknowledged. The robot is disarmed.",
    send: () => post("api/acknowledge"),
    // While a cause is present the request is refused, but it resets the devices' faults.
    why: ({ mode, events }) => (mode === "stopped" || events.some(({ name }) => FAULTS.includes(name)) ? "" : "No emergency stop is latched, and no device reports a fault."),
  },
  "do-hold": { done: "Holding.", send: goal({ kind: "hold" }), why: ({ mode }) => (mode === "armed" ? "" : "Arm the robot first.") },
  "do-run": { done: "Running.", send: goal({ kind: "run" }), why: ({ mode }) => (mode === "armed" ? "" : "Arm the robot first.") },
  "do-cancel": {
    done: "Goal cancelled. The robot holds.",
    send: () => ask("DELETE", "api/goal"),
    why: ({ mode, goal: { state } }) => (mode === "armed" && state === "running" ? "" : "No goal is running."),
  },
  "do-reach": { why: ({ mode }) => (mode === "armed" ? "" : "Arm the robot first.") },
};

// Show the result of a request below the drawing, with the daemon's reasons.
function showResult(kind, title, reasons = []) {
  const list = reasons.length ? el("ul", {}, reasons.map((reason) => el("li", {}, sentence(worded(reason))))) : null;
  $("said").replaceChildren(el("div", { class: `notice ${kind}` }, el("b", {}, title), list));
}

export async function attempt(title, send, done) {
  try {
    const answer = await send();
    const warnings = answer?.warnings ?? [];
    showResult(warnings.length ? "warned" : "done", done ?? title, warnings);
    return answer;
  } catch (error) {
    showResult("refused", error.status === 0 ? `${title}: no answer, result unknown` : `${title}: refused`, error.reasons ?? [String(error)]);
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
        setText($("why-not"), `${node.textContent}: ${why}`);
      });
    }
  }

  // Return why a button is disabled now, or an empty text.
  why(button) {
    if (this.role !== "command") return ROLE_LIMITS[this.role ?? "none"];
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
    const shared = role === "command" ? "" : ROLE_LIMITS[role ?? "none"];
    if (shared) setText($("why-not"), shared);
    else if (this.mode !== status?.mode) setText($("why-not"), "");
    this.mode = status?.mode;
    $("do-arm").classList.toggle("primary", status?.mode === "disarmed" && status.arming_refusals.length === 0);
    $("do-acknowledge").classList.toggle("primary", status?.mode === "stopped" && status.estop === "latched");
  }

  // Send a target.
  reach({ y_m, z_m }) {
    const title = `Target y ${Number.isFinite(y_m) ? y_m.toFixed(3) : "?"}, z ${Number.isFinite(z_m) ? z_m.toFixed(3) : "?"} m`.replace(/-/g, "−");
    if (!Number.isFinite(y_m) || !Number.isFinite(z_m)) return showResult("refused", `${title}: not sent`, ["y and z must be numbers in metres"]);
    if (this.role !== "command") return showResult("refused", `${title}: not sent`, [ROLE_LIMITS[this.role ?? "none"]]);
    return attempt(title, goal({ kind: "reach", y_m, z_m }), `${title}: accepted`);
  }
}
