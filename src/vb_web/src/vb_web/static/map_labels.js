// Lays out the texts on the map, which are lengths and names of borders, and the scale's bar.
"use strict";
import { distance, innermostPoint, innermostPointInBox } from "./shapes.js";
import { $ } from "./elements.js";

const MIN_SIDE_PX = 24; // length of a side from which its length is written beside it
export const MARK_PX = 10;

// Lays out the lengths first, then a mark for each border that is at least partly in view. Then each mark is replaced
// by the border's name if there is room for it. No text covers another one. A box is {u, v: its centre, half: half of
// its width, high: half of its height} [px].
export function layOutTexts(map) {
  const [w, h] = map.size();
  const boxes = [];
  layOutScale(map);
  const isFree = (box) =>
    boxes.every(
      (other) =>
        Math.abs(other.u - box.u) >= other.half + box.half || Math.abs(other.v - box.v) >= other.high + box.high,
    );
  const inFrame = ({ u, v, half, high }) => ({
    u: Math.max(half, Math.min(w - half, u)),
    v: Math.max(high, Math.min(h - high, v)),
    half,
    high,
  });
  const move = (group, { u, v }) => group.setAttribute("transform", `translate(${u.toFixed(1)} ${v.toFixed(1)})`);
  for (const group of map.symbolGroup.querySelectorAll(".length")) {
    const [a, b, centre] = group.side.map((point) => map.toScreen(point));
    const length = distance(a, b);
    // the side's normal points away from the shape's centre, or upwards if the draft has only this side
    let [nu, nv] = [(b[1] - a[1]) / length, (a[0] - b[0]) / length];
    const outwards = nu * (a[0] - centre[0]) + nv * (a[1] - centre[1]);
    if (Math.abs(outwards) > 1 ? outwards < 0 : nv > 0) [nu, nv] = [-nu, -nv];
    const { half, high } = group.extent;
    const gap = 10 + Math.abs(nu) * half + Math.abs(nv) * high;
    const box = inFrame({ u: (a[0] + b[0]) / 2 + nu * gap, v: (a[1] + b[1]) / 2 + nv * gap, half, high });
    const isShown = length > MIN_SIDE_PX && isFree(box);
    group.style.visibility = isShown ? "" : "hidden";
    if (!isShown) continue;
    move(group, box);
    boxes.push(box);
  }
  const markBoxes = new Map();
  for (const group of map.symbolGroup.querySelectorAll(".name")) {
    const centre = middleInView(map, group.border);
    group.style.visibility = centre ? "" : "hidden";
    if (!centre) continue;
    const [u, v] = map.toScreen(centre);
    const box = { ...inFrame({ u, v, half: MARK_PX, high: MARK_PX }), wanted: { u, v } };
    while (!isFree(box)) box.u += u < w / 2 ? 2 : -2;
    boxes.push(box);
    markBoxes.set(group, box);
  }
  let hasMarks = false;
  for (const [group, markBox] of markBoxes) {
    boxes.splice(boxes.indexOf(markBox), 1);
    const name = namePositions(map, group, markBox.wanted)
      .map((position) => ({ position, box: inFrame({ ...position, ...group.extent }) }))
      // a text may be shifted into the frame, but not so far that it no longer covers its desired position
      .find(
        ({ position, box }) =>
          Math.abs(box.u - position.u) < box.half && Math.abs(box.v - position.v) < box.high && isFree(box),
      );
    const box = name ? name.box : markBox;
    move(group, box);
    boxes.push(box);
    group.classList.toggle("marked", !name);
    hasMarks = hasMarks || !name;
  }
  document.body.classList.toggle("marks", hasMarks);
}

// Lists the positions where a border's name may stand, the best first: on an area, or beside a line.
function namePositions(map, { border, extent: { half, high } }, { u, v }) {
  if (border.kind === "polygon") return [{ u, v }];
  const [a, b] = [border.line[0], border.line[border.line.length - 1]].map((point) => map.toScreen(point));
  const isSteep = Math.abs(a[1] - b[1]) > Math.abs(a[0] - b[0]);
  const beside = [half + 6, -half - 6].map((offset) => ({ u: u + offset, v }));
  const above = [-high - 6, high + 6].map((offset) => ({ u, v: v + offset }));
  return isSteep ? [...beside, ...above] : [...above, ...beside];
}

// Returns the middle of the visible part of a border, or null if no part of it is visible.
function middleInView(map, border) {
  const [w, h] = map.size();
  const [left, high] = map.toWorld([0, 0]);
  const [right, low] = map.toWorld([w, h]);
  const isInView = ([x, y]) => x >= left && x <= right && y >= low && y <= high;
  const closed = border.kind === "polygon";
  if (closed && border.line.every(isInView)) {
    border.middle = border.middle || innermostPoint(border.line);
    return border.middle;
  }
  const innermostInView = closed && innermostPointInBox(border.line, [left, right, low, high]);
  if (innermostInView) return innermostInView;
  // only the line crosses the view: of its samples there, which are 8 px apart, the middle one is returned
  const corners = closed ? [...border.line, border.line[0]] : border.line;
  const samples = [];
  for (let i = 1; i < corners.length; i++) {
    const [a, b] = [corners[i - 1], corners[i]];
    const steps = Math.ceil((distance(a, b) * map.view.scale) / 8) + 1;
    for (let k = 0; k < steps; k++) {
      const x = a[0] + ((b[0] - a[0]) * (k + 0.5)) / steps;
      const y = a[1] + ((b[1] - a[1]) * (k + 0.5)) / steps;
      samples.push([x, y]);
    }
  }
  const visible = samples.filter(isInView);
  return visible.length ? visible[Math.floor(visible.length / 2)] : null;
}

// Lays out the scale's bar: 1, 2 or 5 times a power of ten metres, at most 100 px.
function layOutScale(map) {
  const longest = 100 / map.view.scale;
  const power = 10 ** Math.floor(Math.log10(longest));
  const length = [5, 2, 1].map((digit) => digit * power).find((metres) => metres <= longest);
  const text = `${map.words.number(length, 2)} m`;
  if ($("scale").textContent !== text) $("scale").textContent = text;
  $("scale").style.width = `${(length * map.view.scale).toFixed(1)}px`;
}
