// Every new status over one WebSocket, and how fresh it is. Nothing that is old passes for live.

import { get, post } from "./api.js";

const SILENT_MS = 1000; // without a status: lost
const GIVE_UP_MS = 3000; // then another connection is tried
const BEHIND_MS = 1000; // later than they could come: what is shown is old, though it keeps coming
const ASKED_MS = 400; // between statuses that are asked for one by one while the stream is silent
const WAITS_MS = [250, 500, 1000, 2000, 4000];
const CREEP = 2e-4; // two clocks run apart by less

export class Stream {
  // onStatus(status), onLink(link) with link {state, age_ms, reasons}: state is connecting, live, lost, stalled, refused, closed
  constructor(onStatus, onLink) {
    this.onStatus = onStatus;
    this.onLink = onLink;
    this.tries = 0;
    this.hz = 30;
    this.last = null; // when the newest status came that was live
    this.heard = this.polled = -Infinity;
    this.streamed = null; // when the stream brought the newest
    this.stalledAt = null; // when it was last heard that the control loop stands still
    this.running = false;
    setInterval(() => this.look(), 100);
    addEventListener("online", () => this.again(0));
    document.addEventListener("visibilitychange", () => document.hidden || this.state === "live" || this.again(0));
  }

  start() {
    if (this.running) return;
    this.running = true;
    this.connect();
  }

  stop() {
    this.running = false;
    this.drop();
    this.tell("closed");
  }

  async connect() {
    clearTimeout(this.timer);
    this.drop();
    const mine = (this.attempt = {});
    this.began = performance.now();
    try {
      const { ticket } = await post("api/ticket", undefined, { seconds: 3 });
      if (mine !== this.attempt || !this.running) return;
      const url = new URL(`api/stream?hz=${this.hz}&ticket=${encodeURIComponent(ticket)}`, document.baseURI);
      url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
      const socket = (this.socket = new WebSocket(url));
      this.least = null;
      socket.onmessage = (event) => socket === this.socket && this.take(JSON.parse(event.data));
      socket.onclose = () => socket === this.socket && this.again();
    } catch (error) {
      if (mine !== this.attempt || !this.running) return;
      this.refused = error.status === 403 ? error.reasons : null;
      if (error.status !== 401) this.again(); // 401: somebody has to log in first
    }
  }

  drop() {
    this.attempt = null;
    const socket = this.socket;
    this.socket = null;
    socket?.close();
  }

  again(wait = WAITS_MS[Math.min(this.tries++, WAITS_MS.length - 1)] * (0.8 + 0.4 * Math.random())) {
    if (!this.running) return;
    this.drop();
    this.began = performance.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), wait);
  }

  // asked: it came by itself, as an answer, and says nothing of the stream.
  take(status, asked = false) {
    const now = performance.now();
    const lag = now - status.t_ns * 1e-6; // two clocks of unknown distance: the least that was seen is no lag
    this.least = this.least === null ? lag : Math.min(lag, this.least + CREEP * (now - this.heard));
    this.heard = now;
    if (!asked) this.streamed = now;
    this.refused = null;
    if (!asked) this.tries = 0;
    if (status.stalled) this.stalledAt = now;
    else if (this.isBehind(lag - this.least, now)) return;
    else {
      this.last = now;
      this.stalledAt = null;
    }
    this.onStatus(status);
    this.look();
  }

  // Do old statuses come, one after another? Then another connection begins with the newest, and has fewer of them.
  isBehind(behind, now) {
    if (behind < BEHIND_MS) {
      this.behindSince = null;
      return false;
    }
    this.behindSince ??= now;
    if (now - this.behindSince > BEHIND_MS / 2) {
      this.hz = Math.max(5, this.hz / 2);
      this.again();
    }
    this.look();
    return true;
  }

  look() {
    if (!this.running) return;
    const now = performance.now();
    const age = this.last === null ? null : now - this.last;
    if (this.refused) this.tell("refused", age);
    else if (this.stalledAt !== null && now - this.stalledAt < GIVE_UP_MS) this.tell("stalled", age);
    else if (age === null) this.tell("connecting", age);
    else this.tell(age < SILENT_MS ? "live" : "lost", age);
    const silent = now - Math.max(this.streamed ?? 0, this.began) > GIVE_UP_MS;
    if (this.socket && silent && !(this.stalledAt > now - GIVE_UP_MS)) this.again();
    if (this.streamed === null || now - this.streamed > SILENT_MS) this.poll(now);
  }

  // While the stream is silent, or a proxy lets none through: statuses one by one. They also tell of a loop that stands still.
  async poll(now) {
    if (this.asking || now - this.polled < ASKED_MS) return;
    this.asking = true;
    this.polled = now;
    const told = await get("api/status", { seconds: 0.9 }).catch(() => null);
    this.asking = false;
    if (told && this.running) this.take(told, true);
  }

  tell(state, age_ms = this.last === null ? null : performance.now() - this.last) {
    this.state = state;
    this.onLink({ state, age_ms, reasons: this.refused });
  }
}
