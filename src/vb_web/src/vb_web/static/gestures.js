// Turns the gestures of fingers, mouse and keys on the map into movements of the map, and into calls of `map.on`.
"use strict";
import { distance, distanceToSegment, inside, meanPoint } from "./shapes.js";

export const HANDLE_PX = 24; // half of the width of a finger

export class Gestures {
  constructor(map) {
    this.map = map;
    this.pointers = new Map();
    this.listen();
  }

  // Drops a stroke: the phone was turned, and the finger is now at another point of the map.
  drop() {
    if (this.gesture !== "stroke") return;
    this.gesture = null;
    this.map.on.stroke([], false);
  }

  // Returns an event's position on the map's element [px].
  positionOf(event) {
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
        this.map.zoom(Math.exp(-event.deltaY * 0.0015), this.positionOf(event));
      },
      { passive: false },
    );
    // while nothing is drawn, one finger scrolls the page, and two fingers move the map
    element.addEventListener(
      "touchmove",
      (event) => {
        if (event.touches.length > 1) event.preventDefault();
      },
      { passive: false },
    );
    // no click may follow a tap, because it would press a button that the tap has brought up under the finger
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
    const position = this.positionOf(event);
    try {
      this.map.element.setPointerCapture(event.pointerId);
    } catch (_) {
      /* the pointer is already gone */
    }
    this.pointers.set(event.pointerId, position);
    if (this.pointers.size > 1) {
      this.gesture = "pinch";
      this.map.on.stroke([], false);
      return;
    }
    const handle = event.target.closest && event.target.closest("#handles g");
    this.start = position;
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
      this.strokePoints = [this.map.toWorld(position)];
    } else this.gesture = "pan";
  }

  move(event) {
    const previous = this.pointers.get(event.pointerId);
    if (!previous) return;
    const position = this.positionOf(event);
    if (this.gesture === "pinch") this.pinch(event.pointerId, previous, position);
    else if (this.moved || distance(position, this.start) >= 6) {
      this.moved = true;
      this.drag(event, previous, position);
    } else return;
    this.pointers.set(event.pointerId, position);
  }

  // Moves and zooms the map after one of two fingers has moved.
  pinch(finger, previous, position) {
    const [, other] = [...this.pointers.entries()].find(([id]) => id !== finger) || [];
    if (!other) return;
    const previousSpan = distance(previous, other);
    const span = distance(position, other);
    this.map.pan((position[0] - previous[0]) / 2, (position[1] - previous[1]) / 2);
    this.map.zoom(previousSpan > 10 ? span / previousSpan : 1, meanPoint([position, other]));
  }

  // Continues the gesture that one finger or the mouse has begun. One finger scrolls the page, and does not move the
  // map.
  drag(event, previous, position) {
    if (this.gesture === "pan" && event.pointerType !== "touch")
      this.map.pan(position[0] - previous[0], position[1] - previous[1]);
    else if (this.gesture === "stroke") {
      const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [];
      for (const part of events.length ? events : [event])
        this.strokePoints.push(this.map.toWorld(this.positionOf(part)));
      this.map.on.stroke(this.strokeOnMap(), false);
    } else if (this.gesture === "between") {
      this.gesture = "corner";
      this.corner = this.map.on.between(this.corner, this.placeAt(position));
    } else if (this.gesture === "corner") this.map.on.drag(this.corner, this.placeAt(position), false);
  }

  // Returns the point of the map [m] at a position [px].
  placeAt(position) {
    return this.map.onMap(this.map.toWorld(position));
  }

  strokeOnMap() {
    return this.strokePoints.map((point) => this.map.onMap(point));
  }

  up(event, regular) {
    const last = this.pointers.get(event.pointerId);
    const gesture = this.gesture;
    if (!this.pointers.delete(event.pointerId) || this.pointers.size) return;
    this.gesture = null;
    // a corner stays where the finger was last, even if the browser has cancelled the gesture
    if (gesture === "corner" && this.moved) {
      const position = regular ? this.positionOf(event) : last;
      this.map.on.drag(this.corner, this.placeAt(position), true);
    }
    if (gesture === "stroke" && !regular) this.map.on.stroke([], false);
    if (gesture === "pinch" || !regular) return;
    const point = this.map.toWorld(this.positionOf(event));
    const onMap = this.map.onMap(point);
    const isOffMap = (place) => distance(place, this.map.onMap(place)) * this.map.view.scale > HANDLE_PX;
    if (gesture === "stroke" && this.moved) {
      if (this.strokePoints.every(isOffMap)) {
        this.map.on.stroke([onMap], false);
        this.map.on.outside();
      } else this.map.on.stroke(this.strokeOnMap(), true);
    } else if (gesture === "between") this.map.on.between(this.corner, onMap);
    else if (!this.moved && (gesture === "pan" || gesture === "stroke")) {
      if ((this.map.drawing || this.map.picking) && isOffMap(point)) this.map.on.outside();
      else this.map.on.tap(onMap, this.pick(point));
    }
  }

  // Returns the id of the border at a point: the one with the nearest line within a finger's reach, or else the
  // smallest polygon that contains the point. Returns null if there is none.
  pick(point) {
    let nearest = null;
    let reach = HANDLE_PX / this.map.view.scale;
    for (const border of this.map.borders) {
      const line = border.kind === "polygon" ? [...border.line, border.line[0]] : border.line;
      for (let i = 1; i < line.length; i++) {
        const d = distanceToSegment(point, line[i - 1], line[i]);
        if (d < reach) [reach, nearest] = [d, border.id];
      }
    }
    if (nearest) return nearest;
    const polygonsAround = this.map.borders
      .filter((border) => border.kind === "polygon" && inside(point, border.line))
      .sort((a, b) => a.area - b.area);
    return polygonsAround.length ? polygonsAround[0].id : null;
  }

  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const direction = arrows[event.key];
    const { corner, between } = event.target.dataset;
    const isPress = event.key === "Enter" || event.key === " ";
    const step = event.shiftKey ? 0.25 : 0.05; // [m]
    const next = ([x, y]) => this.map.onMap([x + direction[0] * step, y + direction[1] * step]);
    if (corner !== undefined) {
      if (direction) this.map.on.drag(Number(corner), next(event.target.position), true);
      else if (event.key === "Delete" || event.key === "Backspace") this.map.on.removeCorner(Number(corner));
      else if (isPress) this.map.on.choose(Number(corner));
      else return;
    } else if (between !== undefined && isPress) this.map.on.between(Number(between), event.target.position);
    else if (direction && (this.map.drawing || this.map.picking))
      this.map.setCursor(next(this.map.cursor ? this.map.cursor.position : [this.map.view.x, this.map.view.y]));
    else if (isPress && this.map.cursor) this.map.on.tap(this.map.cursor.position, null);
    else if (direction) this.map.pan(-60 * direction[0], 60 * direction[1]);
    else if (event.key === "+" || event.key === "-") this.map.zoom(event.key === "+" ? 1.3 : 1 / 1.3);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
