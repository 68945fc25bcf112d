// What is written on the map: where lengths and names of borders stand, and how long the scale's bar is.
"use strict";
import { deepest, distance, middle } from "./shapes.js";
import { $ } from "./ui.js";

const MIN_SIDE_PX = 24; // of a side whose length is written
export const MARK_PX = 10;

// Nothing that is written covers anything else that is. First lengths, then a mark for each border of which
// something is in view, where it is; then its name instead of the mark, if there is room for it.
export function layWriting(map) {
  const [w, h] = map.size(),
    taken = [];
  layScale(map);
  const isFree = (box) =>
    taken.every(
      (one) => Math.abs(one.u - box.u) >= one.half + box.half || Math.abs(one.v - box.v) >= one.high + box.high,
    );
  const inFrame = ({ u, v, half, high }) => ({
    u: Math.max(half, Math.min(w - half, u)),
    v: Math.max(high, Math.min(h - high, v)),
    half,
    high,
  });
  const put = (group, { u, v }) => group.setAttribute("transform", `translate(${u.toFixed(1)} ${v.toFixed(1)})`);
  for (const group of map.placedGroup.querySelectorAll(".length")) {
    const [a, b, centre] = group.side.map((one) => map.toScreen(one)),
      long = distance(a, b);
    let [nu, nv] = [(b[1] - a[1]) / long, (a[0] - b[0]) / long]; // away from the shape, upwards if that is no shape
    const away = nu * (a[0] - centre[0]) + nv * (a[1] - centre[1]);
    if (Math.abs(away) > 1 ? away < 0 : nv > 0) [nu, nv] = [-nu, -nv];
    const { half, high } = group.extent,
      gap = 10 + Math.abs(nu) * half + Math.abs(nv) * high;
    const box = inFrame({ u: (a[0] + b[0]) / 2 + nu * gap, v: (a[1] + b[1]) / 2 + nv * gap, half, high });
    const shown = long > MIN_SIDE_PX && isFree(box);
    group.style.visibility = shown ? "" : "hidden";
    if (!shown) continue;
    put(group, box);
    taken.push(box);
  }
  const marks = new Map();
  for (const group of map.placedGroup.querySelectorAll(".name")) {
    const at = middleInView(map, group.border);
    group.style.visibility = at ? "" : "hidden";
    if (!at) continue;
    const [u, v] = map.toScreen(at),
      box = { ...inFrame({ u, v, half: MARK_PX, high: MARK_PX }), at: { u, v } };
    while (!isFree(box)) box.u += u < w / 2 ? 2 : -2;
    taken.push(box);
    marks.set(group, box);
  }
  let unnamed = false;
  for (const [group, box] of marks) {
    taken.splice(taken.indexOf(box), 1);
    const name = namePlaces(map, group, box.at)
      .map((one) => ({ from: one, to: inFrame({ ...one, ...group.extent }) }))
      // it may be shifted into the frame as long as it is still where it belongs
      .find(({ from, to }) => Math.abs(to.u - from.u) < to.half && Math.abs(to.v - from.v) < to.high && isFree(to));
    put(group, name ? name.to : box);
    taken.push(name ? name.to : box);
    group.classList.toggle("marked", !name);
    unnamed = unnamed || !name;
  }
  document.body.classList.toggle("marks", unnamed);
}

// Where a border's name may stand: on an area, beside a line.
function namePlaces(map, { border, extent: { half, high } }, { u, v }) {
  if (border.kind === "polygon") return [{ u, v }];
  const [a, b] = [border.line[0], border.line[border.line.length - 1]].map((one) => map.toScreen(one)),
    steep = Math.abs(a[1] - b[1]) > Math.abs(a[0] - b[0]);
  const beside = [half + 6, -half - 6].map((by) => ({ u: u + by, v })),
    above = [-high - 6, high + 6].map((by) => ({ u, v: v + by }));
  return steep ? [...beside, ...above] : [...above, ...beside];
}

// The middle of what can be seen of a border; null if that is nothing.
function middleInView(map, border) {
  const [w, h] = map.size(),
    [left, high] = map.toWorld([0, 0]),
    [right, low] = map.toWorld([w, h]);
  const inView = (p) => p[0] >= left && p[0] <= right && p[1] >= low && p[1] <= high;
  const closed = border.kind === "polygon";
  if (closed && border.line.every(inView)) return (border.middle = border.middle || middle(border.line));
  const within = closed && deepest(border.line, [left, right, low, high]);
  if (within) return within;
  const ends = closed ? [...border.line, border.line[0]] : border.line,
    seen = [];
  for (let i = 1; i < ends.length; i++) {
    const [a, b] = [ends[i - 1], ends[i]],
      steps = Math.ceil((distance(a, b) * map.view.scale) / 8) + 1;
    for (let k = 0; k < steps; k++)
      seen.push([a[0] + ((b[0] - a[0]) * (k + 0.5)) / steps, a[1] + ((b[1] - a[1]) * (k + 0.5)) / steps]);
  }
  const visible = seen.filter(inView);
  return visible.length ? visible[Math.floor(visible.length / 2)] : null;
}

// Lays the scale's bar, of a round length.
function layScale(map) {
  const most = 100 / map.view.scale,
    power = 10 ** Math.floor(Math.log10(most)),
    length = [5, 2, 1].map((one) => one * power).find((one) => one <= most);
  const text = `${map.words.number(length, 2)} m`;
  if ($("scale").textContent !== text) $("scale").textContent = text;
  $("scale").style.width = `${(length * map.view.scale).toFixed(1)}px`;
}
