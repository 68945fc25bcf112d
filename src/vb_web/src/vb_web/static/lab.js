// The rest of the panel: notices, cameras, robots and events; and the picture of the floor.
"use strict";
import { drawHint, map } from "./editor.js";
import { commandName, operator, robotName, say, sourceName, standing, view, words } from "./state.js";
import { $, ask, button, dropStanding, element, fill, toast } from "./ui.js";

export let floorOn = false;
let floorSeers = "";
export const watched = new Map(); // camera: its picture, while somebody looks at it

// Where robots are going, each with its own stop beside it.
export function drawDrives() {
  const drives = view.drives || {};
  map.setDrives(drives);
  fill(
    $("drives"),
    Object.entries(drives).map(([name, { goal }]) =>
      element(
        "li",
        {},
        element(
          "span",
          {},
          say("page_drive", {
            who: robotName(name),
            x: words.number(goal[0] / 100, 1),
            y: words.number(goal[1] / 100, 1),
          }),
        ),
        operator()
          ? button("page_end_drive", () => ask("halt", { robot: name }), "danger", { "data-key": `halt ${name}` })
          : null,
      ),
    ),
  );
}

export function drawNotices() {
  drawHint();
  fill(
    $("notices"),
    standing().map((notice) =>
      element("li", { class: ["info", "warning", "error"][notice.severity] || "error" }, words.tell(notice)),
    ),
  );
  dropStanding();
}

export function drawHealth() {
  const cameras = view.cameras || [],
    drivers = view.drivers || {};
  // each camera and robot with a problem once, no matter who tells it; a notice about the only robot has its name in a value
  const about = (one) =>
    one.camera ? `camera ${one.camera}` : one.robot || one.values.who ? `robot ${one.robot || one.values.who}` : "";
  const told = [...(view.offer ? view.offer.lines : []), ...(view.notices || [])].filter((one) => one.severity);
  const bad = new Set([
    ...cameras.filter((one) => !one.there).map((one) => `camera ${one.name}`),
    ...Object.keys(drivers)
      .filter((name) => !drivers[name].there)
      .map((name) => `robot ${robotName(name)}`),
    ...told.map(about).filter(Boolean),
  ]).size;
  $("health-sum").textContent = bad
    ? say(bad === 1 ? "page_problem" : "page_problems", { count: bad })
    : cameras.length || Object.keys(drivers).length || (view.offer && view.offer.state === "ready")
      ? say("page_all_well")
      : "";
  $("health-sum").className = bad ? "ill" : "good";
  const see = (one) => say(watched.has(one.name) ? "page_close" : "page_view");
  fill(
    $("cameras"),
    cameras.map((one) =>
      element(
        "li",
        {},
        element(
          "span",
          {},
          say("page_camera", { camera: one.name }),
          element(
            "small",
            { class: "muted" },
            one.there
              ? say("page_camera_rate", { hz: words.number(one.hz, 0), ms: words.number(one.ms, 0) })
              : say("page_camera_gone"),
          ),
        ),
        operator()
          ? element(
              "button",
              {
                "data-key": `see ${one.name}`,
                "aria-expanded": String(watched.has(one.name)),
                "aria-label": `${see(one)}: ${say("page_camera", { camera: one.name })}`,
                onclick: () => watch(one.name),
              },
              see(one),
            )
          : null,
      ),
    ),
  );
  // the same element again: a picture that is replaced flickers
  [...$("cameras").children].forEach((line, i) => {
    const image = watched.get(cameras[i].name);
    if (image && image.parentNode !== line) line.append(image);
  });
  fill(
    $("drivers"),
    [...new Set([...((view.offer && view.offer.robots) || []), ...Object.keys(drivers)])].sort().map((name) => {
      const one = drivers[name],
        source = one && one.there ? `page_motion_source_${one.source}` : "",
        lines = view.offer ? view.offer.lines.filter((line) => line.robot === name) : [];
      return element(
        "li",
        {},
        element(
          "span",
          {},
          one && (source ? words.tell(one) : say("page_driver_gone", { who: robotName(name) })),
          words.has(source) ? element("small", { class: "muted" }, say(source)) : null,
          ...lines.map((line) => element("small", { class: line.severity ? "ill" : "muted" }, words.tell(line))),
        ),
      );
    }),
  );
}

// Opens a camera's picture below its line, or closes it.
export function watch(camera) {
  const image = watched.get(camera) || element("img", { alt: say("page_camera_image", { camera }) });
  if (watched.delete(camera)) image.remove();
  else {
    watched.set(camera, image);
    const next = () => {
      if (document.hidden) setTimeout(next, 400);
      else if (watched.get(camera) === image) image.src = `camera/${encodeURIComponent(camera)}.jpg?${Date.now()}`;
    };
    image.onload = () => setTimeout(next, 400);
    image.onerror = () => {
      if (watched.get(camera) === image) {
        watch(camera);
        toast(say("page_no_image"), true);
      }
    };
    next();
  }
  drawHealth();
}

export function drawEvents() {
  const time = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" },
    today = new Date().toDateString();
  const [clockTime, dated] = [time, { ...time, day: "numeric", month: "short" }].map(
    (parts) => new Intl.DateTimeFormat(words.language, parts),
  );
  $("events").replaceChildren(
    ...(view.events || [])
      .slice()
      .reverse()
      .map((event) => {
        const values = { ...event.values };
        if (values.command) values.command = commandName(values.command);
        if (values.code) values.reason = say(values.code, values);
        const at = new Date(event.at * 1000);
        return element(
          "li",
          {},
          element("time", { datetime: at.toISOString() }, (at.toDateString() === today ? clockTime : dated).format(at)),
          element(
            "span",
            {},
            say(event.code, values),
            event.source ? element("small", { class: "muted" }, sourceName(event.source)) : null,
          ),
        );
      }),
  );
}

// A camera that comes or goes changes what there is to see of the floor.
export function refreshFloor() {
  const seeing = view.cameras
    .filter((one) => one.there && one.hz)
    .map((one) => one.name)
    .join();
  if (floorOn && seeing !== floorSeers) setFloor(true);
  floorSeers = seeing;
}

export function setFloor(on) {
  floorOn = on;
  $("floor-button").setAttribute("aria-pressed", String(on));
  map.picture("floor", on ? `floor.webp?${Date.now()}` : "");
}
