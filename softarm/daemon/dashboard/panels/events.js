// The event history, followed while the page is open, and the goals that it reports.

import { get } from "../link/api.js";
import { clock, el, number, sentence, worded } from "../view/dom.js";
import { Panel } from "./panel.js";

const EVERY_MS = 1000;
const KEPT = 500;
const SHOWN = 200;
const TARGET = /^goal (.*?) requested from/;
const GOAL = /^goal (\w+)(?: y (\S+), z (\S+) m)?/;

// Return the goal that a request names: its kind, and the target of a reach.
function goalOf(text) {
  const [kind, y, z] = GOAL.exec(text)?.slice(1) ?? [];
  return kind === "reach" ? { kind, y_m: Number(y), z_m: Number(z) } : { kind };
}

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
    const known = goalOf(request?.text ?? "");
    if (!goal || known.kind !== goal.kind) return null;
    const same = known.kind !== "reach" || (Math.abs(goal.y_m - known.y_m) < 1e-4 && Math.abs(goal.z_m - known.z_m) < 1e-4);
    return same ? request.who : null;
  }

  // Return every accepted goal with its end and the tick of the next goal, newest first.
  goals() {
    const goals = [];
    for (const event of this.events) {
      if (event.kind === "request" && event.what === "goal" && event.accepted) {
        const before = goals.at(-1);
        if (before) before.next = event.tick;
        if (before && !before.end) before.end = { what: "cancelled", text: "replaced by another goal", tick: event.tick, time: event.time };
        goals.push({ key: `${this.run} ${event.number}`, goal: goalOf(event.text), request: event, target: TARGET.exec(event.text)?.[1] ?? event.text, end: null, next: null });
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
  // swings: shows the swing of a goal, and finds closest distances.
  constructor(follower, swings) {
    super("Goals");
    Object.assign(this, { follower, swings });
    follower.watchers.add(() => this.place.hidden || this.open());
  }

  async open() {
    const goals = this.follower.goals().slice(0, SHOWN);
    this.draw(goals);
    const found = await this.swings.measure(goals);
    if (found && !this.place.hidden) this.draw(goals);
  }

  draw(goals) {
    const ended = goals.filter((goal) => ["reached", "failed"].includes(goal.end?.what));
    const reached = ended.filter((goal) => goal.end.what === "reached").length;
    const share = number((100 * reached) / ended.length, 0, "%");
    const sum = ended.length ? el("p", { class: "hint" }, `${reached} of ${ended.length} reached (${share}). Choose a goal of the last ten minutes to see its swing.`) : null;
    this.show(sum, this.list(goals.map((goal) => this.entry(goal)), "No goals yet. Click in the drawing to send one."));
  }

  entry(goal) {
    const { request, target, end } = goal;
    const near = end?.text.includes("closest distance") ? null : this.swings.closest.get(goal.key);
    const words = [`${sentence(target)}, from ${request.who ?? "an unknown client"}`, end && sentence(worded(end.text)), near && `Closest ${number(near * 100, 1)} cm`];
    const shows = end && goal.goal.kind !== "hold" && this.swings.isStored(goal);
    return el("li", { class: `goal ${end?.what ?? "running"}`, onclick: shows ? () => this.swings.choose(goal) : null },
      el("time", { datetime: request.time }, clock(request.time)), el("b", {}, OUTCOMES[end?.what] ?? "… running"), el("span", {}, words.filter(Boolean).join(". ")),
      shows ? el("button", { type: "button", class: "small", "aria-label": `Show the swing of ${clock(request.time)}` }, "Show") : null);
  }
}
