// Draws and edits borders on the map, and sends robots to a point of the map.
//
// page.mode says what a touch of the map does: in "look" it moves the map or chooses a border; in "draw" and "wall" it
// draws a line; in "side" it chooses the side to be restricted; in "review" it moves corners of the draft; in "go" it
// sends a robot to that point.
"use strict";
import { below, closeOnBack } from "./dialog.js";
import { MapView } from "./map.js";
import { distance, inside, innermostPoint, toPoints, simplify } from "./shapes.js";
import { hello, isOperator, kindWord, page, promptCode, row, sentence, shownNotices, view, words } from "./state.js";
import {
  $,
  areaLine,
  ask,
  button,
  element,
  replaceContent,
  issueLines,
  lock,
  nameField,
  select,
  toast,
} from "./elements.js";

export let draft = null;
let modeChanges = 0; // number of changes of the mode so far
let taps = [];
let chosenCorner = null;
let check = null; // the newest preview of what saving would do
let newestQuestion = null; // the newest request for a preview, until it is answered
let isAsking = false; // whether a request for a preview is under way
// Called when a border was tapped, and after each change of mode.
export const listeners = { pick: () => {}, mode: () => {} };

export const map = new MapView(words, {
  tap(point, picked) {
    if (page.mode === "look") listeners.pick(picked);
    else if (page.mode === "go") sendRobot(point);
    else if (page.mode === "side") {
      draft.seed = point;
      setMode("review");
    } else if (taps.length && distance(taps[taps.length - 1], point) * map.view.scale < 12)
      return; // the same tap again
    else if (page.mode === "wall") {
      taps.push(point);
      if (taps.length === 2) begin([...taps], "wall");
      else showRough(taps, "taps");
    } else if (page.mode === "draw") {
      if (taps.length > 2 && distance(taps[0], point) * map.view.scale < 24) return begin([...taps], "polygon");
      taps.push(point);
      showRough(taps, "taps");
    }
  },
  stroke(points, ended) {
    if (page.mode === "wall" && ended) return begin([points[0], points[points.length - 1]], "wall");
    if (page.mode !== "draw") return;
    if (!ended) return points.length > 1 ? showRough(points) : showRough(taps, "taps");
    const size = Math.max(...points.map((point) => distance(point, points[0])));
    if (size * map.view.scale < 20) return showRough(taps, "taps");
    const closed = distance(points[0], points[points.length - 1]) < 0.35 * size;
    let line = simplify(points, Math.max(0.03, 3 / map.view.scale));
    const endsAtItsStart = distance(line[0], line[line.length - 1]) < 0.15 * size;
    if (closed && line.length > 3 && endsAtItsStart) line = line.slice(0, -1);
    begin(line, closed && line.length > 2 ? "polygon" : "curve");
  },
  choose(corner) {
    chosenCorner = corner;
    map.setDraft(draft, chosenCorner);
    drawReview();
  },
  drag(corner, point, ended) {
    changeCorners(corner, 1, [point], corner);
    if (ended) previewDraft();
  },
  between(corner, point) {
    changeCorners(corner + 1, 0, [point], corner + 1);
    previewDraft();
    return corner + 1;
  },
  removeCorner,
  outside() {
    toast(sentence("page_off_map"), true);
  },
});

// Replaces `count` corners from `start`, as splice does. A polygon's seed is moved too, unless somebody put it outside.
function changeCorners(start, count, corners, chosen) {
  const seedFollows = draft.kind === "polygon" && inside(draft.seed, draft.points);
  draft.points.splice(start, count, ...corners);
  if (seedFollows) draft.seed = innermostPoint(draft.points);
  map.setDraft(draft, (chosenCorner = chosen));
}

