// The panel "Last swing": the newest goal that has ended, or one that is chosen in the list of goals.

import { Refused, get } from "../link/api.js";
import { STORED_S } from "../link/history.js";
import { $, clock, sentence, setText, words } from "../view/dom.js";
import { AFTER_S, cutSwing, secondsOf } from "./cut.js";
import { Replay } from "./replay.js";
import { save } from "./save.js";

const LOADING_S = 15;
const RETRY_MS = 300;
const REFUSED_MS = 2000; // until a refused request is repeated
const STORED = "The daemon keeps the last ten minutes; older swings are in the logs.";

export class LastSwing {
  // robot() returns the robot's constants, or undefined before they are loaded.
  constructor(follower, history, robot) {
    Object.assign(this, { follower, history, robot });
    this.shown = null; // the newest goal that was looked at
    this.closest = new Map(); // key of a goal -> the tip's closest distance, m; null if unknown
    follower.watchers.add(() => this.check());
    this.button = document.querySelector("#swing .save");
    this.button.addEventListener("click", () => this.save());
  }

  // Show the newest ended goal as soon as the ticks after it are there.
  check() {
    clearTimeout(this.timer);
    const goal = this.follower.goals().find(({ goal: { kind }, end }) => end && kind !== "hold");
    if (!goal || goal.key === this.shown) return;
    if (!this.isOver(goal) || !this.robot()) return void (this.timer = setTimeout(() => this.check(), RETRY_MS));
    this.shown = goal.key;
    this.load(goal, "Last swing");
  }

  // Show a goal of the list.
  choose(goal) {
    $("swing").scrollIntoView({ block: "nearest" });
    return this.load(goal, `Swing of ${clock(goal.request.time)}`);
  }

  async load(goal, title) {
    this.wanted = goal;
    const swing = await this.fetched(goal).catch((error) => error);
    if (this.wanted !== goal) return; // another goal was chosen meanwhile
    if (swing instanceof Refused) setTimeout(() => this.wanted === goal && this.load(goal, title), REFUSED_MS);
    if (swing instanceof Error) return void setText($("swing-note"), words(swing));
    if (typeof swing === "string") return void setText($("swing-note"), swing);
    this.swing = swing;
    if (!this.closest.has(goal.key)) {
      this.closest.set(goal.key, swing.closest?.m ?? null);
      this.follower.watchers.forEach((watcher) => watcher()); // the list of goals shows the distance
    }
    this.replay ??= new Replay($("replay"));
    setText($("swing-title"), title);
    setText($("swing-note"), [goal.target, `requested at ${clock(goal.request.time)}`].map((part, k) => (k ? part : sentence(part))).join(", "));
    $("swing").dataset.goal = goal.key;
    this.button.hidden = false;
    this.replay.show(swing);
  }

  // Return whether the ticks after the end of a goal are there.
  isOver({ end, next }) {
    return end !== null && this.history.newest > (next === null ? Date.parse(end.time) / 1000 + AFTER_S : 0);
  }

  isStored(goal) {
    return secondsOf(goal, this.history.newest) <= STORED_S;
  }

  // Fetch the ticks of a goal and all later ones. The charts' columns may lack some: a slow client gets fewer.
  fetch(goal) {
    return get(`api/recent?seconds=${secondsOf(goal, this.history.newest)}`, { seconds: LOADING_S });
  }

  async fetched(goal) {
    if (!this.isStored(goal)) return `This swing is no longer stored. ${STORED}`;
    return cutSwing(goal, await this.fetch(goal), this.robot()) ?? `This swing is not stored. ${STORED}`;
  }

  // Find the closest distances of stored goals, newest first; return whether there are new ones.
  async measure(goals) {
    const open = goals.filter((goal) => goal.goal.kind === "reach" && !this.closest.has(goal.key) && this.isOver(goal) && this.isStored(goal));
    if (!open.length || !this.robot()) return false;
    for (const { key } of open) this.closest.set(key, null);
    const recent = await this.fetch(open.at(-1)).catch(() => null);
    for (const goal of open) {
      if (recent) this.closest.set(goal.key, cutSwing(goal, recent, this.robot())?.closest?.m ?? null);
      else this.closest.delete(goal.key);
    }
    return recent !== null;
  }

  async save() {
    await save(this.swing).catch((error) => setText($("swing-note"), `Not saved: ${error.message}. Reload the page.`));
  }
}
