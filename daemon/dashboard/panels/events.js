// What happened, followed while the page is open; goals with their outcomes are told from it.

import { get } from "../link/api.js";
import { clock, el, sentence, worded } from "../view/dom.js";
import { Panel } from "./panel.js";

const EVERY_MS = 1000;
const KEPT = 500;
const SHOWN = 200;
const TARGET = /^goal (.*?), asked for by/;

// Keeps the events; tells its watchers when there are new ones.
export class Follower {
  constructor() {
    this.events = [];
    this.watchers = new Set();
    this.run = null;
  }

  start() {
    if (this.timer) return;
    this.timer = setInterval(() => document.hidden || this.look(), EVERY_MS);
    this.look();
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
  }

  async look() {
    if (this.looking) return;
    this.looking = true;
    try {
      const newest = this.events.at(-1)?.number;
      const told = await get(newest === undefined ? `api/events?limit=${KEPT}` : `api/events?since=${newest}&limit=${KEPT}`, { seconds: 3 });
      const anew = this.run !== null && told.run !== this.run;
      this.run = told.run;
      if (anew) this.events = [];
      else if (told.events.length || newest === undefined) {
        this.events = [...this.events, ...told.events].slice(-KEPT);
        this.watchers.forEach((watcher) => watcher());
      }
    } catch {
      // the page says already that the connection is lost
    } finally {
      this.looking = false;
    }
  }

  // Who asked for a goal; null where the events, which come a little later, do not tell of this one.
  asker(goal) {
    const asked = this.events.findLast((event) => event.kind === "request" && event.what === "goal" && event.accepted);
    const [kind, ...place] = /^goal (\w+)(?: y (\S+), z (\S+) m)?/.exec(asked?.text ?? "")?.slice(1) ?? [];
    if (!goal || kind !== goal.kind) return null;
    const same = kind !== "reach" || [goal.y_m, goal.z_m].every((value, k) => Math.abs(value - Number(place[k])) < 1e-4);
    return same ? asked.who : null;
  }

  // Each goal that was taken, with what came of it; newest first.
  goals() {
    const goals = [];
    for (const event of this.events) {
      if (event.kind === "request" && event.what === "goal" && event.accepted) {
        if (goals.length && !goals.at(-1).end) goals.at(-1).end = { what: "cancelled", text: "another goal took its place" };
        goals.push({ asked: event, target: TARGET.exec(event.text)?.[1] ?? event.text, end: null });
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
    this.place.replaceChildren(this.list(entries, "Nothing has happened yet."));
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
    const entries = goals.slice(0, SHOWN).map(({ asked, target, end }) =>
      el("li", { class: `goal ${end?.what ?? "running"}` },
        el("time", { datetime: asked.time }, clock(asked.time)), el("b", {}, OUTCOMES[end?.what] ?? "… running"),
        el("span", {}, `${sentence(target)}; ${asked.who ?? "somebody"}${end ? `. ${sentence(worded(end.text))}` : ""}`)));
    const sum = ended.length ? el("p", { class: "hint" }, `${reached} of ${ended.length} reached`) : null;
    this.place.replaceChildren(...[sum, this.list(entries, "No goals yet: click into the drawing.")].filter(Boolean));
  }
}
