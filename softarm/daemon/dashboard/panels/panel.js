// The base of all panels: loads the content and shows progress or the error.

import { el, sentence, worded } from "../view/dom.js";

export class Panel {
  constructor(name) {
    this.name = name;
    this.commands = false; // whether the user's role may change something
  }

  // Load the content each time the panel is opened.
  async open() {
    if (!this.place.childElementCount) this.place.replaceChildren(el("p", { class: "hint" }, "Loading …"));
    try {
      this.fill(await this.fetch());
    } catch (error) {
      this.place.replaceChildren(el("p", { class: "notice refused" }, `${this.name}: ${(error.reasons ?? [String(error)]).map((one) => sentence(worded(one))).join(". ")}`));
    }
  }

  // Return the entries as a list, or the text for an empty one.
  list(entries, empty) {
    return entries.length ? el("ul", { class: "entries" }, entries) : el("p", { class: "hint" }, empty);
  }
}
