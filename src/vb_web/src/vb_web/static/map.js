// The map: pictures below, and lines above them. Both follow the same view {x, y: centre [m], scale: pixels per metre}.
// Lines are drawn in metres of the map frame and scale with the view. Symbols (robots, names, handles) keep their size.
"use strict";
import { Gestures, HANDLE_PX } from "./gestures.js";
import { MARK_PX, layOutTexts } from "./map_labels.js";
import { distance, meanPoint, toPoints } from "./shapes.js";
import { $ } from "./elements.js";

const SVG = "http://www.w3.org/2000/svg";

function svgElement(name, attributes = {}, parent = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

// The data of an SVG path: a chain of points, or a dot at each of them.
const chainData = (points, closed) =>
  points.length ? "M" + points.map(([x, y]) => `${x} ${y}`).join("L") + (closed ? "Z" : "") : "";
const dotsData = (points) => points.map(([x, y]) => `M${x} ${y}h.001`).join("");
const shortened = (text) => (text.length > 26 ? `${text.slice(0, 25)}…` : text);

export class MapView {
  // `on` has the functions that gestures call: tap(point, id of the border there), stroke(points, ended),
  // drag(index, point, ended), between(index, point), choose(index), removeCorner(index), outside()
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
    this.symbolGroup = $("placed");
    this.handleGroup = $("handles");
    this.layers = {};
    for (const name of ["borders", "progress", "draft", "goals"]) this.layers[name] = { lines: [], symbols: [] };
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

  // These two convert between the map frame and metres to the right of and above the map's lower left corner.
  fromCorner([right, up]) {
    const { x, y, cos, sin } = this.info;
    return [x + cos * right - sin * up, y + sin * right + cos * up];
  }
  toCorner([x, y]) {
    const { x: x0, y: y0, cos, sin } = this.info;
    return [cos * (x - x0) + sin * (y - y0), cos * (y - y0) - sin * (x - x0)];
  }

  fit() {
    const [w, h] = this.size();
    if (!this.info || w < 24 || h < 24) return; // the page is not laid out yet; then the observer calls this again
    const { width, height } = this.info;
    const corners = [
      [0, 0],
      [width, 0],
      [width, height],
      [0, height],
    ].map((corner) => this.fromCorner(corner));
    const xs = corners.map(([x]) => x);
    const ys = corners.map(([, y]) => y);
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

  // Moves the view by pixels, but not so far that the map leaves its frame.
  pan(right, down) {
    this.view.x -= right / this.view.scale;
    this.view.y += down / this.view.scale;
    this.keepInFrame();
  }

  keepInFrame() {
    const [x0, x1, y0, y1] = this.box;
    const [w, h] = this.size();
    for (const [axis, low, high, frame] of [
      ["x", x0, x1, w],
      ["y", y0, y1, h],
    ]) {
      const slack = Math.max(0, (high - low) / 2 + (HANDLE_PX - frame / 2) / this.view.scale);
      const centre = (low + high) / 2;
      this.view[axis] = Math.max(centre - slack, Math.min(centre + slack, this.view[axis]));
    }
    this.touched = true;
    this.update();
  }

  // Returns the point of the map that is nearest to a point, so that every corner of a drawing is on the map.
  onMap(point) {
    const { width, height } = this.info;
    const [right, up] = this.toCorner(point);
    return this.fromCorner([Math.max(0, Math.min(width, right)), Math.max(0, Math.min(height, up))]);
  }

  // Zooms about a point of the screen, which stays in place. By default, this is the screen's centre.
  zoom(factor, position = null) {
    if (!this.info) return;
    const [w, h] = this.size();
    const [u, v] = position || [w / 2, h / 2];
    const [x, y] = this.toWorld([u, v]);
    const [minScale, maxScale] = this.limits;
    this.view.scale = Math.max(minScale, Math.min(maxScale, this.view.scale * factor));
    const [movedX, movedY] = this.toWorld([u, v]);
    this.view.x += x - movedX;
    this.view.y += y - movedY;
    this.keepInFrame();
  }

  // Lays out the map once before the next frame, even if it was changed several times until then.
  update() {
    if (this.frameRequest) return;
    this.frameRequest = requestAnimationFrame(() => {
      this.frameRequest = 0;
      this.layOut();
    });
  }

  layOut() {
    if (!this.info) return;
    const { x, y, scale } = this.view;
    const [w, h] = this.size();
    this.world.setAttribute("transform", `matrix(${scale} 0 0 ${-scale} ${w / 2 - x * scale} ${h / 2 + y * scale})`);
    const { resolution, cells_per_pixel: cells, rows, columns, cos, sin } = this.info;
    const [left, bottom] = this.toScreen(this.fromCorner([0, 0]));
    for (const image of $("pictures").children) {
      if (!image.naturalWidth) continue;
      // every picture begins at the map's lower left corner, but the pictures differ in the number of cells per pixel
      const regionCells = Math.max(1, Math.ceil(Math.max(rows, columns) / 700));
      const cellsPerPixel = { floor: this.info.floor, region: regionCells }[image.id] || cells;
      const magnification = cellsPerPixel * resolution * scale;
      const [c, s] = [cos * magnification, sin * magnification];
      const height = image.naturalHeight;
      image.style.transform = `matrix(${c},${-s},${s},${c},${left - s * height},${bottom - c * height})`;
    }
    for (const element of [...this.symbolGroup.children, ...this.handleGroup.children]) {
      if (!element.position) continue;
      const [u, v] = this.toScreen(element.position);
      element.setAttribute(
        "transform",
        `translate(${u.toFixed(1)} ${v.toFixed(1)})` +
          (element.yaw === undefined ? "" : ` rotate(${((-element.yaw * 180) / Math.PI).toFixed(1)})`) +
          (element.metres ? ` scale(${Math.max(12, element.metres * scale).toFixed(2)})` : ""),
      );
    }
    layOutTexts(this);
  }

  // ------------------------------------------------------------- what is shown
  setMap(info) {
    const hasOtherGeometry = ["rows", "columns", "resolution", "origin"].some(
      (key) => String(this.info?.[key]) !== String(info[key]),
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
    this.showPicture("base", `picture/map/${info.picture}.png`);
    this.showPicture("restricted", info.restricted ? `picture/restricted/${info.restricted}.png` : "");
    if (hasOtherGeometry) this.fit();
    else this.update();
  }

  // Shows a picture below the lines, or none if its address is "".
  showPicture(id, url) {
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

  // Fetches a picture. Tries again as long as it is to be shown, because cameras may start later than the page.
  fetchPicture(image, url, pause) {
    const next = new Image(); // replaces the previous picture only when it is complete
    next.onload = () => {
      if (image.dataset.url === url) {
        image.src = url;
        image
          .decode()
          .catch(() => 0)
          .then(() => {
            image.classList.add("there");
            this.layOut();
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
    for (const element of [...this.layers[layer].lines, ...this.layers[layer].symbols]) element.remove();
    this.layers[layer] = { lines: [], symbols: [] };
  }
  addLine(layer, kind, data) {
    this.layers[layer].lines.push(svgElement("path", { class: kind, d: data }, this.world));
  }
  // Adds a symbol at a position [m]. Its parts are [element's name, attributes, text].
  addSymbol(layer, kind, position, parts) {
    const group = svgElement("g", { class: kind }, this.symbolGroup);
    group.position = position;
    for (const [name, attributes, text] of parts) svgElement(name, attributes, group).textContent = text || "";
    if (layer) this.layers[layer].symbols.push(group);
    this.update();
    return group;
  }

  // Adds lines of text, one below the other. layOutTexts finds a position for them.
  addText(layer, kind, texts) {
    const lines = texts.filter(Boolean);
    const group = svgElement("g", { class: kind }, this.symbolGroup);
    lines.forEach((text, i) => {
      const y = `${(0.35 + 1.3 * (i - (lines.length - 1) / 2)).toFixed(2)}em`;
      svgElement("text", { class: i ? "note" : "", y }, group).textContent = text;
    });
    const half = Math.max(...[...group.children].map((text) => text.getComputedTextLength())) / 2 + 4;
    group.extent = { half, high: 3 + 9 * lines.length };
    this.layers[layer].symbols.push(group);
    this.update();
    return group;
  }

  // Adds a text with the length of a draft's side, which stands outside of the draft.
  addLength(side, centre) {
    const text = `${this.words.number(distance(...side), 2)} m`;
    this.addText("draft", "length", [text]).side = [...side, centre];
  }

  // Draws the borders, except the one that is being edited. The `note` of a border stands below its name.
  setBorders(borders, editedId) {
    this.borders = borders.map((border) => ({ ...border, line: toPoints(border.points) }));
    this.clear("borders");
    for (const border of this.borders) {
      if (border.id === editedId) continue;
      // the floor that the border restricted before, and that it will restrict, until a person has confirmed the change
      for (const time of ["before", "after"]) {
        if (border[time]?.length) this.addLine("borders", `border ${time}`, chainData(toPoints(border[time]), true));
      }
      const line = chainData(border.line, border.kind === "polygon");
      this.addLine("borders", `border ${border.kind} ${border.idle || ""}`, line);
      const group = this.addText("borders", "name", [
        shortened(this.words.border(border.name) || this.words.say("page_no_name")),
        shortened(border.note),
      ]);
      group.border = border;
      const mark = svgElement("g", { class: `mark ${border.idle || ""}` }, group);
      svgElement("circle", { r: MARK_PX }, mark);
      svgElement("text", { y: "0.35em" }, mark).textContent = border.mark;
    }
    this.update();
  }

  setProgress(progress) {
    this.clear("progress");
    if (!progress) return;
    this.addLine("progress", "left-out", dotsData(toPoints(progress.left_out)));
    this.addLine("progress", "points", dotsData(toPoints(progress.points)));
    this.addLine("progress", "chain", chainData(toPoints(progress.chain), progress.closed));
    if (progress.seed.length) this.addSeed("progress", toPoints(progress.seed)[0]);
    this.update();
  }

  addSeed(layer, position) {
    this.addSymbol(layer, "seed", position, [["path", { d: "M-9 0A9 9 0 1 0 9 0A9 9 0 1 0-9 0M-4.5 0H4.5" }]]);
  }

  setRobots(robots) {
    this.robots = this.robots || {};
    for (const name of Object.keys(this.robots).filter((robot) => !(robot in robots))) {
      this.robots[name].remove();
      delete this.robots[name];
    }
    for (const [name, pose] of Object.entries(robots)) {
      let group = this.robots[name];
      if (!group) {
        group = this.robots[name] = this.addSymbol(
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
      group.position = [pose[0], pose[1]];
      group.yaw = pose[2];
    }
    this.update();
  }

  // Draws where robots are going. `goals` has the goal and the planned path of each robot, by its name.
  setGoals(goals) {
    this.clear("goals");
    for (const { goal, path } of Object.values(goals)) {
      this.addLine("goals", "path", chainData(toPoints(path), false));
      this.addSymbol("goals", "goal", toPoints(goal)[0], [
        ["path", { d: "M0 0C-9-11-9-22 0-22S9-11 0 0ZM-3-14A3 3 0 1 0 3-14A3 3 0 1 0-3-14" }],
      ]);
    }
    this.update();
  }

  setSpots(spots) {
    this.spots = this.spots || {};
    for (const [camera, [x, y, , stamp]] of Object.entries(spots)) {
      const shown = this.spots[camera];
      if (shown && shown.stamp === stamp) continue;
      const group = shown || this.addSymbol(null, "spot", [0, 0], [["circle", { r: 6 }]]);
      this.spots[camera] = group;
      group.stamp = stamp;
      group.position = [x / 100, y / 100];
      // a spot that arrived before this page was opened, or before the link was lost, may no longer be there
      group.style.opacity = !shown && !this.live ? 0 : 1;
      clearTimeout(group.timer);
      group.timer = setTimeout(() => {
        group.style.opacity = 0;
      }, 500);
    }
    this.live = true;
    this.layOut();
  }

  // Draws a draft's line, corners and seed. Buttons and arrow keys act on the corner `chosen`. `rough` is set while the
  // draft is not complete: "line" while a finger draws it, "taps" while its corners are tapped.
  setDraft(draft, chosen, rough) {
    this.clear("draft");
    const focused = document.activeElement && document.activeElement.dataset && document.activeElement.dataset.corner;
    this.handleGroup.replaceChildren();
    if (!draft) return this.update();
    const closed = draft.kind === "polygon";
    const points = draft.points;
    this.addLine("draft", "draft", chainData(points, closed && !rough));
    if (rough) {
      for (const point of points.slice(0, rough === "taps" ? 99 : 0))
        this.addSymbol("draft", "knob", point, [["circle", { r: 7 }]]);
      if (rough === "taps" && points.length > 1) this.addLength(points.slice(-2), meanPoint(points));
      return this.update();
    }
    const count = points.length;
    const sides = points.map((point, i) => [point, points[(i + 1) % count]]).slice(0, closed ? count : count - 1);
    sides.forEach((side, i) => {
      if (count === 2 || (chosen !== null && (i === chosen || (i + 1) % count === chosen)))
        this.addLength(side, meanPoint(points));
      if (count <= 24 && distance(...side) * this.view.scale > 60)
        this.addHandle("between", meanPoint(side), 5, {
          between: i,
          label: this.words.say("page_between", { number: i + 1 }),
        });
    });
    points.forEach(([x, y], i) =>
      this.addHandle(i === chosen ? "chosen" : "", [x, y], 8, {
        corner: i,
        label: this.words.say("page_corner", {
          number: i + 1,
          x: this.words.number(x, 2),
          y: this.words.number(y, 2),
        }),
      }),
    );
    if (draft.kind !== "wall" && draft.seed) this.addSeed("draft", draft.seed);
    this.layOut();
    if (focused !== undefined) {
      const handle = this.handleGroup.querySelector(`[data-corner="${focused}"]`);
      if (handle) handle.focus({ preventScroll: true });
    }
  }

  // Adds the handle of a corner, or a handle between two corners, from which a new corner can be pulled out.
  addHandle(kind, position, radius, { corner, between, label }) {
    const group = svgElement("g", { class: kind, tabindex: 0, role: "button", "aria-label": label }, this.handleGroup);
    if (corner !== undefined) group.dataset.corner = corner;
    else group.dataset.between = between;
    group.position = position;
    svgElement("circle", { class: "hit", r: corner === undefined ? 16 : HANDLE_PX }, group);
    svgElement("circle", { class: "knob", r: radius }, group);
  }

  // Shows the crosshair that arrow keys move at a position, or removes it if that is null.
  setCursor(position) {
    if (this.cursor) this.cursor.remove();
    this.cursor = position && this.addSymbol(null, "crosshair", position, [["path", { d: "M-16 0H16M0-16V16" }]]);
    if (this.cursor) this.layOut();
  }
}
