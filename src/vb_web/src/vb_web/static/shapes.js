// Lines and areas in the plane. Points are [x, y] in metres.
"use strict";

// Converts the server's whole centimetres [x0, y0, x1, y1, ...] to points.
export const toPoints = (flat) =>
  Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i] / 100, flat[2 * i + 1] / 100]);
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// Returns the distance of a point from the segment between two others.
export function distanceToSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const square = dx * dx + dy * dy;
  const t = square ? Math.max(0, Math.min(1, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square)) : 0;
  return distance(p, [a[0] + t * dx, a[1] + t * dy]);
}

// Leaves out points of a line that are no further than `tolerance` [m] from the line that remains (Douglas-Peucker).
export function simplify(points, tolerance) {
  if (points.length < 3) return points;
  let largest = 0;
  let farthest = 0;
  for (let i = 1; i < points.length - 1; i++) {
    const d = distanceToSegment(points[i], points[0], points[points.length - 1]);
    if (d > largest) [largest, farthest] = [d, i];
  }
  if (largest <= tolerance) return [points[0], points[points.length - 1]];
  const [first, second] = [points.slice(0, farthest + 1), points.slice(farthest)];
  return [...simplify(first, tolerance).slice(0, -1), ...simplify(second, tolerance)];
}

// Returns whether a point is inside a polygon: a ray from it crosses the outline an odd number of times.
export function inside(p, polygon) {
  let odd = false;
  for (let i = 0, j = polygon.length - 1; i < polygon.length; j = i++) {
    const [a, b] = [polygon[i], polygon[j]];
    const isAtSameHeight = a[1] > p[1] !== b[1] > p[1];
    const crossingX = ((b[0] - a[0]) * (p[1] - a[1])) / (b[1] - a[1]) + a[0];
    if (isAtSameHeight && p[0] < crossingX) odd = !odd;
  }
  return odd;
}

// Returns a point inside both a polygon and a box [left, right, low, high]: of a grid of 24 x 24 points, the one that
// is furthest from their edges. Returns null if no point of the grid is inside both.
export function innermostPointInBox(polygon, [left, right, low, high]) {
  const xs = polygon.map(([x]) => x);
  const ys = polygon.map(([, y]) => y);
  const [x0, x1] = [Math.max(left, Math.min(...xs)), Math.min(right, Math.max(...xs))];
  const [y0, y1] = [Math.max(low, Math.min(...ys)), Math.min(high, Math.max(...ys))];
  let best = null;
  let depth = -Infinity;
  if (x0 > x1 || y0 > y1) return null;
  for (let i = 0; i < 24; i++)
    for (let j = 0; j < 24; j++) {
      const p = [x0 + ((i + 0.5) * (x1 - x0)) / 24, y0 + ((j + 0.5) * (y1 - y0)) / 24];
      if (!inside(p, polygon)) continue;
      let d = Math.min(p[0] - left, right - p[0], p[1] - low, high - p[1]);
      for (let k = 0; k < polygon.length; k++)
        d = Math.min(d, distanceToSegment(p, polygon[k], polygon[(k + 1) % polygon.length]));
      d -= 0.02 * distance(p, [(x0 + x1) / 2, (y0 + y1) / 2]); // of equally distant points, the most central one counts
      if (d > depth) [best, depth] = [p, d];
    }
  return best;
}

export const meanPoint = (points) => [0, 1].map((axis) => points.reduce((sum, p) => sum + p[axis], 0) / points.length);

// Returns the point inside a polygon that is furthest from its edges, or the corners' mean if there is no such point.
export const innermostPoint = (polygon) =>
  innermostPointInBox(polygon, [-Infinity, Infinity, -Infinity, Infinity]) || meanPoint(polygon);
