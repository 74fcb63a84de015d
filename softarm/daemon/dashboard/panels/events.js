// The event history, followed while the page is open, and the goals that it reports.

import { get } from "../link/api.js";
import { clock, el, sentence, worded } from "../view/dom.js";
import { Panel } from "./panel.js";

const EVERY_MS = 1000;
const KEPT = 500;
const SHOWN = 200;
const TARGET = /^goal (.*?) requested from/;

// Polls the events and notifies its watchers of new ones.
export class Follower {
  constructor() {
    this.events = [];
    this.watchers = new Set();
    this.run = null;
  }

  start() {
    if (this.timer) return;
    this.timer = setInterval(() => document.hidden || this.poll(), EVERY_MS);
    this.poll();
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
  }

  async poll() {
    if (this.polling) return;
    this.polling = true;
    try {
      const newest = this.events.at(-1)?.number;
      const answer = await get(newest === undefined ? `api/events?limit=${KEPT}` : `api/events?since=${newest}&limit=${KEPT}`, { seconds: 3 });
      const restarted = this.run !== null && answer.run !== this.run;
      this.run = answer.run;
      if (restarted) this.events = [];
      else if (answer.events.length || newest === undefined) {
        this.events = [...this.events, ...answer.events].slice(-KEPT);
        this.watchers.forEach((watcher) => watcher());
      }
    } catch {
      // the page already reports the lost connection
    } finally {
      this.polling = false;
    }
  }

  // Return where a goal was requested from, or null until its event arrives.
  requester(goal) {
    const request = this.events.findLast((event) => event.kind === "request" && event.what === "goal" && event.accepted);
    const [kind, ...place] = /^goal (\w+)(?: y (\S+), z (\S+) m)?/.exec(request?.text ?? "")?.slice(1) ?? [];
    if (!goal || kind !== goal.kind) return null;
    const same = kind !== "reach" || [goal.y_m, goal.z_m].every((value, k) => Math.abs(value - Number(place[k])) < 1e-4);
    return same ? request.who : null;
  }

  // Return every accepted goal with its end, newest first.
  goals() {
    const goals = [];
    for (const event of this.events) {
      if (event.kind === "request" && event.what === "goal" && event.accepted) {
        if (goals.length && !goals.at(-1).end) goals.at(-1).end = { what: "cancelled", text: "replaced by another goal" };
        goals.push({ request: event, target: TARGET.exec(event.text)?.[1] ?? event.text, end: null });
      } else if (event.kind === "goal" && goals.length && !goals.at(-1).end) goals.at(-1).end = event;
    }
    return goals.reverse();
  }
}

export class EventsPanel extends Panel {
  constructor(follower) {
    super("Events");
    this.follower = follower;
    follower.watchers.add(() => this.place.hidden || this.open());
  }

  open() {
    const entries = this.follower.events.slice(-SHOWN).reverse().map((event) =>
      el("li", { class: `event of-${event.kind}${event.accepted === false ? " not" : ""}` }, el("time", { datetime: event.time }, clock(event.time)), el("b", {}, event.kind), el("span", {}, sentence(worded(event.text)))));
    this.show(this.list(entries, "No events yet."));
  }
}

const OUTCOMES = { reached: "✓ reached", failed: "✕ missed", cancelled: "– cancelled" };

export class GoalsPanel extends Panel {
  constructor(follower) {
    super("Goals");
    this.follower = follower;
    follower.watchers.add(() => this.place.hidden || this.open());
  }

  open() {
    const goals = this.follower.goals();
    const ended = goals.filter((goal) => ["reached", "failed"].includes(goal.end?.what));
    const reached = ended.filter((goal) => goal.end.what === "reached").length;
    const entries = goals.slice(0, SHOWN).map(({ request, target, end }) =>
      el("li", { class: `goal ${end?.what ?? "running"}` },
        el("time", { datetime: request.time }, clock(request.time)), el("b", {}, OUTCOMES[end?.what] ?? "… running"),
        el("span", {}, `${sentence(target)}, from ${request.who ?? "an unknown client"}${end ? `. ${sentence(worded(end.text))}` : ""}`)));
    const sum = ended.length ? el("p", { class: "hint" }, `${reached} of ${ended.length} reached`) : null;
    this.show(sum, this.list(entries, "No goals yet. Click in the drawing to send one."));
  }
}
