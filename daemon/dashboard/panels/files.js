// Files of this robot: logs, incidents, reports.

import { ask, get, post } from "../link/api.js";
import { ROLE_SAYS } from "../view/controls.js";
import { bytes, clock, el, seconds, sentence, worded } from "../view/dom.js";
import { Panel } from "./panel.js";

const REPLAY_S = 310; // the daemon gives up after 300
const path = (kind, name) => `api/${kind}/${encodeURIComponent(name)}`;
const words = (error) => (error.reasons ?? [String(error)]).map((one) => sentence(worded(one))).join(". ");

function entry(name, more, ...buttons) {
  const said = el("span", { class: "more", role: "status" });
  const row = el("li", { class: "file" }, el("div", {}, el("b", {}, name), el("span", { class: "more" }, more), said), el("span", { class: "acts" }, buttons));
  return { row, said };
}

const link = (href, text, properties) => el("a", { class: "button small", href, ...properties }, text);

export class Logs extends Panel {
  constructor() {
    super("Logs");
  }

  fetch() {
    return get("api/logs", { seconds: 35 });
  }

  fill({ directory, logs }) {
    this.place.replaceChildren(this.list(logs.map((log) => this.log(log)), "There are no logs."), el("p", { class: "hint" }, `In ${directory}`));
  }

  log(log) {
    const length = log.duration_s === null ? (log.recording ? "being recorded" : "not finished") : seconds(log.duration_s);
    const why = log.recording ? "It is being recorded." : this.commands ? "" : ROLE_SAYS.view;
    const button = (text, act) => el("button", { type: "button", class: "small", title: why, "aria-disabled": String(Boolean(why)), "aria-label": `${text} ${log.name}`, onclick: (event) => (why ? (made.said.textContent = why) : act(event.target)) }, text);
    const made = entry(log.name, `${clock(log.modified, true)} · ${bytes(log.bytes)} · ${length}`,
      link(path("logs", log.name), "Download", { download: log.name, "aria-label": `Download ${log.name}` }),
      button("Replay", () => this.replay(log, made.said)),
      button("Delete", (pressed) => this.sure(log, pressed, made.said)));
    return made.row;
  }

  async replay(log, said) {
    said.textContent = "Replaying in a process of its own, up to five minutes …";
    try {
      const answer = await post(`${path("logs", log.name)}/replay`, undefined, { seconds: REPLAY_S });
      said.textContent = `${answer.same ? "✓ Same commands" : "✕ Other commands"}. ${answer.sentences.map(sentence).join(". ")}`;
    } catch (error) {
      said.textContent = words(error);
    }
  }

  // Asked once more, in its place: nothing covers the stop.
  sure(log, pressed, said) {
    const back = pressed.textContent;
    if (pressed.dataset.sure) return void this.remove(log, said);
    pressed.dataset.sure = "1";
    pressed.classList.add("danger");
    pressed.textContent = "Delete for good?";
    const calm = () => {
      delete pressed.dataset.sure;
      pressed.classList.remove("danger");
      pressed.textContent = back;
    };
    pressed.addEventListener("blur", calm, { once: true });
    pressed.addEventListener("keydown", (event) => event.key === "Escape" && pressed.blur(), { once: true });
  }

  async remove(log, said) {
    said.textContent = "Deleting …";
    try {
      await ask("DELETE", path("logs", log.name), undefined, { raw: true });
      await this.open();
    } catch (error) {
      said.textContent = words(error);
    }
  }
}

export class Incidents extends Panel {
  constructor() {
    super("Incidents");
  }

  fetch() {
    return get("api/incidents", { seconds: 35 });
  }

  fill({ incidents }) {
    const rows = incidents.map((one) => entry(sentence(worded(one.text)), `${clock(one.time, true)} · ${bytes(one.bytes)} · ${one.name}`, link(path("incidents", one.name), "Download", { download: one.name, "aria-label": `Download ${one.name}` })).row);
    this.place.replaceChildren(el("p", { class: "hint" }, "Each emergency stop leaves a file to send: the log around it, configuration, versions."), this.list(rows, "No emergency stop has left one yet."));
  }
}

export class Reports extends Panel {
  constructor() {
    super("Reports");
  }

  fetch() {
    return get("api/reports", { seconds: 35 });
  }

  fill({ directory, reports }) {
    const rows = reports.map((one) => entry(one.name, `${clock(one.modified, true)} · ${bytes(one.bytes)}`, link(path("reports", one.name), "Open", { target: "_blank", rel: "noopener", "aria-label": `Open ${one.name}` })).row);
    this.place.replaceChildren(this.list(rows, `No reports in ${directory} yet: softarm diagnose --report ${directory}/NAME.html leaves one there.`));
  }
}
