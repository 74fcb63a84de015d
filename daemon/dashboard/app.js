// The page put together: what the daemon says goes to whoever shows it.

import { get } from "./link/api.js";
import { History } from "./link/history.js";
import { Session } from "./link/session.js";
import { Stop, bindStop } from "./link/stop.js";
import { Stream } from "./link/stream.js";
import { Aim } from "./view/aim.js";
import { Arm } from "./view/arm.js";
import { Charts } from "./view/charts.js";
import { Controls } from "./view/controls.js";
import { $, say, seconds, sentence } from "./view/dom.js";
import { drawGoal, ModeView } from "./view/mode.js";
import { Panels } from "./panels/panels.js";

const LINKS = {
  connecting: "Connecting", live: "Live", lost: "Connection lost", refused: "Refused", stalled: "Control loop stands still", closed: "Not connected",
};
const NEXT = {
  lost: "Trying again. Stop works as long as the daemon can be reached; else use the button on the wall.",
  stalled: "The daemon answers, its control loop does not tick: look at the service's log, then restart it.",
};

class Page {
  constructor() {
    this.status = null;
    this.link = { state: "connecting", age_ms: null };
    // Before anything else, and without any of it: where the stop's own way is unless the status says otherwise.
    this.stopPort = Number(location.port || 80) + 1;
    this.stop = new Stop({
      port: () => this.stopPort,
      loggedIn: () => this.session.needed,
      stopped: () => (this.status?.estop ?? "clear") !== "clear",
      told: (said) => this.stopped(said),
    });
    bindStop($("stop"), () => this.stop.press());
    this.history = new History();
    this.charts = new Charts($("plots"), $("charts-note"), this.history);
    this.mode = new ModeView();
    this.controls = new Controls();
    this.panels = new Panels();
    this.stream = new Stream((status) => this.take(status), (link) => this.linked(link));
    this.session = new Session((role) => this.entered(role));
    $("pause").addEventListener("click", () => this.pause());
    this.session.look();
    this.findStop();
  }

  // The page may speak to the stop's own way alone, and so its own header tells the port, logged in or not.
  async findStop() {
    const page = await get("/", { raw: true }).catch(() => null);
    const port = /connect-src[^;]*:(\d+)/.exec(page?.headers.get("content-security-policy") ?? "")?.[1];
    if (port && !this.status) this.stopPort = Number(port);
  }

  // Somebody may look now, or no longer.
  async entered(role) {
    this.controls.draw(this.status, this.link.state === "live", role);
    this.panels.may(role);
    if (role !== "view" && role !== "command") return this.stream.stop();
    await this.learn();
    this.stream.start();
  }

  // The robot's facts; asked for again until they come.
  async learn() {
    const before = this.robot;
    try {
      this.robot = await get("api/robot");
    } catch {
      setTimeout(() => this.learn(), 2000);
      return;
    }
    if (before && before.run !== this.robot.run) this.history.clear(); // another daemon counts its ticks anew
    this.stopPort = this.robot.stop_port ?? this.stopPort;
    const kind = $("kind");
    kind.hidden = !this.robot.simulated;
    say(kind, "simulated");
    say($("version"), `softarm ${this.robot.version ?? ""}`);
    if (this.arm) return void this.arm.know(this.robot);
    this.arm = new Arm($("drawing"), this.robot);
    this.aim = new Aim($("drawing"), this.arm, (target) => this.controls.reach(target));
  }

  take(status) {
    const before = this.status;
    this.status = status;
    this.stopPort = status.stop_port ?? this.stopPort;
    if (!status.stalled) {
      this.history.add(status);
      this.arm?.take(status);
    }
    if (before === null) this.history.load();
    else if (this.link.state === "lost") this.learn().then(() => this.history.load());
    if (before && before.policy !== status.policy) this.panels.policyChanged();
    if (status.estop !== "clear" && !status.stalled) this.stop.seen();
    if (before?.mode === "stopped" && status.mode !== "stopped" && !this.stop.open) this.stopped(null);
    if (!this.waits) this.waits = requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.waits = null;
    const status = this.status;
    this.mode.draw(status);
    this.controls.draw(status, this.link.state === "live", this.session.role);
    drawGoal(status, this.panels.asker(status.goal.goal));
    const trained = status.policy_info?.trained ?? null;
    $("k-trained").hidden = !trained;
    $("k-shelf").hidden = !Number.isFinite(status.policy_info?.shelf_depth_m);
    this.arm?.train(trained);
    this.arm?.draw(status);
    this.charts.draw();
  }

  linked(link) {
    const before = this.link.state;
    this.link = link;
    const { state, age_ms } = link;
    $("link").dataset.link = state;
    say($("link").querySelector("span"), LINKS[state]);
    const old = state === "lost" || state === "stalled" || state === "refused";
    document.body.classList.toggle("old", old || (this.status === null && state !== "live"));
    $("lost").hidden = !old;
    if (old) {
      say($("lost-what"), `${LINKS[state]}.`);
      say($("lost-age"), age_ms === null ? "" : `What you see is ${seconds(age_ms / 1000)} old.`);
      say($("lost-next"), NEXT[state] ?? link.reasons.map(sentence).join(". "));
    }
    if (before === state) return;
    if (old) document.title = `${LINKS[state]} · softarm`;
    if (old || (state === "live" && before !== "connecting")) say($("spoken"), LINKS[state]);
    this.panels.live(state === "live");
    this.controls.draw(this.status, state === "live", this.session.role);
  }

  stopped(said) {
    const banner = $("stopped");
    banner.hidden = said === null;
    banner.dataset.state = said?.state ?? "";
    say(banner, said?.text ?? "");
    $("stop").dataset.state = said?.state ?? "";
    say($("stop-text"), { asking: "Stopping", stopped: "Stopped", unconfirmed: "Not confirmed" }[said?.state] ?? "Stop");
  }

  pause() {
    const paused = !this.charts.paused;
    $("pause").setAttribute("aria-pressed", String(paused));
    say($("pause"), paused ? "Go on" : "Pause");
    this.charts.pause(paused);
  }
}

new Page();
