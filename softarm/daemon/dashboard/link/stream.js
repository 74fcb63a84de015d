// The status stream over one WebSocket, with the age of the data. Stale data is never reported as live.

import { get, post } from "./api.js";

const SILENT_MS = 1000; // without a status the link counts as lost
const GIVE_UP_MS = 3000; // without a status a new connection starts
const BACKLOG_MS = 1000; // a stream that lags by more delivers stale data
const POLL_MS = 400; // between single requests while the stream is silent
const BACK_OFF_MS = [250, 500, 1000, 2000, 4000];
const DRIFT_MAX = 2e-4; // between the two clocks

export class Stream {
  // onLink({state, age_ms, reasons}): state is connecting, live, lost, stalled, refused or closed.
  constructor(onStatus, onLink) {
    this.onStatus = onStatus;
    this.onLink = onLink;
    this.tries = 0;
    this.hz = 30;
    this.last = null; // arrival of the newest live status
    this.received = this.polled = -Infinity;
    this.streamed = null; // arrival of the newest status by the stream
    this.stalledAt = null; // arrival of the newest status that reports a stalled loop
    this.running = false;
    setInterval(() => this.check(), 100);
    addEventListener("online", () => this.reconnect(0));
    document.addEventListener("visibilitychange", () => document.hidden || this.state === "live" || this.reconnect(0));
  }

  start() {
    if (this.running) return;
    this.running = true;
    this.connect();
  }

  stop() {
    this.running = false;
    this.drop();
    this.report("closed");
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
      socket.onclose = () => socket === this.socket && this.reconnect();
    } catch (error) {
      if (mine !== this.attempt || !this.running) return;
      this.refused = error.status === 403 ? error.reasons : null;
      if (error.status !== 401) this.reconnect(); // 401: the user has to log in first
    }
  }

  drop() {
    this.attempt = null;
    const socket = this.socket;
    this.socket = null;
    socket?.close();
  }

  reconnect(wait = BACK_OFF_MS[Math.min(this.tries++, BACK_OFF_MS.length - 1)] * (0.8 + 0.4 * Math.random())) {
    if (!this.running) return;
    this.drop();
    this.began = performance.now();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), wait);
  }

  // polled: the status answers a single request, so the stream may still be silent.
  take(status, polled = false) {
    const now = performance.now();
    const lag = now - status.t_ns * 1e-6; // the clocks' offset is unknown: the smallest difference seen counts as no lag
    this.least = this.least === null ? lag : Math.min(lag, this.least + DRIFT_MAX * (now - this.received));
    this.received = now;
    if (!polled) this.streamed = now;
    this.refused = null;
    if (!polled) this.tries = 0;
    if (status.stalled) this.stalledAt = now;
    else if (this.hasBacklog(lag - this.least, now)) return;
    else {
      this.last = now;
      this.stalledAt = null;
    }
    this.onStatus(status);
    this.check();
  }

  // Return whether the stream has a backlog; reconnect at a lower rate if that lasts.
  hasBacklog(lag, now) {
    if (lag < BACKLOG_MS) {
      this.behindSince = null;
      return false;
    }
    this.behindSince ??= now;
    if (now - this.behindSince > BACKLOG_MS / 2) {
      this.hz = Math.max(5, this.hz / 2);
      this.reconnect();
    }
    this.check();
    return true;
  }

  check() {
    if (!this.running) return;
    const now = performance.now();
    const age = this.last === null ? null : now - this.last;
    if (this.refused) this.report("refused", age);
    else if (this.stalledAt !== null && now - this.stalledAt < GIVE_UP_MS) this.report("stalled", age);
    else if (age === null) this.report("connecting", age);
    else this.report(age < SILENT_MS ? "live" : "lost", age);
    const silent = now - Math.max(this.streamed ?? 0, this.began) > GIVE_UP_MS;
    if (this.socket && silent && !(this.stalledAt > now - GIVE_UP_MS)) this.reconnect();
    if (this.streamed === null || now - this.streamed > SILENT_MS) this.poll(now);
  }

  // Request single statuses while the stream is silent or a proxy blocks it.
  async poll(now) {
    if (this.polling || now - this.polled < POLL_MS) return;
    this.polling = true;
    this.polled = now;
    const status = await get("api/status", { seconds: 0.9 }).catch(() => null);
    this.polling = false;
    if (status && this.running) this.take(status, true);
  }

  report(state, age_ms = this.last === null ? null : performance.now() - this.last) {
    this.state = state;
    this.onLink({ state, age_ms, reasons: this.refused });
  }
}
