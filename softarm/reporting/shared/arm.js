// The one drawing of the arm for dashboard and log player; softarm/reporting/arm.py draws the same in pictures.

/* exported ARM_RADII_M, armOutline */
const ARM_RADII_M = [0.030, 0.024]; // at the cart and at the tip; the real dimensions are unknown

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
