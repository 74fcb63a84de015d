// A swing cut from the columns of `GET /api/recent`: its ticks, its closest moment and the arm between two ticks. Pure.

/* global valueBetween */
const LEAD_S = 0.1; // shown before the request
export const AFTER_S = 0.5; // shown after the end: the arm still swings
const CHARTS_S = 3; // shown by the charts at least
const FINE_S = 1 / 240; // between the distances that are compared
const CURVES = ["tip_y_m", "tip_z_m", "cart_m", "action_velocity_m_s", "sent_velocity_m_s", "cart_velocity_m_s", "action_pressure_kpa", "sent_pressure_kpa", "pressure_kpa"];

// Return the seconds of `GET /api/recent` that contain a goal's swing; newest: Unix time of the newest tick.
export function secondsOf({ request, end }, newest) {
  return Math.ceil(newest - Math.min(Date.parse(request.time) / 1000 - LEAD_S, Date.parse(end.time) / 1000 - CHARTS_S)) + 2;
}

// Return where an ended goal lies in columns of ticks: rows, and times from the request; null if the columns do not contain it.
function placeOf({ request, end, next }, { tick, time }) {
  const rowOf = (wanted) => tick.findIndex((number) => number >= wanted);
  const [first, last] = [rowOf(request.tick), rowOf(end.tick)];
  if (!(tick[0] <= request.tick) || last < 0) return null;
  const [began, ended] = [time[first], time[last] - time[first]];
  const stop = next === null ? Infinity : (time[rowOf(next)] ?? Infinity) - began;
  const to = Math.min(ended + AFTER_S, stop, time.at(-1) - began);
  return { began, ended, to };
}

// Return an ended goal's swing as data for Replay, or null if its ticks are not in the columns. Times count from the request.
export function cutSwing(of, recent, robot) {
  const place = placeOf(of, recent);
  if (place === null) return null;
  const { goal, request, end } = of;
  const { began, ended, to } = place;
  const charts = [Math.min(-LEAD_S, to - CHARTS_S), to];
  const rows = recent.time.map((_, k) => k).filter((k) => recent.time[k] - began >= charts[0] && recent.time[k] - began <= to);
  const pick = (column) => rows.map((k) => column[k]);
  const t = pick(recent.time).map((at) => Number((at - began).toFixed(3)));
  const curves = Object.fromEntries(CURVES.map((name) => [name, pick(recent[name])]));
  return {
    goal, robot, t, curves, charts, ended, to, state: end.what, text: end.text, who: request.who, at: request.time,
    from: Math.max(charts[0], -LEAD_S), bodies: pick(recent.bodies), closest: closest(t, curves, goal, countedTo(end.what, place), end.what === "reached" ? robot.success_radius_m : Infinity),
  };
}

// Return until when the closest moment counts: a missed target ends with its goal, a reached one is still passed after it.
const countedTo = (state, { ended, to }) => (state === "reached" ? to : ended);

// Return {at, m} of the tip's closest moment to a target until a time; null without a tip or target. Also null above `most`:
// a target is reached by a frame, and a late control loop may have no tick near that frame.
function closest(t, { tip_y_m, tip_z_m }, { y_m, z_m }, to, most) {
  let best = null;
  for (let at = 0; at <= to; at += FINE_S) {
    const m = Math.hypot(valueBetween(t, tip_y_m, at) - y_m, valueBetween(t, tip_z_m, at) - z_m);
    if (m < (best?.m ?? most)) best = { at, m };
  }
  return best;
}

// Return y and z of every body as columns over the ticks of a swing.
export const bodyColumns = ({ bodies }) => bodies[0].map((_, b) => [0, 1].map((axis) => bodies.map((tick) => tick[b]?.[axis] ?? null)));
