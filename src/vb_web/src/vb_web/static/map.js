// The map: pictures below, lines above, both moved by one view {x, y: metres in the middle, scale: pixels per metre}.
// What is drawn in the world's metres (lines) scales with it; what is placed (robots, names, handles) keeps its size.
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const HANDLE_PX = 24; // half of a finger
const MARK_PX = 10;
const $ = (id) => document.getElementById(id);

export function make(name, attributes = {}, parent = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

export const pairs = (flat) =>
  Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i] / 100, flat[2 * i + 1] / 100]);
export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const path = (points, closed) =>
  points.length ? "M" + points.map((p) => `${p[0]} ${p[1]}`).join("L") + (closed ? "Z" : "") : "";
const short = (text) => (text.length > 26 ? `${text.slice(0, 25)}…` : text);
const dots = (points) => points.map((p) => `M${p[0]} ${p[1]}h.001`).join("");

function toSegment(p, a, b) {
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
function deepest(polygon, [left, right, low, high]) {
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

const mean = (points) => [0, 1].map((axis) => points.reduce((sum, p) => sum + p[axis], 0) / points.length);

// The point inside that is furthest from the edges; of a polygon that has no inside, its corners' mean.
export const middle = (polygon) => deepest(polygon, [-Infinity, Infinity, -Infinity, Infinity]) || mean(polygon);

export class MapView {
  // `on` has tap(point, picked), stroke(points), drag(index, point, ended), between(index, point), choose(index), outside()
  constructor(words, on) {
    Object.assign(this, {
      words,
      on,
      view: { x: 0, y: 0, scale: 50 },
      info: null,
      borders: [],
      pointers: new Map(),
      drawing: false,
      cursor: null,
    });
    this.element = $("map");
    this.world = $("world");
    this.placedGroup = $("placed");
    this.handleGroup = $("handles");
    this.layers = {};
    for (const name of ["borders", "progress", "draft", "drives"]) this.layers[name] = { lines: [], placed: [] };
    this.listen();
    new ResizeObserver(() => {
      if (this.gesture === "stroke") {
        this.gesture = null;
        this.on.stroke([], false);
      } // a phone that is turned: the finger is elsewhere now
      if (!this.touched) this.fit();
      else this.update();
    }).observe(this.element);
  }

  // ------------------------------------------------------------- view
  size() {
    const box = this.element.getBoundingClientRect();
    return [box.width, box.height];
  }
  toScreen([x, y]) {
    const [w, h] = this.size();
    return [w / 2 + (x - this.view.x) * this.view.scale, h / 2 - (y - this.view.y) * this.view.scale];
  }
  toWorld([u, v]) {
    const [w, h] = this.size();
    return [this.view.x + (u - w / 2) / this.view.scale, this.view.y - (v - h / 2) / this.view.scale];
  }

  // Between metres right of and above the map's lower left corner, and the world.
  fromCorner([right, up]) {
    const { x, y, cos, sin } = this.info;
    return [x + cos * right - sin * up, y + sin * right + cos * up];
  }
  toCorner([px, py]) {
    const { x, y, cos, sin } = this.info;
    return [cos * (px - x) + sin * (py - y), cos * (py - y) - sin * (px - x)];
  }

  fit() {
    const [w, h] = this.size();
    if (!this.info || w < 24 || h < 24) return; // not laid out yet: the observer calls again
    const { width, height } = this.info,
      corners = [
        [0, 0],
        [width, 0],
        [width, height],
        [0, height],
      ].map((one) => this.fromCorner(one)),
      xs = corners.map((p) => p[0]),
      ys = corners.map((p) => p[1]);
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    $("map-area").style.setProperty("--aspect", ((y1 - y0) / (x1 - x0)).toFixed(3));
    this.view = {
      x: (x0 + x1) / 2,
      y: (y0 + y1) / 2,
      scale: Math.max(1, Math.min((w - 12) / (x1 - x0), (h - 12) / (y1 - y0))),
    };
    this.limits = [this.view.scale, Math.max(400, this.view.scale * 20)];
    this.box = [x0, x1, y0, y1];
    this.touched = false;
    this.update();
  }

  // Moves the view by pixels; the map cannot leave its frame.
  pan(right, down) {
    this.view.x -= right / this.view.scale;
    this.view.y += down / this.view.scale;
    this.keepInFrame();
  }

  keepInFrame() {
    const [x0, x1, y0, y1] = this.box,
      [w, h] = this.size();
    for (const [axis, low, high, frame] of [
      ["x", x0, x1, w],
      ["y", y0, y1, h],
    ]) {
      const slack = Math.max(0, (high - low) / 2 + (HANDLE_PX - frame / 2) / this.view.scale),
        centre = (low + high) / 2;
      this.view[axis] = Math.max(centre - slack, Math.min(centre + slack, this.view[axis]));
    }
    this.touched = true;
    this.update();
  }

  // The point of the map that is nearest to a point of the world, so that every corner can be seen and gripped.
  onMap(point) {
    const { width, height } = this.info,
      [right, up] = this.toCorner(point);
    return this.fromCorner([Math.max(0, Math.min(width, right)), Math.max(0, Math.min(height, up))]);
  }

  zoom(factor, at = null) {
    if (!this.info) return;
    const [w, h] = this.size(),
      point = at || [w / 2, h / 2],
      before = this.toWorld(point);
    this.view.scale = Math.max(this.limits[0], Math.min(this.limits[1], this.view.scale * factor));
    const after = this.toWorld(point);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
    this.keepInFrame();
  }

  update() {
    if (this.planned) return;
    this.planned = requestAnimationFrame(() => {
      this.planned = 0;
      this.lay();
    });
  }

  lay() {
    if (!this.info) return;
    const { x, y, scale } = this.view,
      [w, h] = this.size();
    this.world.setAttribute("transform", `matrix(${scale} 0 0 ${-scale} ${w / 2 - x * scale} ${h / 2 + y * scale})`);
    const { resolution, cells, rows, columns, cos, sin } = this.info,
      [left, bottom] = this.toScreen(this.fromCorner([0, 0]));
    for (const image of $("pictures").children) {
      if (!image.naturalWidth) continue;
      // every picture begins at the map's lower left corner; they differ in how many cells a pixel has
      const per =
        { floor: this.info.floor, region: Math.max(1, Math.ceil(Math.max(rows, columns) / 700)) }[image.id] || cells;
      const [c, s] = [cos, sin].map((one) => one * per * resolution * scale),
        high = image.naturalHeight;
      image.style.transform = `matrix(${c},${-s},${s},${c},${left - s * high},${bottom - c * high})`;
    }
    for (const element of [...this.placedGroup.children, ...this.handleGroup.children]) {
      if (!element.at) continue;
      const [u, v] = this.toScreen(element.at);
      element.setAttribute(
        "transform",
        `translate(${u.toFixed(1)} ${v.toFixed(1)})` +
          (element.yaw === undefined ? "" : ` rotate(${((-element.yaw * 180) / Math.PI).toFixed(1)})`) +
          (element.metres ? ` scale(${Math.max(12, element.metres * scale).toFixed(2)})` : ""),
      );
    }
    this.layWriting();
  }

  // Nothing that is written covers anything else that is. First lengths, then a mark for each border of which
  // something is in view, where it is; then its name instead of the mark, if there is room for it.
  layWriting() {
    const [w, h] = this.size(),
      taken = [];
    this.layScale();
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
    for (const group of this.placedGroup.querySelectorAll(".length")) {
      const [a, b, centre] = group.side.map((one) => this.toScreen(one)),
        long = distance(a, b);
      let [nu, nv] = [(b[1] - a[1]) / long, (a[0] - b[0]) / long]; // away from the shape, upwards if that is no shape
      const away = nu * (a[0] - centre[0]) + nv * (a[1] - centre[1]);
      if (Math.abs(away) > 1 ? away < 0 : nv > 0) [nu, nv] = [-nu, -nv];
      const { half, high } = group.extent,
        gap = 10 + Math.abs(nu) * half + Math.abs(nv) * high;
      const box = inFrame({ u: (a[0] + b[0]) / 2 + nu * gap, v: (a[1] + b[1]) / 2 + nv * gap, half, high });
      const shown = long > HANDLE_PX && isFree(box);
      group.style.visibility = shown ? "" : "hidden";
      if (!shown) continue;
      put(group, box);
      taken.push(box);
    }
    const marks = new Map();
    for (const group of this.placedGroup.querySelectorAll(".name")) {
      const at = this.middleInView(group.border);
      group.style.visibility = at ? "" : "hidden";
      if (!at) continue;
      const [u, v] = this.toScreen(at),
        box = { ...inFrame({ u, v, half: MARK_PX, high: MARK_PX }), at: { u, v } };
      while (!isFree(box)) box.u += u < w / 2 ? 2 : -2;
      taken.push(box);
      marks.set(group, box);
    }
    let unnamed = false;
    for (const [group, box] of marks) {
      taken.splice(taken.indexOf(box), 1);
      const name = this.namePlaces(group, box.at)
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
  namePlaces({ border, extent: { half, high } }, { u, v }) {
    if (border.kind === "polygon") return [{ u, v }];
    const [a, b] = [border.line[0], border.line[border.line.length - 1]].map((one) => this.toScreen(one)),
      steep = Math.abs(a[1] - b[1]) > Math.abs(a[0] - b[0]);
    const beside = [half + 6, -half - 6].map((by) => ({ u: u + by, v })),
      above = [-high - 6, high + 6].map((by) => ({ u, v: v + by }));
    return steep ? [...beside, ...above] : [...above, ...beside];
  }

  // The middle of what can be seen of a border; null if that is nothing.
  middleInView(border) {
    const [w, h] = this.size(),
      [left, high] = this.toWorld([0, 0]),
      [right, low] = this.toWorld([w, h]);
    const inView = (p) => p[0] >= left && p[0] <= right && p[1] >= low && p[1] <= high;
    const closed = border.kind === "polygon";
    if (closed && border.line.every(inView)) return (border.middle = border.middle || middle(border.line));
    const within = closed && deepest(border.line, [left, right, low, high]);
    if (within) return within;
    const ends = closed ? [...border.line, border.line[0]] : border.line,
      seen = [];
    for (let i = 1; i < ends.length; i++) {
      const [a, b] = [ends[i - 1], ends[i]],
        steps = Math.ceil((distance(a, b) * this.view.scale) / 8) + 1;
      for (let k = 0; k < steps; k++)
        seen.push([a[0] + ((b[0] - a[0]) * (k + 0.5)) / steps, a[1] + ((b[1] - a[1]) * (k + 0.5)) / steps]);
    }
    const visible = seen.filter(inView);
    return visible.length ? visible[Math.floor(visible.length / 2)] : null;
  }

  // Lays the scale's bar, of a round length.
  layScale() {
    const most = 100 / this.view.scale,
      power = 10 ** Math.floor(Math.log10(most)),
      length = [5, 2, 1].map((one) => one * power).find((one) => one <= most);
    const text = `${this.words.number(length, 2)} m`;
    if ($("scale").textContent !== text) $("scale").textContent = text;
    $("scale").style.width = `${(length * this.view.scale).toFixed(1)}px`;
  }

  // ------------------------------------------------------------- what is shown
  setMap(info) {
    const other =
      !this.info ||
      this.info.rows !== info.rows ||
      this.info.columns !== info.columns ||
      this.info.resolution !== info.resolution;
    const {
      origin: [x, y, yaw],
      rows,
      columns,
      resolution,
    } = info;
    const [width, height] = [columns * resolution, rows * resolution];
    this.info = { ...info, x, y, cos: Math.cos(yaw), sin: Math.sin(yaw), width, height };
    $("no-map").classList.add("gone");
    this.picture("base", `picture/map/${info.picture}.png`);
    this.picture("restricted", info.restricted ? `picture/restricted/${info.restricted}.png` : "");
    if (other) this.fit();
    else this.update();
  }

  picture(id, url) {
    const image = $(id);
    if (image.dataset.url === url) return;
    image.dataset.url = url;
    if (!url) {
      image.classList.remove("there");
      image.removeAttribute("src");
      return;
    }
    this.fetchPicture(image, url, 1000);
  }

  // Asks for a picture, and again as long as it is wanted and cannot be had: cameras may come later than the page.
  fetchPicture(image, url, pause) {
    const next = new Image(); // the one before stays until the new one is there
    next.onload = () => {
      if (image.dataset.url === url) {
        image.src = url;
        image
          .decode()
          .catch(() => 0)
          .then(() => {
            image.classList.add("there");
            this.lay();
          });
      }
    };
    next.onerror = () =>
      setTimeout(() => {
        if (image.dataset.url === url) this.fetchPicture(image, url, Math.min(2 * pause, 8000));
      }, pause);
    next.src = url;
  }

  clear(layer) {
    for (const element of [...this.layers[layer].lines, ...this.layers[layer].placed]) element.remove();
    this.layers[layer] = { lines: [], placed: [] };
  }
  line(layer, kind, d) {
    this.layers[layer].lines.push(make("path", { class: kind, d }, this.world));
  }
  place(layer, kind, at, parts) {
    const group = make("g", { class: kind }, this.placedGroup);
    group.at = at;
    for (const [name, attributes, text] of parts) make(name, attributes, group).textContent = text || "";
    if (layer) this.layers[layer].placed.push(group);
    this.update();
    return group;
  }

  // Writes lines of text, one below the other, whose place layWriting finds.
  write(layer, kind, texts) {
    const lines = texts.filter(Boolean),
      group = make("g", { class: kind }, this.placedGroup);
    lines.forEach((text, i) => {
      const y = `${(0.35 + 1.3 * (i - (lines.length - 1) / 2)).toFixed(2)}em`;
      make("text", { class: i ? "note" : "", y }, group).textContent = text;
    });
    const half = Math.max(...[...group.children].map((text) => text.getComputedTextLength())) / 2 + 4;
    group.extent = { half, high: 3 + 9 * lines.length };
    this.layers[layer].placed.push(group);
    this.update();
    return group;
  }

  // The length of a draft's side, written away from the draft's middle.
  measure(side, centre) {
    const text = `${this.words.number(distance(...side), 2)} m`;
    this.write("draft", "length", [text]).side = [...side, centre];
  }

  // `hidden` is the id of the border that is being changed; a border's `note` stands under its name.
  setBorders(borders, hidden) {
    this.borders = borders.map((border) => ({ ...border, line: pairs(border.points) }));
    this.clear("borders");
    for (const border of this.borders) {
      if (border.id === hidden) continue;
      // what a border that waits for a person closed off before, and what it will close off
      for (const when of ["before", "after"]) {
        if (border[when]?.length) this.line("borders", `border ${when}`, path(pairs(border[when]), true));
      }
      this.line("borders", `border ${border.kind} ${border.idle || ""}`, path(border.line, border.kind === "polygon"));
      const group = this.write("borders", "name", [
        short(this.words.border(border.name) || this.words.say("page_no_name")),
        short(border.note),
      ]);
      group.border = border;
      const sign = make("g", { class: `mark ${border.idle || ""}` }, group);
      make("circle", { r: MARK_PX }, sign);
      make("text", { y: "0.35em" }, sign).textContent = border.mark;
    }
    this.update();
  }

  setProgress(progress) {
    this.clear("progress");
    if (!progress) return;
    this.line("progress", "left-out", dots(pairs(progress.left_out)));
    this.line("progress", "points", dots(pairs(progress.points)));
    this.line("progress", "chain", path(pairs(progress.chain), progress.closed));
    if (progress.seed.length) this.seed("progress", pairs(progress.seed)[0]);
    this.update();
  }

  seed(layer, at) {
    this.place(layer, "seed", at, [["path", { d: "M-9 0A9 9 0 1 0 9 0A9 9 0 1 0-9 0M-4.5 0H4.5" }]]);
  }

  setRobots(robots) {
    this.robots = this.robots || {};
    for (const [name, pose] of Object.entries(robots)) {
      let group = this.robots[name];
      if (!group) {
        group = this.robots[name] = this.place(
          null,
          "robot",
          [0, 0],
          [
            ["path", { class: "body", d: "M1 0A1 1 0 1 1 1-.01Z" }],
            ["path", { class: "heading", d: "M.8 0-.6.5-.3 0-.6-.5Z" }],
            ["title", {}, name || "robot"],
          ],
        );
        group.metres = 0.18;
      }
      group.at = [pose[0], pose[1]];
      group.yaw = pose[2];
    }
    this.update();
  }

  // Where robots are going, by name: the goal, and their navigation's path there.
  setDrives(drives) {
    this.clear("drives");
    for (const { goal, path: way } of Object.values(drives)) {
      this.line("drives", "path", path(pairs(way), false));
      this.place("drives", "goal", pairs(goal)[0], [["path", { d: "M0 0C-9-11-9-22 0-22S9-11 0 0ZM-3-14A3 3 0 1 0 3-14A3 3 0 1 0-3-14" }]]);
    }
    this.update();
  }

  setSpots(spots) {
    this.spots = this.spots || {};
    for (const [camera, spot] of Object.entries(spots)) {
      const old = this.spots[camera];
      if (old && old.stamp === spot[3]) continue;
      const group = old || this.place(null, "spot", [0, 0], [["circle", { r: 6 }]]);
      this.spots[camera] = group;
      // what came before this page was opened, or before the link was lost, is not seen now
      const first = group.stamp === undefined;
      group.stamp = spot[3];
      group.at = [spot[0] / 100, spot[1] / 100];
      group.style.opacity = first && !this.live ? 0 : 1;
      clearTimeout(group.timer);
      group.timer = setTimeout(() => {
        group.style.opacity = 0;
      }, 500);
    }
    this.live = true;
    this.lay();
  }

  // A draft's line, corners and seed; chosen is the corner that buttons and arrow keys are about.
  setDraft(draft, chosen, rough) {
    this.clear("draft");
    const focused = document.activeElement && document.activeElement.dataset && document.activeElement.dataset.corner;
    this.handleGroup.replaceChildren();
    if (!draft) return this.update();
    const closed = draft.kind === "polygon",
      points = draft.points;
    this.line("draft", "draft", path(points, closed && !rough));
    if (rough) {
      for (const p of points.slice(0, rough === "taps" ? 99 : 0))
        this.place("draft", "knob", p, [["circle", { r: 7 }]]);
      if (rough === "taps" && points.length > 1) this.measure(points.slice(-2), mean(points));
      return this.update();
    }
    const count = points.length,
      sides = points.map((p, i) => [p, points[(i + 1) % count]]).slice(0, closed ? count : count - 1);
    sides.forEach((side, i) => {
      if (count === 2 || (chosen !== null && (i === chosen || (i + 1) % count === chosen)))
        this.measure(side, mean(points));
    });
    if (count <= 24)
      for (let i = 0; i < (closed ? count : count - 1); i++) {
        const next = points[(i + 1) % count];
        if (distance(points[i], next) * this.view.scale > 60)
          this.handle("between", [(points[i][0] + next[0]) / 2, (points[i][1] + next[1]) / 2], 5, {
            between: i,
            label: this.words.say("page_between", { number: i + 1 }),
          });
      }
    points.forEach((p, i) =>
      this.handle(i === chosen ? "chosen" : "", p, 8, {
        corner: i,
        label: this.words.say("page_corner", {
          number: i + 1,
          x: this.words.number(p[0], 2),
          y: this.words.number(p[1], 2),
        }),
      }),
    );
    if (draft.kind !== "wall" && draft.seed) this.seed("draft", draft.seed);
    this.lay();
    if (focused !== undefined) {
      const again = this.handleGroup.querySelector(`[data-corner="${focused}"]`);
      if (again) again.focus({ preventScroll: true });
    }
  }

  handle(kind, at, radius, { corner, between, label }) {
    const group = make("g", { class: kind, tabindex: 0, role: "button", "aria-label": label }, this.handleGroup);
    if (corner !== undefined) group.dataset.corner = corner;
    else group.dataset.between = between;
    group.at = at;
    make("circle", { class: "hit", r: corner === undefined ? 16 : HANDLE_PX }, group);
    make("circle", { class: "knob", r: radius }, group);
  }

  setCursor(at) {
    if (this.cursor) this.cursor.remove();
    this.cursor = at && this.place(null, "crosshair", at, [["path", { d: "M-16 0H16M0-16V16" }]]);
    if (this.cursor) this.lay();
  }

  // ------------------------------------------------------------- fingers, mouse, keys
  at(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  listen() {
    const element = this.element;
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"])
      element.addEventListener(name, (event) => this.up(event, name === "pointerup"));
    element.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * 0.0015), this.at(event));
      },
      { passive: false },
    );
    // one finger scrolls the page while nothing is drawn, two move the map
    element.addEventListener(
      "touchmove",
      (event) => {
        if (event.touches.length > 1) event.preventDefault();
      },
      { passive: false },
    );
    // a tap is over when the finger is lifted: its click would press what the tap has brought up under the finger
    element.addEventListener(
      "touchend",
      (event) => {
        if (event.cancelable) event.preventDefault();
      },
      { passive: false },
    );
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("blur", () => this.setCursor(null));
  }

  down(event) {
    if (event.button > 0 || !this.info) return;
    const here = this.at(event);
    try {
      this.element.setPointerCapture(event.pointerId);
    } catch (_) {
      /* a pointer that is gone already */
    }
    this.pointers.set(event.pointerId, here);
    if (this.pointers.size > 1) {
      this.gesture = "pinch";
      this.on.stroke([], false);
      return;
    }
    const handle = event.target.closest && event.target.closest("#handles g");
    this.start = here;
    this.moved = false;
    if (handle && handle.dataset.corner !== undefined) {
      this.gesture = "corner";
      this.corner = Number(handle.dataset.corner);
      this.on.choose(this.corner);
    } else if (handle) {
      this.gesture = "between";
      this.corner = Number(handle.dataset.between);
    } else if (this.drawing) {
      this.gesture = "stroke";
      this.strokePoints = [this.toWorld(here)];
    } else this.gesture = "pan";
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const here = this.at(event);
    if (this.gesture === "pinch") {
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId);
      if (other) {
        const [a, b] = [distance(before, other[1]), distance(here, other[1])];
        this.pan((here[0] - before[0]) / 2, (here[1] - before[1]) / 2);
        this.zoom(a > 10 ? b / a : 1, [(here[0] + other[1][0]) / 2, (here[1] + other[1][1]) / 2]);
      }
    } else if (!this.moved && distance(here, this.start) < 6) return;
    else {
      this.moved = true;
      if (this.gesture === "pan") {
        if (event.pointerType !== "touch") this.pan(here[0] - before[0], here[1] - before[1]);
      } else if (this.gesture === "stroke") {
        const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [event];
        for (const one of events.length ? events : [event]) this.strokePoints.push(this.toWorld(this.at(one)));
        this.on.stroke(
          this.strokePoints.map((point) => this.onMap(point)),
          false,
        );
      } else if (this.gesture === "between") {
        this.gesture = "corner";
        this.corner = this.on.between(this.corner, this.onMap(this.toWorld(here)));
      } else if (this.gesture === "corner") this.on.drag(this.corner, this.onMap(this.toWorld(here)), false);
    }
    this.pointers.set(event.pointerId, here);
  }

  up(event, regular) {
    const last = this.pointers.get(event.pointerId),
      gesture = this.gesture;
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) return;
    this.gesture = null;
    // a corner stays where the finger was last, also when the browser takes the gesture away
    if (gesture === "corner" && this.moved)
      this.on.drag(this.corner, this.onMap(this.toWorld(regular ? this.at(event) : last)), true);
    if (gesture === "stroke" && !regular) this.on.stroke([], false);
    if (gesture === "pinch" || !regular) return;
    const here = this.at(event);
    const point = this.toWorld(here),
      onMap = this.onMap(point),
      beside = (one) => distance(one, this.onMap(one)) * this.view.scale > HANDLE_PX;
    if (gesture === "stroke" && this.moved) {
      if (this.strokePoints.every(beside)) {
        this.on.stroke([onMap], false);
        this.on.outside();
      } else
        this.on.stroke(
          this.strokePoints.map((one) => this.onMap(one)),
          true,
        );
    } else if (gesture === "between") this.on.between(this.corner, onMap);
    else if (!this.moved && (gesture === "pan" || gesture === "stroke")) {
      if ((this.drawing || this.picking) && beside(point)) this.on.outside();
      else this.on.tap(onMap, this.pick(point));
    }
  }

  // The border at a point: the nearest line within a finger's reach, else the smallest polygon around it.
  pick(point) {
    let best = null,
      reach = HANDLE_PX / this.view.scale;
    for (const border of this.borders) {
      const line = border.kind === "polygon" ? [...border.line, border.line[0]] : border.line;
      for (let i = 1; i < line.length; i++) {
        const d = toSegment(point, line[i - 1], line[i]);
        if (d < reach) [reach, best] = [d, border.id];
      }
    }
    if (best) return best;
    const around = this.borders
      .filter((border) => border.kind === "polygon" && inside(point, border.line))
      .sort((a, b) => a.area - b.area);
    return around.length ? around[0].id : null;
  }

  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] },
      step = arrows[event.key];
    const corner = event.target.dataset && event.target.dataset.corner;
    const reach = event.shiftKey ? 0.25 : 0.05;
    if (corner !== undefined) {
      const at = event.target.at;
      if (step) this.on.drag(Number(corner), this.onMap([at[0] + step[0] * reach, at[1] + step[1] * reach]), true);
      else if (event.key === "Delete" || event.key === "Backspace") this.on.removeCorner(Number(corner));
      else if (event.key === "Enter" || event.key === " ") this.on.choose(Number(corner));
      else return;
    } else if (
      event.target.dataset &&
      event.target.dataset.between !== undefined &&
      (event.key === "Enter" || event.key === " ")
    ) {
      this.on.between(Number(event.target.dataset.between), event.target.at);
    } else if (step && (this.drawing || this.picking)) {
      const at = this.cursor ? this.cursor.at : [this.view.x, this.view.y];
      this.setCursor(this.onMap([at[0] + step[0] * reach, at[1] + step[1] * reach]));
    } else if ((event.key === "Enter" || event.key === " ") && this.cursor) this.on.tap(this.cursor.at, null);
    else if (step) this.pan(-60 * step[0], 60 * step[1]);
    else if (event.key === "+" || event.key === "-") this.zoom(event.key === "+" ? 1.3 : 1 / 1.3);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
