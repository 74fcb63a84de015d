// What all panels share: asking, saying that they ask, and saying why they could not.

import { el, sentence, worded } from "../view/dom.js";

export class Panel {
  constructor(name) {
    this.name = name;
    this.commands = false; // may this login change something?
  }

  // Asked for anew whenever it is looked at.
  async open() {
    if (!this.place.childElementCount) this.place.replaceChildren(el("p", { class: "hint" }, "Asking …"));
    try {
      this.fill(await this.fetch());
    } catch (error) {
      this.place.replaceChildren(el("p", { class: "notice refused" }, `${this.name}: ${(error.reasons ?? [String(error)]).map((one) => sentence(worded(one))).join(". ")}`));
    }
  }

  // What is here, or in words that nothing is.
  list(entries, none) {
    return entries.length ? el("ul", { class: "entries" }, entries) : el("p", { class: "hint" }, none);
  }
}
