// The base of all panels: loads the content and shows progress or the error.

import { get } from "../link/api.js";
import { el, update, words } from "../view/dom.js";

export const LISTING_S = 35; // the daemon's own limit is 30 s

export class Panel {
  // fill(answer) of a panel shows the answer of its path.
  constructor(name, path = null) {
    this.name = name;
    this.path = path;
    this.commands = false; // whether the user's role may change something
  }

  // Load the content each time the panel is opened.
  async open() {
    const request = (this.request = Symbol("request")); // the answer to an earlier one may arrive later
    if (!this.place.childElementCount) this.place.replaceChildren(el("p", { class: "hint" }, "Loading …"));
    try {
      const answer = await this.load();
      if (request === this.request) this.fill(answer);
    } catch (error) {
      if (request === this.request) this.place.replaceChildren(el("p", { class: "notice refused" }, `${this.name}: ${words(error)}`));
    }
  }

  load() {
    return get(this.path, { seconds: LISTING_S });
  }

  show(...children) {
    update(this.place, children.filter(Boolean));
  }

  // Return the entries as a list, or the text for an empty one.
  list(entries, empty) {
    return entries.length ? el("ul", { class: "entries" }, entries) : el("p", { class: "hint" }, empty);
  }
}
