// The tabs. Each panel loads when it is opened; events are followed while the page is open.

import { $, el } from "../view/dom.js";
import { EventsPanel, GoalsPanel } from "./events.js";
import { Incidents, Logs, Reports } from "./files.js";
import { Jobs } from "./jobs.js";
import { Policies } from "./policies.js";

export class Panels {
  // swings: shows the swing of a goal.
  constructor(follower, swings) {
    this.follower = follower;
    const jobs = new Jobs(follower);
    const replay = (log) => { this.choose(jobs); jobs.start({ kind: "replay", log }); };
    this.all = [new Policies(), new GoalsPanel(follower, swings), new EventsPanel(follower), jobs, new Logs(replay), new Incidents(), new Reports()];
    this.all.forEach((panel, k) => this.addTab(panel, k));
    this.choose(this.all[0]);
  }

  // Reload the policies, whichever client changed the policy.
  policyChanged() {
    if (this.mayView) this.all[0].open();
  }

  addTab(panel, k) {
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
    if (this.mayView) chosen.open();
  }

  get mayView() {
    return this.role === "view" || this.role === "command";
  }

  setRole(role) {
    this.role = role;
    for (const panel of this.all) panel.commands = role === "command";
    this.setLive(this.mayView);
  }

  setLive(live) {
    if (live && this.mayView) {
      this.follower.start();
      this.chosen.open();
    } else this.follower.stop();
  }
}
