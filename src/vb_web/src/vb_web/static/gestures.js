// What fingers, mouse and keys do on the map: they move it, draw, move corners and choose borders.
"use strict";
import { distance, inside, toSegment } from "./shapes.js";

export const HANDLE_PX = 24; // half of a finger

export class Gestures {
  constructor(map) {
    this.map = map;
    this.pointers = new Map();
    this.listen();
  }

  // Forgets a stroke: a phone was turned, and the finger is elsewhere now.
  drop() {
    if (this.gesture !== "stroke") return;
    this.gesture = null;
    this.map.on.stroke([], false);
  }

  at(event) {
    const box = this.map.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  listen() {
    const element = this.map.element;
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"])
      element.addEventListener(name, (event) => this.up(event, name === "pointerup"));
    element.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.map.zoom(Math.exp(-event.deltaY * 0.0015), this.at(event));
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
    element.addEventListener("blur", () => this.map.setCursor(null));
  }

  down(event) {
    if (event.button > 0 || !this.map.info) return;
    const here = this.at(event);
    try {
      this.map.element.setPointerCapture(event.pointerId);
    } catch (_) {
      /* a pointer that is gone already */
    }
    this.pointers.set(event.pointerId, here);
    if (this.pointers.size > 1) {
      this.gesture = "pinch";
      this.map.on.stroke([], false);
      return;
    }
    const handle = event.target.closest && event.target.closest("#handles g");
    this.start = here;
    this.moved = false;
    if (handle && handle.dataset.corner !== undefined) {
      this.gesture = "corner";
      this.corner = Number(handle.dataset.corner);
      this.map.on.choose(this.corner);
    } else if (handle) {
      this.gesture = "between";
      this.corner = Number(handle.dataset.between);
    } else if (this.map.drawing) {
      this.gesture = "stroke";
      this.strokePoints = [this.map.toWorld(here)];
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
        this.map.pan((here[0] - before[0]) / 2, (here[1] - before[1]) / 2);
        this.map.zoom(a > 10 ? b / a : 1, [(here[0] + other[1][0]) / 2, (here[1] + other[1][1]) / 2]);
      }
    } else if (!this.moved && distance(here, this.start) < 6) return;
    else {
      this.moved = true;
      if (this.gesture === "pan") {
        if (event.pointerType !== "touch") this.map.pan(here[0] - before[0], here[1] - before[1]);
      } else if (this.gesture === "stroke") {
        const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [event];
        for (const one of events.length ? events : [event]) this.strokePoints.push(this.map.toWorld(this.at(one)));
        this.map.on.stroke(
          this.strokePoints.map((point) => this.map.onMap(point)),
          false,
        );
      } else if (this.gesture === "between") {
        this.gesture = "corner";
        this.corner = this.map.on.between(this.corner, this.map.onMap(this.map.toWorld(here)));
      } else if (this.gesture === "corner")
        this.map.on.drag(this.corner, this.map.onMap(this.map.toWorld(here)), false);
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
      this.map.on.drag(this.corner, this.map.onMap(this.map.toWorld(regular ? this.at(event) : last)), true);
    if (gesture === "stroke" && !regular) this.map.on.stroke([], false);
    if (gesture === "pinch" || !regular) return;
    const here = this.at(event);
    const point = this.map.toWorld(here),
      onMap = this.map.onMap(point),
      beside = (one) => distance(one, this.map.onMap(one)) * this.map.view.scale > HANDLE_PX;
    if (gesture === "stroke" && this.moved) {
      if (this.strokePoints.every(beside)) {
        this.map.on.stroke([onMap], false);
        this.map.on.outside();
      } else
        this.map.on.stroke(
          this.strokePoints.map((one) => this.map.onMap(one)),
          true,
        );
    } else if (gesture === "between") this.map.on.between(this.corner, onMap);
    else if (!this.moved && (gesture === "pan" || gesture === "stroke")) {
      if ((this.map.drawing || this.map.picking) && beside(point)) this.map.on.outside();
      else this.map.on.tap(onMap, this.pick(point));
    }
  }

  // The border at a point: the nearest line within a finger's reach, else the smallest polygon around it.
  pick(point) {
    let best = null,
      reach = HANDLE_PX / this.map.view.scale;
    for (const border of this.map.borders) {
      const line = border.kind === "polygon" ? [...border.line, border.line[0]] : border.line;
      for (let i = 1; i < line.length; i++) {
        const d = toSegment(point, line[i - 1], line[i]);
        if (d < reach) [reach, best] = [d, border.id];
      }
    }
    if (best) return best;
    const around = this.map.borders
      .filter((border) => border.kind === "polygon" && inside(point, border.line))
      .sort((a, b) => a.area - b.area);
    return around.length ? around[0].id : null;
  }

  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] },
      step = arrows[event.key];
    const { corner, between } = event.target.dataset;
    const press = event.key === "Enter" || event.key === " ";
    const reach = event.shiftKey ? 0.25 : 0.05;
    const next = (at) => this.map.onMap([at[0] + step[0] * reach, at[1] + step[1] * reach]);
    if (corner !== undefined) {
      if (step) this.map.on.drag(Number(corner), next(event.target.at), true);
      else if (event.key === "Delete" || event.key === "Backspace") this.map.on.removeCorner(Number(corner));
      else if (press) this.map.on.choose(Number(corner));
      else return;
    } else if (between !== undefined && press) this.map.on.between(Number(between), event.target.at);
    else if (step && (this.map.drawing || this.map.picking))
      this.map.setCursor(next(this.map.cursor ? this.map.cursor.at : [this.map.view.x, this.map.view.y]));
    else if (press && this.map.cursor) this.map.on.tap(this.map.cursor.at, null);
    else if (step) this.map.pan(-60 * step[0], 60 * step[1]);
    else if (event.key === "+" || event.key === "-") this.map.zoom(event.key === "+" ? 1.3 : 1 / 1.3);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
