// Panels for this robot's files: logs, incidents and reports.

import { ask } from "../link/api.js";
import { ROLE_LIMITS } from "../view/controls.js";
import { bytes, clock, el, seconds, sentence, worded, words } from "../view/dom.js";
import { Panel } from "./panel.js";

const CONFIRM = "Delete permanently?";
const path = (kind, name) => `api/${kind}/${encodeURIComponent(name)}`;

function entry(name, more, ...buttons) {
  const message = el("span", { class: "more", role: "status" });
  const row = el("li", { class: "file" }, el("div", {}, el("b", {}, name), el("span", { class: "more" }, more), message), el("span", { class: "acts" }, buttons));
  return { row, message };
}

const link = (href, text, properties) => el("a", { class: "button small", href, ...properties }, text);

export class Logs extends Panel {
  // replay(name) starts a replay of a log.
  constructor(replay) {
    super("Logs", "api/logs");
    this.replay = replay;
    this.toDelete = null; // name of the log whose deletion waits for its confirmation
  }

  fill({ directory, logs }) {
    if (!this.place.contains(document.activeElement)) this.toDelete = null;
    this.show(this.list(logs.map((log) => this.log(log)), "No logs."), el("p", { class: "hint" }, `Folder: ${directory}`));
  }

  log(log) {
    const length = log.duration_s === null ? (log.recording ? "being recorded" : "not finished") : seconds(log.duration_s);
    const why = log.recording ? "This log is being recorded." : this.commands ? "" : ROLE_LIMITS.view;
    const button = (text, act, shown = text, kind = "small") => el("button", { type: "button", class: kind, title: why, "aria-disabled": String(Boolean(why)), "aria-label": `${text} ${log.name}`, onclick: (event) => (why ? (made.message.textContent = why) : act(event.target)) }, shown);
    const asked = this.toDelete === log.name ? [CONFIRM, "small danger"] : [];
    const made = entry(log.name, `${clock(log.modified, true)} · ${bytes(log.bytes)} · ${length}`,
      link(path("logs", log.name), "Download", { download: log.name, "aria-label": `Download ${log.name}` }),
      link(`${path("logs", log.name)}/view`, "View", { target: "_blank", rel: "noopener", "aria-label": `View ${log.name}` }),
      button("Replay", () => this.replay(log.name)),
      button("Delete", (pressed) => this.confirm(log, pressed, made.message), ...asked));
    return made.row;
  }

  // Ask for confirmation in the button itself: a dialog would cover Stop. A reload of the list keeps the question.
  confirm(log, pressed, message) {
    if (this.toDelete === log.name) return void this.remove(log, message);
    const back = pressed.textContent;
    this.toDelete = log.name;
    pressed.classList.add("danger");
    pressed.textContent = CONFIRM;
    const reset = () => {
      this.toDelete = null;
      pressed.classList.remove("danger");
      pressed.textContent = back;
    };
    pressed.addEventListener("blur", reset, { once: true });
    pressed.addEventListener("keydown", (event) => event.key === "Escape" && pressed.blur(), { once: true });
  }

  async remove(log, message) {
    message.textContent = "Deleting …";
    try {
      await ask("DELETE", path("logs", log.name), undefined, { raw: true });
      await this.open();
    } catch (error) {
      message.textContent = words(error);
    }
  }
}

export class Incidents extends Panel {
  constructor() {
    super("Incidents", "api/incidents");
  }

  fill({ incidents }) {
    const rows = incidents.map((one) => entry(sentence(worded(one.text)), `${clock(one.time, true)} · ${bytes(one.bytes)} · ${one.name}`, link(path("incidents", one.name), "Download", { download: one.name, "aria-label": `Download ${one.name}` })).row);
    this.show(el("p", { class: "hint" }, "Each emergency stop writes one file: the log around the stop, the configuration and the versions."), this.list(rows, "No incident files."));
  }
}

export class Reports extends Panel {
  constructor() {
    super("Reports", "api/reports");
  }

  fill({ directory, reports }) {
    const rows = reports.map((one) => entry(one.name, `${clock(one.modified, true)} · ${bytes(one.bytes)}`, link(path("reports", one.name), "Open", { target: "_blank", rel: "noopener", "aria-label": `Open ${one.name}` })).row);
    this.show(this.list(rows, `No reports in ${directory}. Write one with softarm diagnose --report ${directory}/NAME.html.`));
  }
}