export function setMode(next) {
  page.mode = document.body.dataset.mode = next;
  modeChanges += 1;
  lock($("panel"));
  closeOnBack();
  if (next !== "look") toast(""); // the toast is about something that was done before
  map.drawing = next === "draw" || next === "wall";
  map.picking = next === "side" || next === "go";
  if (next === "look") {
    draft = check = newestQuestion = null;
  }
  if (next === "look" || next === "draw" || next === "wall") {
    taps = [];
    chosenCorner = null;
  }
  if (!["side", "draw", "wall", "go"].includes(next)) map.setCursor(null);
  map.setDraft(next === "review" || next === "side" ? draft : null, chosenCorner);
  drawHint();
  listeners.mode();
  if (next === "review") previewDraft();
  drawReview();
  $("map-area").scrollIntoView({ block: "nearest" });
  if (["draw", "wall", "side", "go"].includes(next)) $("map").focus({ preventScroll: true });
}

const toMillimetres = (point) => point.map((coordinate) => Number(coordinate.toFixed(3)));

let chosenRobot = ""; // the robot that is to be sent

async function sendRobot(goal) {
  const modeChangesBefore = modeChanges;
  const answer = await page.link.ask("send", { robot: chosenRobot, goal: toMillimetres(goal) });
  if (answer.ok && modeChanges === modeChangesBefore) setMode("look");
  toast(words.tell(answer), !answer.ok, answer.code);
}

function robotPanel(cancel) {
  const robots = view.capabilities ? view.capabilities.sendable_robots : [];
  if (!robots.includes(chosenRobot)) chosenRobot = robots.length ? robots[0] : "";
  const choices = robots.map((name) =>
    element(
      "button",
      {
        "data-key": `go ${name}`,
        "aria-pressed": String(name === chosenRobot),
        onclick: () => {
          chosenRobot = name;
          drawReview();
        },
      },
      name,
    ),
  );
  return [
    element("h2", {}, sentence("page_title_go")),
    element("p", { class: "muted" }, sentence("page_help_go")),
    robots.length > 1
      ? element("div", { class: "row", role: "group", "aria-label": sentence("page_robot") }, ...choices)
      : null,
    element("div", { class: "row" }, cancel),
  ];
}

function showRough(points, kind) {
  map.setDraft({ points, kind: "curve" }, null, kind || "line");
  drawHint();
  drawReview();
}

// Returns what a touch of the map does now, as the end of the hint's code.
function situation() {
  if (page.mode === "look") {
    if (!isOperator()) return "watch";
    return view.borders && !view.borders.list.length ? "empty" : "look";
  }
  if (page.mode === "review" && draft.kind === "wall") return "ends";
  const isLineBegun = taps.length && (page.mode === "draw" || page.mode === "wall");
  return isLineBegun ? `${page.mode}_next` : page.mode;
}

// Says what a touch of the map does. While it only chooses a border, the most important notice is shown instead.
export function drawHint() {
  const isLooking = page.mode === "look";
  const [notice] = isLooking ? shownNotices() : [];
  const code = (isLooking && promptCode()) || `page_hint_${situation()}`;
  const text = notice ? words.tell(notice) : sentence(code);
  if ($("hint").textContent !== text) $("hint").firstChild.textContent = text;
  $("hint").classList.toggle("warning", Boolean(notice && notice.severity));
}

// Begins a draft of a new border.
function begin(points, kind) {
  draft = {
    points,
    kind,
    seed: kind === "polygon" ? innermostPoint(points) : points[0],
    name: "",
    zone: hello.zones[0].name,
    max_speed: 0.2,
    enabled: true,
    robots: [],
    border: "",
    revision: 0,
  };
  setMode(kind === "curve" ? "side" : "review");
}

// Makes a draft of a stored border. If it has too many corners to be moved one by one, some are left out.
function draftOf(border) {
  const line = toPoints(border.points);
  return {
    points: line.length > 40 ? simplify(line, 0.02) : line,
    kind: border.kind,
    seed: toPoints(border.seed)[0],
    name: border.name,
    zone: border.zone,
    max_speed: border.max_speed || 0.2,
    enabled: border.enabled,
    robots: border.robots,
    border: border.id,
    revision: view.borders.revision,
  };
}

