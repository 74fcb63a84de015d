// The page: connects the daemon's status to the views, the stop button and the panels.

import { get } from "./link/api.js";
import { History } from "./link/history.js";
import { Session } from "./link/session.js";
import { Stop, bindStop } from "./link/stop.js";
import { Stream } from "./link/stream.js";
import { Aim } from "./view/aim.js";
import { Arm } from "./view/arm.js";
import { LiveCharts } from "./view/charts.js";
import { Controls } from "./view/controls.js";
import { $, setText, seconds, sentence } from "./view/dom.js";
import { drawGoal, ModeView } from "./view/mode.js";
import { Follower } from "./panels/events.js";
import { Panels } from "./panels/panels.js";
import { LastSwing } from "./swing/last.js";

const LINKS = {
  connecting: "Connecting", live: "Live", lost: "Connection lost", refused: "Refused", stalled: "Control loop stalled", closed: "Not connected",
};
const NEXT = {
  lost: "Reconnecting. Stop works while the daemon can be reached; otherwise use the emergency-stop button.",
  stalled: "The daemon answers, but its control loop does not tick. Read the service's log, then restart the service.",
};

class Page {
  constructor() {
    this.status = null;
    this.link = { state: "connecting", age_ms: null };
    // The page carries the port, so Stop works before the first answer of the API.
    this.stopPort = Number(document.querySelector('meta[name="stop-port"]').content) || null;
    this.stop = new Stop({
      port: () => this.stopPort,
      loggedIn: () => this.session.needed,
      stopped: () => (this.status?.estop ?? "clear") !== "clear",
      onResult: (result) => this.showStop(result),
    });
    bindStop($("stop"), () => this.stop.press());
    this.history = new History();
    this.follower = new Follower();
    const about = { title: $("charts-title"), windows: $("windows"), note: $("charts-note") };
    this.charts = new LiveCharts($("plots"), about, this.history, () => this.follower.goals());
    this.mode = new ModeView();
    this.controls = new Controls();
    this.swing = new LastSwing(this.follower, this.history, () => this.robot);
    this.panels = new Panels(this.follower, this.swing);
    this.stream = new Stream((status) => this.take(status), (link) => this.setLink(link));
    this.session = new Session((role) => this.setRole(role));
    $("pause").addEventListener("click", () => this.pause());
    this.session.check();
  }

  // Start or stop the stream when the user's role changes.
  async setRole(role) {
    this.controls.draw(this.status, this.link.state === "live", role);
    this.panels.setRole(role);
    if (role !== "view" && role !== "command") return this.stream.stop();
    await this.loadRobot();
    this.stream.start();
  }

  // Load the robot's constants; retry until the daemon answers.
  async loadRobot() {
    const before = this.robot;
    try {
      this.robot = await get("api/robot");
    } catch {
      setTimeout(() => this.loadRobot(), 2000);
      return;
    }
    if (before && before.run !== this.robot.run) this.history.clear(); // a restarted daemon counts its ticks from 1 again
    this.stopPort = this.robot.stop_port ?? this.stopPort;
    const kind = $("kind");
    kind.hidden = !this.robot.simulated;
    setText(kind, "simulated");
    setText($("version"), `softarm ${this.robot.version ?? ""}`);
    if (this.arm) return void this.arm.setRobot(this.robot);
    this.arm = new Arm($("drawing"), this.robot);
    $("drawing-row").append(this.arm.solidButton());
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
    else if (this.link.state === "lost") this.loadRobot().then(() => this.history.load());
    if (before && before.policy !== status.policy) this.panels.policyChanged();
    if (status.estop !== "clear" && !status.stalled) this.stop.statusShowsStop();
    if (before?.mode === "stopped" && status.mode !== "stopped" && !this.stop.open) this.showStop(null);
    if (!this.frame) this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.frame = null;
    const status = this.status;
    this.mode.draw(status);
    this.setTitle();
    this.controls.draw(status, this.link.state === "live", this.session.role);
    drawGoal(status, this.follower.requester(status.goal.goal));
    const trained = status.policy_info?.trained ?? null;
    $("k-trained").hidden = !trained;
    $("k-shelf").hidden = !Number.isFinite(status.policy_info?.shelf_depth_m);
    this.arm?.setTrained(trained);
    this.arm?.draw(status);
    this.charts.draw();
  }

  setLink(link) {
    const before = this.link.state;
    this.link = link;
    const { state, age_ms } = link;
    $("link").dataset.link = state;
    setText($("link").querySelector("span"), LINKS[state]);
    const old = state === "lost" || state === "stalled" || state === "refused";
    document.body.classList.toggle("old", state !== "live");
    $("lost").hidden = !old;
    if (old) {
      setText($("lost-what"), `${LINKS[state]}.`);
      setText($("lost-age"), age_ms === null ? "" : `The data shown is ${seconds(age_ms / 1000)} old.`);
      setText($("lost-next"), NEXT[state] ?? link.reasons.map(sentence).join(". "));
    }
    if (before === state) return;
    this.setTitle();
    if (old || (state === "live" && before !== "connecting")) setText($("spoken"), LINKS[state]);
    this.panels.setLive(state === "live");
    this.controls.draw(this.status, state === "live", this.session.role);
  }

  setTitle() {
    const { state } = this.link;
    setText(document.querySelector("title"), `${(state === "live" && this.mode.spoken) || LINKS[state]} · softarm`);
  }

  showStop(result) {
    const banner = $("stopped");
    banner.hidden = result === null;
    banner.dataset.state = result?.state ?? "";
    setText(banner, result?.text ?? "");
    $("stop").dataset.state = result?.state ?? "";
    setText($("stop-text"), { asking: "Stopping", stopped: "Stopped", unconfirmed: "Not confirmed" }[result?.state] ?? "Stop");
  }

  pause() {
    const paused = !this.charts.paused;
    $("pause").setAttribute("aria-pressed", String(paused));
    setText($("pause"), paused ? "Resume" : "Pause");
    this.charts.pause(paused);
  }
}

new Page();
