// The one drawing of the arm for dashboard and log player; softarm/reporting/arm.py draws the same in pictures.

/* global sampleAt */
/* exported ARM_RADII_M, GOAL_WORDS, armOutline, valueBetween, spotBetween */
const ARM_RADII_M = [0.030, 0.024]; // at the cart and at the tip; the real dimensions are unknown
const GOAL_WORDS = { running: "target", reached: "reached ✓", failed: "missed ✕", cancelled: "cancelled" };
const ARM_GAP_S = 0.25; // nothing is drawn through a longer pause between two samples

// Return a smooth, tapered outline around two points or more, as [x, y] pairs; the far end is round.
function armOutline(points, [near, far], steps = 8) {
  const chord = (a, b) => Math.hypot(b[0] - a[0], b[1] - a[1]) || 1e-9;
  const last = points.length - 1;
  const tangents = points.map((_, i) => {
    const [a, b, c] = [points[Math.max(0, i - 1)], points[i], points[Math.min(last, i + 1)]];
    const length = (i > 0 ? chord(a, b) : 0) + (i < last ? chord(b, c) : 0);
    return [(c[0] - a[0]) / length, (c[1] - a[1]) / length];
  });
  const left = [], right = [];
  for (let k = 0; k <= last * steps; k++) {
    const i = Math.min(Math.floor(k / steps), last - 1), u = k / steps - i, size = chord(points[i], points[i + 1]);
    const at = [0, 1].map((axis) => {
      const [a, b, m, n] = [points[i][axis], points[i + 1][axis], size * tangents[i][axis], size * tangents[i + 1][axis]];
      const [c, d] = [3 * (b - a) - 2 * m - n, 2 * (a - b) + m + n];
      return [a + u * (m + u * (c + u * d)), m + u * (2 * c + 3 * u * d)];
    });
    const [[x, dx], [y, dy]] = at, radius = near + ((far - near) * k) / (last * steps), speed = Math.hypot(dx, dy) || 1e-9;
    const [across, along] = [(-dy / speed) * radius, (dx / speed) * radius];
    left.push([x + across, y + along]);
    right.unshift([x - across, y - along]);
    if (k < last * steps) continue;
    for (let turn = 1; turn < steps; turn++) {
      const [c, s] = [Math.cos((Math.PI * turn) / steps), Math.sin((Math.PI * turn) / steps)];
      left.push([x + across * c + along * s, y + along * c - across * s]);
    }
  }
  return [...left, ...right];
}

// Return a value between two samples by a cubic through their neighbours; NaN where a sample has none.
function valueBetween(t, values, time) {
  const finite = Number.isFinite, i = Math.min(Math.max(sampleAt(t, time), 0), t.length - 1);
  const [a, b, long] = [values[i], values[i + 1], t[i + 1] - t[i]];
  if (!finite(a)) return NaN;
  if (!finite(b) || !(long <= ARM_GAP_S) || time <= t[i]) return a;
  const slope = (k) => {
    const [p, n] = [finite(values[k - 1]) && t[k] - t[k - 1] <= ARM_GAP_S ? k - 1 : k, finite(values[k + 1]) && t[k + 1] - t[k] <= ARM_GAP_S ? k + 1 : k];
    return ((values[n] - values[p]) / (t[n] - t[p])) * long;
  };
  const [u, m, n] = [(time - t[i]) / long, slope(i), slope(i + 1)];
  return a + u * (m + u * (3 * (b - a) - 2 * m - n + u * (2 * (a - b) + m + n)));
}

// Return y and z at a time between two samples, from their columns; null if they are not tracked.
function spotBetween(t, columns, time) {
  const spot = columns.map((column) => valueBetween(t, column, time));
  return spot.every(Number.isFinite) ? spot : null;
}