export function edit(border) {
  draft = draftOf(border);
  draft.stored = JSON.stringify(draftFields());
  setMode("review");
}

// Returns whether something was drawn or changed that is not saved yet.
const isUnsaved = () => (draft ? JSON.stringify(draftFields()) !== draft.stored : taps.length > 0);

// Returns whether the draft would still be a polygon or a line if it had one corner less.
const hasSpareCorners = () => draft.points.length > (draft.kind === "polygon" ? 3 : 2);

function removeCorner(corner) {
  if (!hasSpareCorners()) return;
  changeCorners(corner, 1, [], null);
  previewDraft();
}

// Returns the draft as a request's field.
const draftFields = () => ({
  points: draft.points.map(toMillimetres),
  kind: draft.kind,
  seed: toMillimetres(draft.seed),
  name: draft.name,
  zone: draft.zone,
  max_speed: row("zones", draft.zone).limits_speed ? draft.max_speed : 0,
  enabled: draft.enabled,
  robots: draft.robots,
});

// Asks what saving would do. Only one request is under way; after its answer, only the newest of those that were made
// meanwhile is sent. The previous answer is shown until the next one arrives, so that nothing on the page moves.
export async function previewDraft() {
  newestQuestion = {};
  drawReview();
  if (isAsking) return;
  isAsking = true;
  let question;
  let answer;
  do {
    question = newestQuestion;
    answer = await page.link.ask("preview", { draft: draftFields(), border: draft.border });
  } while (newestQuestion && newestQuestion !== question);
  isAsking = false;
  if (!newestQuestion) return; // there is no draft any more
  newestQuestion = null;
  check = answer;
  map.showPicture("region", answer.region || "");
  drawReview();
}

async function save() {
  const savedDraft = draft;
  const { border, revision } = draft;
  if (!isUnsaved()) {
    toast(sentence("page_saved"));
    return setMode("look");
  }
  const answer = border
    ? await ask("update", { draft: draftFields(), border, revision }, "page_saved")
    : await ask("add", { draft: draftFields() }, "page_saved");
  if (draft !== savedDraft) return; // the answer came late, and is about another draft
  if (answer.ok) return setMode("look");
  check = answer;
  drawReview();
  // a change that somebody else has made is shown first; only a second try overwrites it
  if (["revision_conflict", "page_no_border"].includes(answer.code)) {
    lock($("panel")); // so that a double tap on Save does not count as a second try
    draft.revision = view.borders.revision;
    if (!view.borders.list.some(({ id }) => id === border)) {
      draft.border = draft.stored = ""; // the draft may be saved as a new border
      toast(sentence("page_removed", { border: draft.name }), true);
    }
    previewDraft();
  }
}

// Lists the zones that a draft may have: the zone that it has, and those that at least one robot obeys. The first one,
// "keep out", may be drawn even if no robot is connected.
function zonesFor({ zone }) {
  const names = hello.zones.map(({ name }) => name);
  const isObeyed = (name) => !view.capabilities || view.capabilities.zones.includes(name);
  return names.filter((name, index) => index === 0 || name === zone || isObeyed(name));
}

// Makes the choice of the robots to which a border applies: all robots, unless some are chosen.
function robotChoice() {
  const connectedRobots = (view.capabilities && view.capabilities.robots) || [];
  const allRobots = [...new Set([...connectedRobots, ...draft.robots])].filter(Boolean);
  if (allRobots.length < 2) return null;
  const choose = (robots) => () => {
    draft.robots = robots.length === allRobots.length ? [] : robots;
    previewDraft();
  };
  const choice = (label, pressed, robots) =>
    element(
      "button",
      { "aria-pressed": String(pressed), "data-key": `robot ${label}`, onclick: choose(robots) },
      label,
    );
  return element(
    "div",
    { class: "row robots", role: "group", "aria-label": sentence("page_for") },
    choice(sentence("page_for_all"), !draft.robots.length, []),
    ...allRobots.map((name) => {
      const isChosen = draft.robots.includes(name);
      return choice(
        name,
        isChosen,
        isChosen ? draft.robots.filter((robot) => robot !== name) : [...draft.robots, name],
      );
    }),
  );
}

