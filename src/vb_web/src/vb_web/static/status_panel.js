// The lower part of the panel: goals, notices, cameras, robots and events. It also fetches the picture of the floor.
"use strict";
import { drawHint, map } from "./editor.js";
import { commandName, isOperator, robotValues, sentence, shownNotices, sourceName, view, words } from "./state.js";
import { $, ask, button, dropRepeatedToast, element, replaceContent, toast } from "./elements.js";

export let floorOn = false;
let floorCameras = ""; // names of the cameras in the floor's picture
export const watchedCameras = new Map(); // the open pictures, by camera

// Lists where robots are going, each with a button that ends its drive.
export function drawGoals() {
  const goals = view.goals || {};
  map.setGoals(goals);
  replaceContent(
    $("goals"),
    Object.entries(goals).map(([name, { goal }]) =>
      element(
        "li",
        {},
        element(
          "span",
          {},
          sentence("page_drive", {
            ...robotValues(name),
            x: words.number(goal[0] / 100, 1),
            y: words.number(goal[1] / 100, 1),
          }),
        ),
        isOperator()
          ? button("page_end_drive", () => ask("halt", { robot: name }), "danger", { "data-key": `halt ${name}` })
          : null,
      ),
    ),
  );
}

export function drawNotices() {
  drawHint();
  replaceContent(
    $("notices"),
    shownNotices().map((notice) =>
      element("li", { class: ["info", "warning", "error"][notice.severity] || "error" }, words.tell(notice)),
    ),
  );
  dropRepeatedToast();
}

// Returns the camera or robot that a notice is about, or "". If there is only one robot, only a value has its name.
function subjectOf({ camera, robot, values }) {
  if (camera) return `camera ${camera}`;
  const robotOfNotice = robot || values.who || values.who_code;
  return robotOfNotice ? `robot ${robotOfNotice}` : "";
}

// Counts the cameras and robots that have a problem. Each counts once, no matter how many nodes report the problem.
function countProblems(cameras, drivers) {
  const robotNotices = view.capabilities ? view.capabilities.lines : [];
  const warnings = [...robotNotices, ...(view.notices || [])].filter(({ severity }) => severity);
  return new Set([
    ...cameras.filter((camera) => !camera.present).map((camera) => `camera ${camera.name}`),
    ...Object.keys(drivers)
      .filter((name) => !drivers[name].present)
      .map((name) => subjectOf({ values: robotValues(name) })),
    ...warnings.map(subjectOf).filter(Boolean),
  ]).size;
}

// Says how many problems there are. If there are none, says so only if something is connected.
function healthSum(problems, cameras, drivers) {
  if (problems) return sentence(problems === 1 ? "page_problem" : "page_problems", { count: problems });
  const isConnected = cameras.length || Object.keys(drivers).length || view.capabilities?.state === "ready";
  return isConnected ? sentence("page_all_well") : "";
}

export function drawHealth() {
  const cameras = view.cameras || [];
  const drivers = view.drivers || {};
  const problems = countProblems(cameras, drivers);
  $("health-sum").textContent = healthSum(problems, cameras, drivers);
  $("health-sum").className = problems ? "ill" : "good";
  replaceContent($("cameras"), cameras.map(cameraLine));
  // uses the same image elements again, because a picture flickers when its element is replaced
  [...$("cameras").children].forEach((line, i) => {
    const image = watchedCameras.get(cameras[i].name);
    if (image && image.parentNode !== line) line.append(image);
  });
  const connectedRobots = (view.capabilities && view.capabilities.robots) || [];
  const robots = new Set([...connectedRobots, ...Object.keys(drivers)]);
  replaceContent(
    $("drivers"),
    [...robots].sort().map((name) => robotLine(name, drivers[name])),
  );
}

function cameraLine({ name, present, hz, ms }) {
  const label = sentence(watchedCameras.has(name) ? "page_close" : "page_view");
  const rate = present
    ? sentence("page_camera_rate", { hz: words.number(hz, 0), ms: words.number(ms, 0) })
    : sentence("page_camera_gone");
  const watchButton = element(
    "button",
    {
      "data-key": `see ${name}`,
      "aria-expanded": String(watchedCameras.has(name)),
      "aria-label": `${label}: ${sentence("page_camera", { camera: name })}`,
      onclick: () => toggleWatching(name),
    },
    label,
  );
  return element(
    "li",
    {},
    element("span", {}, sentence("page_camera", { camera: name }), element("small", { class: "muted" }, rate)),
    isOperator() ? watchButton : null,
  );
}

// Makes the entry of a robot. `driver` is the newest entry of its driver, or undefined.
function robotLine(name, driver) {
  const source = driver && driver.present ? `page_motion_source_${driver.source}` : "";
  const lines = view.capabilities ? view.capabilities.lines.filter((line) => line.robot === name) : [];
  return element(
    "li",
    {},
    element(
      "span",
      {},
      driver && (source ? words.tell(driver) : sentence("page_driver_gone", robotValues(name))),
      words.has(source) ? element("small", { class: "muted" }, sentence(source)) : null,
      ...lines.map((line) => element("small", { class: line.severity ? "ill" : "muted" }, words.tell(line))),
    ),
  );
}

// Opens a camera's picture below its line, or closes it.
export function toggleWatching(camera) {
  const image = watchedCameras.get(camera) || element("img", { alt: sentence("page_camera_image", { camera }) });
  if (watchedCameras.delete(camera)) image.remove();
  else {
    watchedCameras.set(camera, image);
    const fetchNext = () => {
      if (document.hidden) setTimeout(fetchNext, 400);
      else if (watchedCameras.get(camera) === image)
        image.src = `camera/${encodeURIComponent(camera)}.jpg?${Date.now()}`;
    };
    image.onload = () => setTimeout(fetchNext, 400);
    image.onerror = () => {
      if (watchedCameras.get(camera) === image) {
        toggleWatching(camera);
        toast(sentence("page_no_image"), true);
      }
    };
    fetchNext();
  }
  drawHealth();
}

export function drawEvents() {
  const time = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
  const today = new Date().toDateString();
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
        if (values.code) values.reason = sentence(values.code, values);
        const date = new Date(event.at * 1000);
        const format = date.toDateString() === today ? clockTime : dated;
        return element(
          "li",
          {},
          element("time", { datetime: date.toISOString() }, format.format(date)),
          element(
            "span",
            {},
            sentence(event.code, values),
            event.source ? element("small", { class: "muted" }, sourceName(event.source)) : null,
          ),
        );
      }),
  );
}

// Fetches the floor's picture again after a camera has come or gone, because then another part of the floor is visible.
export function refreshFloor() {
  const cameras = view.cameras
    .filter(({ present, hz }) => present && hz)
    .map(({ name }) => name)
    .join();
  if (floorOn && cameras !== floorCameras) setFloor(true);
  floorCameras = cameras;
}

export function setFloor(on) {
  floorOn = on;
  $("floor-button").setAttribute("aria-pressed", String(on));
  map.showPicture("floor", on ? `floor.webp?${Date.now()}` : "");
}
