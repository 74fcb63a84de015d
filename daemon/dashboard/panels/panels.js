// The tabs below: each asks for what it shows when it is looked at, the events while the page is open.

import { $, el } from "../view/dom.js";
import { EventsPanel, GoalsPanel, Follower } from "./events.js";
import { Incidents, Logs, Reports } from "./files.js";
import { Policies } from "./policies.js";

export class Panels {
  constructor() {
    this.follower = new Follower();
    this.all = [new Policies(), new GoalsPanel(this.follower), new EventsPanel(this.follower), new Logs(), new Incidents(), new Reports()];
    this.all.forEach((panel, k) => this.lay(panel, k));
    this.choose(this.all[0]);
  }

  // Whose goal it is.
  asker(goal) {
    return this.follower.asker(goal);
  }

  // By whomever.
  policyChanged() {
    if (this.looks) this.all[0].open();
  }

  lay(panel, k) {
    const id = `panel-${panel.name.toLowerCase()}`;
    panel.tab = el("button", { type: "button", role: "tab", id: `${id}-tab`, "aria-controls": id, onclick: () => this.choose(panel) }, panel.name);
    panel.tab.addEventListener("keydown", (event) => this.key(event, k));
    panel.place = el("div", { role: "tabpanel", id, "aria-labelledby": `${id}-tab`, tabindex: 0, hidden: true });
    $("tabs").append(panel.tab);
    $("panels").append(panel.place);
  }

  key(event, k) {
    const count = this.all.length;
    const to = { ArrowRight: k + 1, ArrowLeft: k - 1 + count, Home: 0, End: count - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this.choose(this.all[to % count]);
    this.all[to % count].tab.focus();
  }

  choose(chosen) {
    this.chosen = chosen;
    for (const panel of this.all) {
      panel.tab.setAttribute("aria-selected", String(panel === chosen));
      panel.tab.tabIndex = panel === chosen ? 0 : -1;
      panel.place.hidden = panel !== chosen;
    }
    if (this.looks) chosen.open();
  }

  get looks() {
    return this.role === "view" || this.role === "command";
  }

  may(role) {
    this.role = role;
    for (const panel of this.all) panel.commands = role === "command";
    this.live(this.looks);
  }

  live(live) {
    if (live && this.looks) {
      this.follower.start();
      this.chosen.open();
    } else this.follower.stop();
  }
}