export function drawReview() {
  const box = $("review");
  box.hidden = page.mode === "look";
  if (page.mode === "look") {
    map.showPicture("region", "");
    return replaceContent(box, []);
  }
  const panel = { go: robotPanel, review: reviewPanel }[page.mode] || drawingPanel;
  replaceContent(box, panel(button("page_discard", () => setMode("look"))));
}

// Shows the panel while a line is drawn or a side is chosen.
function drawingPanel(cancel) {
  const end = (kind, style, minCorners) =>
    button(`page_end_${kind}`, () => begin([...taps], kind), style, { disabled: taps.length < minCorners });
  const takeBack = button("page_take_back", () => showRough((taps = taps.slice(0, -1)), "taps"), "", {
    disabled: !taps.length,
  });
  const close =
    page.mode === "side" && draft.kind === "curve" && draft.points.length > 2
      ? button("page_end_polygon", () => {
          draft.kind = "polygon";
          draft.seed = innermostPoint(draft.points);
          setMode("review");
        })
      : null;
  return [
    element("h2", {}, sentence(`page_title_${page.mode}`)),
    page.mode === "side" ? null : element("p", { class: "muted" }, sentence(`page_help_${page.mode}`)),
    element(
      "div",
      { class: "row" },
      cancel,
      ...(page.mode === "draw" ? [takeBack, end("curve", "", 2), end("polygon", "primary", 3)] : [close]),
    ),
  ];
}

// Says what saving would do: the area that it would restrict, why it would be refused, or that this is being checked.
function checkLine() {
  if (check === null) return element("p", { class: "muted" }, sentence("page_checking"));
  if (!check.ok) return element("p", { class: "issue error" }, words.tell(check));
  return draft.kind === "wall" ? null : areaLine(check.area);
}

// Shows the panel while a draft is reviewed: what saving would do, and the choices.
function reviewPanel(cancel) {
  const isWall = draft.kind === "wall";
  const name = nameField(words.border(draft.name), sentence(isWall ? "page_name_wall" : "page_name_free"));
  name.addEventListener("input", () => {
    draft.name = name.value;
  });
  const speed = element("input", {
    type: "number",
    min: 0.05,
    max: 1,
    step: 0.05,
    value: draft.max_speed,
    "data-key": "speed",
  });
  speed.addEventListener("change", () => {
    speed.value = draft.max_speed = Math.max(0.05, Math.min(1, Number(speed.value) || 0.2));
    previewDraft();
  });
  return [
    element("h2", {}, sentence(draft.border ? "page_title_edit" : "page_title_review", kindWord(draft.kind))),
    element("label", { class: "beside" }, element("span", {}, sentence("page_name")), name),
    // the effect of saving stands above the choices, so that people see it before they save, even on a small screen
    checkLine(),
    ...issueLines(check?.ok ? check.issues : []),
    isWall
      ? null
      : select("page_zone", draft.zone, zonesFor(draft), (value) => {
          draft.zone = value;
          previewDraft();
        }),
    row("zones", draft.zone).limits_speed
      ? element("label", {}, element("span", {}, sentence("page_speed")), speed)
      : null,
    robotChoice(),
    element(
      "div",
      { class: "row" },
      isWall ? null : button("page_other_side", () => setMode("side")),
      isWall && draft.points.length === 2
        ? null
        : button("page_remove_corner", () => removeCorner(chosenCorner), "", {
            disabled: chosenCorner === null || !hasSpareCorners(),
          }),
    ),
    element(
      "div",
      { class: "row decide" },
      cancel,
      button("page_save", save, "primary", { disabled: !check?.ok || Boolean(newestQuestion) }),
    ),
  ];
}

below.isChanged = () => page.mode !== "look" && isUnsaved();
below.leave = () => setMode("look");
