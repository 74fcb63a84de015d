// The login. The page sends the token once; scripts cannot read the cookie that replaces it.

import { get, post, onLoggedOut } from "./api.js";
import { $, el, render, setText, words } from "../view/dom.js";
import { ROLE_LIMITS } from "../view/controls.js";

export class Session {
  // onRole(role) receives command, view, stop or null.
  constructor(onRole) {
    this.onRole = onRole;
    this.role = undefined;
    this.needed = true; // assumed until the daemon answers
    $("login").addEventListener("submit", (event) => {
      event.preventDefault();
      this.login();
    });
    onLoggedOut(() => this.check());
  }

  async check() {
    if (this.checking) return;
    this.checking = true;
    try {
      this.take(await get("api/login"));
    } catch {
      setTimeout(() => this.check(), 1000); // the daemon does not answer yet
    } finally {
      this.checking = false;
    }
  }

  take({ needed, role }) {
    const changed = role !== this.role;
    Object.assign(this, { needed, role });
    $("login").hidden = !needed || role === "command" || role === "view";
    document.body.dataset.role = role ?? "none";
    if (role === "stop") setText($("login-why"), `${ROLE_LIMITS.stop} To view or control the robot, log in with another token.`);
    render($("who"), [needed, role], () => (needed && role ? [el("span", {}, role), el("button", { type: "button", class: "small", onclick: () => this.logout() }, "Log out")] : []));
    if (changed) this.onRole(role);
  }

  async login() {
    const field = $("token");
    try {
      this.take(await post("api/login", { token: field.value.trim() }));
      setText($("login-said"), "");
    } catch (error) {
      setText($("login-said"), words(error));
    }
    field.value = "";
  }

  async logout() {
    await post("api/logout").catch(() => null);
    location.reload();
  }
}
