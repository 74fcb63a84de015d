// The last minutes as columns: loaded from `GET /api/recent`, extended by the stream.

import { get } from "./api.js";

const FIRST_S = 60; // loaded with the page
export const STORED_S = 600; // by the daemon, and at most here
const LOADING_S = 15;
const GAP_S = 0.25; // a longer pause between ticks breaks the lines
const ROWS_MAX = 20_000; // older rows are removed beyond this number

const cell = {
  tick: (s) => s.tick,
  time: (s) => s.time ?? Date.now() / 1000,
  tip_y_m: (s) => s.observed?.values[2],
  tip_z_m: (s) => s.observed?.values[3],
  cart_m: (s) => s.rail_position_m,
  cart_velocity_m_s: (s) => s.rail_velocity_m_s,
  action_velocity_m_s: (s) => s.action?.[0],
  sent_velocity_m_s: (s) => s.sent?.cart_velocity_m_s,
  pressure_kpa: (s) => s.observed?.values[7],
  action_pressure_kpa: (s) => s.action?.[1],
  sent_pressure_kpa: (s) => s.sent?.pressure_kpa,
  late_ms: (s) => s.late_ns * 1e-6,
  policy_ms: (s) => s.policy_ns * 1e-6,
  mocap_age_ms: (s) => s.ages_ms?.mocap,
  pressure_age_ms: (s) => s.ages_ms?.pressure,
  rail_age_ms: (s) => s.ages_ms?.rail,
};
const NAMES = Object.keys(cell);

export class History {
  constructor() {
    this.columns = Object.fromEntries(NAMES.map((name) => [name, []]));
    this.since = null; // Unix time from which the columns are complete
  }

  get newest() {
    return this.columns.time.at(-1);
  }

  row(value) {
    for (const name of NAMES) this.columns[name].push(value(name) ?? null);
  }

  // Add a status; skip a tick that the columns already hold, and the ticks without a number of a failed control loop.
  add(status) {
    const { tick, time } = this.columns;
    if (status.tick < 0) return;
    if (tick.length && status.tick <= tick.at(-1)) {
      if (status.tick > tick.at(-1) - 300) return;
      this.clear(); // the daemon was restarted
    }
    const now = cell.time(status);
    this.append(now, (name) => cell[name](status));
    if (time.length > ROWS_MAX) this.forget(now - STORED_S);
  }

  clear() {
    this.since = null;
    for (const name of NAMES) this.columns[name].length = 0;
  }

  forget(before) {
    const first = this.columns.time.findIndex((time) => time >= before);
    for (const name of NAMES) this.columns[name].splice(0, Math.max(first, 0));
  }

  // Load more if the columns do not reach back so many seconds.
  async cover(seconds) {
    if (this.newest - (this.since ?? this.newest) < seconds - 1) await this.load(seconds);
  }

  // Load the daemon's columns, as far back as these reach already, and keep the rows that arrived since.
  async load(seconds = Math.min(STORED_S, Math.max(FIRST_S, Math.ceil(this.newest - (this.since ?? this.newest)) || 0))) {
    const request = (this.request = Symbol("request")); // the answer to an earlier one may arrive later
    const kept = await get(`api/recent?seconds=${seconds}`, { seconds: LOADING_S }).catch(() => null);
    if (!kept?.tick?.length || request !== this.request) return;
    this.since = kept.time.at(-1) - seconds;
    const since = this.columns;
    this.columns = Object.fromEntries(NAMES.map((name) => [name, []]));
    kept.tick.forEach((_, k) => this.append(kept.time[k], (name) => kept[name]?.[k]));
    since.tick.forEach((tick, k) => tick > kept.tick.at(-1) && this.append(since.time[k], (name) => since[name][k]));
  }

  // Append a row; after missing ticks an empty row precedes it.
  append(now, value) {
    const { tick, time } = this.columns;
    if (time.length && now - time.at(-1) > GAP_S) this.row((name) => ({ tick: tick.at(-1), time: time.at(-1) + 0.001 })[name]);
    this.row(value);
  }
}
