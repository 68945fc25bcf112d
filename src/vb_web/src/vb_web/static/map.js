// The map: pictures below, lines above, both moved by one view {x, y: metres in the middle, scale: pixels per metre}.
// What is drawn in the world's metres (lines) scales with it; what is placed (robots, names, handles) keeps its size.
"use strict";
import { Gestures, HANDLE_PX } from "./gestures.js";
import { MARK_PX, layWriting } from "./map_writing.js";
import { distance, mean, pairs } from "./shapes.js";
import { $ } from "./ui.js";

const SVG = "http://www.w3.org/2000/svg";

function make(name, attributes = {}, parent = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

const path = (points, closed) =>
  points.length ? "M" + points.map((p) => `${p[0]} ${p[1]}`).join("L") + (closed ? "Z" : "") : "";
const short = (text) => (text.length > 26 ? `${text.slice(0, 25)}…` : text);
const dots = (points) => points.map((p) => `M${p[0]} ${p[1]}h.001`).join("");

export class MapView {
  // `on` has tap(point, picked), stroke(points), drag(index, point, ended), between(index, point), choose(index),
  // removeCorner(index), outside()
  constructor(words, on) {
    Object.assign(this, {
      words,
      on,
      view: { x: 0, y: 0, scale: 50 },
      info: null,
      borders: [],
      drawing: false,
      cursor: null,
    });
    this.element = $("map");
    this.world = $("world");
    this.placedGroup = $("placed");
    this.handleGroup = $("handles");
    this.layers = {};
    for (const name of ["borders", "progress", "draft", "drives"]) this.layers[name] = { lines: [], placed: [] };
    this.gestures = new Gestures(this);
    new ResizeObserver(() => {
      this.gestures.drop();
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
    layWriting(this);
  }

  // ------------------------------------------------------------- what is shown
  setMap(info) {
    const other = ["rows", "columns", "resolution", "origin"].some(
      (one) => String(this.info?.[one]) !== String(info[one]),
    );
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
    for (const name of Object.keys(this.robots).filter((one) => !(one in robots))) {
      this.robots[name].remove();
      delete this.robots[name];
    }
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
      this.place("drives", "goal", pairs(goal)[0], [
        ["path", { d: "M0 0C-9-11-9-22 0-22S9-11 0 0ZM-3-14A3 3 0 1 0 3-14A3 3 0 1 0-3-14" }],
      ]);
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
}
