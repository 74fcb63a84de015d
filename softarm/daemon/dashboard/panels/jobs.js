// Jobs: start an excitation, a diagnosis or a replay, watch it, and read its report.

import { ask, get, post } from "../link/api.js";
import { ROLE_LIMITS } from "../view/controls.js";
import { clock, el, seconds, sentence, worded, words } from "../view/dom.js";
import { LISTING_S, Panel } from "./panel.js";

const EVERY_MS = 1000;
const FOCUS_MS = 100; // longest time for which a report keeps the keyboard
const LOGS_MAX = 20; // the daemon's own limit for one diagnosis
const STATES = { running: "… running", done: "✓ done", failed: "✕ failed", cancelled: "– cancelled" };
const TITLES = { excite: "Excitation", diagnose: "Diagnosis", replay: "Replay" };
const isRunning = (jobs) => jobs.some((job) => job.state === "running");

export class Jobs extends Panel {
  constructor(follower) {
    super("Jobs", "api/jobs");
    Object.assign(this, { logs: [], chosen: new Set(), excitation: "seed", shown: null, said: "" });
    follower.watchers.add(() => this.place.hidden || this.open());
    // A click into a report moves the focus there, where Space would not stop the robot. The window's event for it may come
    // before the focus has moved, or not at all.
    setInterval(() => document.activeElement?.tagName === "IFRAME" && document.activeElement.blur(), FOCUS_MS);
  }

  async load() {
    const answer = await super.load();
    if (this.logs.length && isRunning(answer.jobs)) return answer; // the daemon reads every log to list them
    const { logs } = await get("api/logs", { seconds: LISTING_S });
    this.logs = logs.slice(0, LOGS_MAX);
    this.chosen = new Set(this.logs.map(({ name }) => name).filter((name) => this.chosen.has(name)));
    return answer;
  }

  fill({ jobs, excitations }) {
    const running = isRunning(jobs);
    if (running && !this.timer) this.timer = setTimeout(() => { this.timer = null; if (!this.place.hidden) this.open(); }, EVERY_MS);
    const why = this.commands ? (running ? "A job is running. Wait for its end or cancel it." : "") : ROLE_LIMITS.view;
    const none = this.chosen.size ? "" : "Choose logs first.";
    this.show(
      this.row("Excitation", "moves the armed robot, and records a log of its own", why, () => this.start({ kind: "excite", excitation: this.excitation }), this.choice(excitations)),
      this.row("Diagnosis", "names what the simulator lacks, from the chosen logs", why || none, () => this.start({ kind: "diagnose", logs: [...this.chosen] })),
      this.row("Replay", "compares the commands of one log bit for bit", why || (this.chosen.size > 1 ? "Choose one log." : none), () => this.start({ kind: "replay", log: [...this.chosen][0] })),
      this.boxes(),
      el("p", { class: "hint", role: "status" }, this.said),
      this.list(jobs.flatMap((job) => this.entry(job)), "No jobs yet."));
  }

  row(title, text, why, act, ...fields) {
    const press = () => { if (why) this.say(why); else act(); };
    const button = el("button", { type: "button", class: "small", title: why, "aria-disabled": String(Boolean(why)), "aria-label": `Start ${title.toLowerCase()}`, onclick: press }, "Start");
    return el("div", { class: "row job" }, el("b", {}, title), el("span", { class: "hint" }, text), fields, button);
  }

  choice(excitations) {
    const options = excitations.map(({ name, duration_s: length, description }) => el("option", { value: name, title: description, selected: name === this.excitation }, `${name}, ${seconds(length)}`));
    return el("select", { "aria-label": "Excitation", onchange: (event) => { this.excitation = event.target.value; } }, options);
  }

  boxes() {
    const box = ({ name, recording, duration_s: length }) => {
      const toggle = ({ target }) => {
        target.toggleAttribute("checked", target.checked); // the list keeps equal rows, and with them the focus
        this.chosen[target.checked ? "add" : "delete"](name);
        this.open();
      };
      const press = (event) => event.key === "Enter" && event.target.click(); // Space stops the robot
      return el("li", {}, el("label", {}, el("input", { type: "checkbox", checked: this.chosen.has(name), onchange: toggle, onkeydown: press }), ` ${name}, ${recording ? "being recorded" : length === null ? "not finished" : seconds(length)}`));
    };
    return el("ul", { class: "logs", "aria-label": "Logs for diagnosis and replay" }, this.logs.map(box));
  }

  entry(job) {
    const took = job.ended ? seconds((new Date(job.ended) - new Date(job.started)) / 1000) : null;
    const button = (text, act) => el("button", { type: "button", class: "small", "aria-label": `${text} job ${job.number}`, onclick: act }, text);
    const running = job.state === "running";
    const bar = running ? el("progress", { max: 1, value: job.share, "aria-label": `Progress of job ${job.number}` }) : null;
    const lines = [...job.sentences, job.progress].filter(Boolean).map((one) => el("span", { class: "more" }, sentence(worded(one))));
    const open = this.shown === job.number;
    const href = job.report && `api/reports/${encodeURIComponent(job.report)}`;
    const row = el("li", { class: `file of-${job.state}`, "data-key": `${job.number} ${job.state}` },
      el("div", {}, el("b", {}, `${TITLES[job.kind]} ${STATES[job.state]}`), el("span", { class: "more" }, [job.text, clock(job.started), took].filter(Boolean).join(" · ")), bar, lines),
      el("span", { class: "acts" },
        running && this.commands ? button("Cancel", () => this.send(() => ask("DELETE", `api/jobs/${job.number}`))) : null,
        href ? button(open ? "Hide report" : "Show report", () => { this.shown = open ? null : job.number; this.open(); }) : null,
        href ? el("a", { class: "button small", href, target: "_blank", rel: "noopener", "aria-label": `Open the report of job ${job.number}` }, "Open") : null));
    return [row, href && open ? el("li", { class: "report" }, el("iframe", { src: href, sandbox: "allow-scripts", tabindex: -1, title: `Report of job ${job.number}` })) : null].filter(Boolean);
  }

  // Start a job; also from the list of logs.
  start(body) {
    return this.send(async () => {
      const job = await post("api/jobs", body);
      if (job.kind === "diagnose") this.shown = job.number; // its report opens by itself
    });
  }

  async send(request) {
    try {
      await request();
      this.said = "";
    } catch (error) {
      this.said = words(error);
    }
    await this.open();
  }

  say(text) {
    this.said = text;
    this.open();
  }
}
