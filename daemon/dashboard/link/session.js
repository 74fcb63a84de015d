// Who is logged in. The token is shown once; the cookie that stands for it is out of any script's sight.

import { get, post, onLoggedOut } from "./api.js";
import { $, el, show, say, sentence } from "../view/dom.js";
import { ROLE_SAYS } from "../view/controls.js";

export class Session {
  // onRole(role): command, view, stop, or null
  constructor(onRole) {
    this.onRole = onRole;
    this.role = undefined;
    this.needed = true; // until it is known
    $("login").addEventListener("submit", (event) => {
      event.preventDefault();
      this.login();
    });
    onLoggedOut(() => this.look());
  }

  async look() {
    if (this.looking) return;
    this.looking = true;
    try {
      this.take(await get("api/login"));
    } catch {
      setTimeout(() => this.look(), 1000); // there is no daemon yet
    } finally {
      this.looking = false;
    }
  }

  take({ needed, role }) {
    const changed = role !== this.role;
    Object.assign(this, { needed, role });
    $("login").hidden = !needed || role === "command" || role === "view";
    document.body.dataset.role = role ?? "none";
    if (role === "stop") say($("login-why"), `${ROLE_SAYS.stop} To look or to command, log in with another token.`);
    show($("who"), [needed, role], () => (needed && role ? [el("span", {}, role), el("button", { type: "button", class: "small", onclick: () => this.logout() }, "Log out")] : []));
    if (changed) this.onRole(role);
  }

  async login() {
    const field = $("token");
    try {
      this.take(await post("api/login", { token: field.value.trim() }));
      say($("login-said"), "");
    } catch (error) {
      say($("login-said"), (error.reasons ?? [String(error)]).map(sentence).join(". "));
    }
    field.value = "";
  }

  async logout() {
    await post("api/logout").catch(() => null);
    location.reload();
  }
}
