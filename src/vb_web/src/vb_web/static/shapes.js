// Lines and areas in the plane: points are [x, y] in metres.
"use strict";

export const pairs = (flat) =>
  Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i] / 100, flat[2 * i + 1] / 100]);
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// How far a point is from a line between two others.
export function toSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]],
    square = dx * dx + dy * dy;
  const t = square ? Math.max(0, Math.min(1, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square)) : 0;
  return distance(p, [a[0] + t * dx, a[1] + t * dy]);
}

// Fewer points, none of the others further than `tolerance` [m] from the line.
export function simplify(points, tolerance) {
  if (points.length < 3) return points;
  let worst = 0,
    at = 0;
  for (let i = 1; i < points.length - 1; i++) {
    const d = toSegment(points[i], points[0], points[points.length - 1]);
    if (d > worst) [worst, at] = [d, i];
  }
  if (worst <= tolerance) return [points[0], points[points.length - 1]];
  return [...simplify(points.slice(0, at + 1), tolerance).slice(0, -1), ...simplify(points.slice(at), tolerance)];
}

export function inside(p, polygon) {
  let odd = false;
  for (let i = 0, j = polygon.length - 1; i < polygon.length; j = i++) {
    const [a, b] = [polygon[i], polygon[j]];
    if (a[1] > p[1] !== b[1] > p[1] && p[0] < ((b[0] - a[0]) * (p[1] - a[1])) / (b[1] - a[1]) + a[0]) odd = !odd;
  }
  return odd;
}

// The point of what is inside a polygon and a box [left, right, low, high] that is furthest from their edges, of a grid of
// 24 x 24; null if there is none.
export function deepest(polygon, [left, right, low, high]) {
  const xs = polygon.map((p) => p[0]),
    ys = polygon.map((p) => p[1]);
  const [x0, x1] = [Math.max(left, Math.min(...xs)), Math.min(right, Math.max(...xs))];
  const [y0, y1] = [Math.max(low, Math.min(...ys)), Math.min(high, Math.max(...ys))];
  let best = null,
    depth = -Infinity;
  if (x0 > x1 || y0 > y1) return null;
  for (let i = 0; i < 24; i++)
    for (let j = 0; j < 24; j++) {
      const p = [x0 + ((i + 0.5) * (x1 - x0)) / 24, y0 + ((j + 0.5) * (y1 - y0)) / 24];
      if (!inside(p, polygon)) continue;
      let d = Math.min(p[0] - left, right - p[0], p[1] - low, high - p[1]);
      for (let k = 0; k < polygon.length; k++)
        d = Math.min(d, toSegment(p, polygon[k], polygon[(k + 1) % polygon.length]));
      d -= 0.02 * distance(p, [(x0 + x1) / 2, (y0 + y1) / 2]); // where several are as deep: the one in the middle
      if (d > depth) [best, depth] = [p, d];
    }
  return best;
}

export const mean = (points) => [0, 1].map((axis) => points.reduce((sum, p) => sum + p[axis], 0) / points.length);

// The point inside that is furthest from the edges; of a polygon that has no inside, its corners' mean.
export const middle = (polygon) => deepest(polygon, [-Infinity, Infinity, -Infinity, Infinity]) || mean(polygon);
