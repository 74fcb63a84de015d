// The policies: description, the one in use, and why one cannot be used.

import { ask } from "../link/api.js";
import { attempt, ROLE_LIMITS } from "../view/controls.js";
import { $, el, sentence, worded } from "../view/dom.js";
import { Panel } from "./panel.js";

const LOADING_S = 125; // the daemon's own limit is 120 s

export class Policies extends Panel {
  constructor() {
    super("Policies", "api/policies");
  }

  fill({ active, policies }) {
    const used = policies.find((policy) => policy.name === active);
    $("do-run").hidden = used?.needs_target !== false;
    const [usable, broken] = [false, true].map((bad) => policies.filter(({ error }) => Boolean(error) === bad).map((policy) => this.entry(policy, policy.name === active)));
    this.show(this.list(usable, "No policies."), broken.length ? el("h3", {}, "Cannot be used") : null, broken.length ? this.list(broken) : null);
  }

  entry(policy, active) {
    const why = policy.error ? "This policy cannot be used." : this.commands ? "" : ROLE_LIMITS.view;
    const use = el("button", { type: "button", class: "small", title: why, "aria-disabled": String(Boolean(why)), "aria-label": `Use ${policy.name}`, onclick: () => why || this.use(policy.name, use) }, "Use");
    return el("li", { class: policy.error ? "policy broken" : "policy" },
      el("div", {}, el("b", {}, policy.name), active ? el("span", { class: "tag" }, "in use") : null, el("span", { class: "more" }, sentence(worded(policy.error ? `cannot be used: ${policy.error}` : policy.description)))),
      active || policy.error ? null : use);
  }

  async use(name, button) {
    button.textContent = "Loading …";
    button.setAttribute("aria-busy", "true");
    await attempt(`Policy ${name}`, () => ask("PUT", "api/policy", { name }, { seconds: LOADING_S }), `Policy ${name} in use`);
    await this.open();
  }
}
