// Drawing and changing borders on the map, and sending robots to a place of it.
//
// page.mode is what a touch of the map means: "look" moves it and chooses borders; "draw" and "wall" put a line; "side" asks for
// the side to be restricted; "review" moves corners of the draft; "go" sends a robot there.
"use strict";
import { below, keepBack } from "./dialog.js";
import { MapView } from "./map.js";
import { distance, inside, middle, pairs, simplify } from "./shapes.js";
import { hello, operator, page, prompt, row, say, standing, view, what, words } from "./state.js";
import { $, ask, button, element, figures, fill, issues, lock, nameField, select, toast } from "./ui.js";

export let draft = null;
let turn = 0, // counts changes of mode
  taps = [],
  chosenCorner = null,
  check = null,
  checking = null, // the newest question, which has no answer yet
  asking = false; // whether one is under way
// What the rest of the page does about a border that was tapped, and about another mode.
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
      taps.length === 2 ? begin([...taps], "wall") : showRough(taps, "taps");
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
    const size = Math.max(...points.map((p) => distance(p, points[0])));
    if (size * map.view.scale < 20) return showRough(taps, "taps");
    const closed = distance(points[0], points[points.length - 1]) < 0.35 * size;
    let line = simplify(points, Math.max(0.03, 3 / map.view.scale));
    if (closed && line.length > 3 && distance(line[0], line[line.length - 1]) < 0.15 * size) line = line.slice(0, -1);
    begin(line, closed && line.length > 2 ? "polygon" : "curve");
  },
  choose(corner) {
    chosenCorner = corner;
    map.setDraft(draft, chosenCorner);
    drawReview();
  },
  drag(corner, point, ended) {
    changeCorners(corner, 1, [point], corner);
    if (ended) examine();
  },
  between(corner, point) {
    changeCorners(corner + 1, 0, [point], corner + 1);
    examine();
    return corner + 1;
  },
  removeCorner,
  outside() {
    toast(say("page_off_map"), true);
  },
});

// Puts corners in the place of others, as splice does; a polygon's seed follows while nobody has put it outside.
function changeCorners(at, gone, corners, chosen) {
  const follows = draft.kind === "polygon" && inside(draft.seed, draft.points);
  draft.points.splice(at, gone, ...corners);
  if (follows) draft.seed = middle(draft.points);
  map.setDraft(draft, (chosenCorner = chosen));
}

export function setMode(next) {
  page.mode = document.body.dataset.mode = next;
  turn += 1;
  lock($("panel"));
  keepBack();
  if (next !== "look") toast(""); // of what was done before
  map.drawing = next === "draw" || next === "wall";
  map.picking = next === "side" || next === "go";
  if (next === "look") {
    draft = check = checking = null;
  }
  if (next === "look" || next === "draw" || next === "wall") {
    taps = [];
    chosenCorner = null;
  }
  if (!["side", "draw", "wall", "go"].includes(next)) map.setCursor(null);
  map.setDraft(next === "review" || next === "side" ? draft : null, chosenCorner);
  drawHint();
  listeners.mode();
  if (next === "review") examine();
  drawReview();
  $("map-area").scrollIntoView({ block: "nearest" });
  if (["draw", "wall", "side", "go"].includes(next)) $("map").focus({ preventScroll: true });
}

let sent = ""; // the robot that goes

async function sendRobot(goal) {
  const asked = turn;
  const answer = await page.link.ask("send", { robot: sent, goal: goal.map((v) => Number(v.toFixed(3))) });
  if (answer.ok && asked === turn) setMode("look");
  toast(words.tell(answer), !answer.ok, answer.code);
}

function reviewGo(cancel) {
  const goes = view.offer ? view.offer.goes : [];
  if (!goes.includes(sent)) sent = goes.length ? goes[0] : "";
  const choices = goes.map((name) =>
    element(
      "button",
      {
        "data-key": `go ${name}`,
        "aria-pressed": String(name === sent),
        onclick: () => {
          sent = name;
          drawReview();
        },
      },
      name,
    ),
  );
  return [
    element("h2", {}, say("page_title_go")),
    element("p", { class: "muted" }, say("page_help_go")),
    goes.length > 1
      ? element("div", { class: "row", role: "group", "aria-label": say("page_robot") }, ...choices)
      : null,
    element("div", { class: "row" }, cancel),
  ];
}

function showRough(points, kind) {
  map.setDraft({ points, kind: "curve" }, null, kind || "line");
  drawHint();
  drawReview();
}

// What a touch of the map does; while it only chooses a border, the first thing that people should know comes before that.
export function drawHint() {
  const [first] = page.mode === "look" ? standing() : [];
  const which =
    page.mode === "look" && !operator()
      ? "watch"
      : page.mode === "look" && view.borders && !view.borders.list.length
        ? "empty"
        : page.mode === "review" && draft.kind === "wall"
          ? "ends"
          : taps.length && (page.mode === "draw" || page.mode === "wall")
            ? `${page.mode}_next`
            : page.mode;
  const text = first ? words.tell(first) : say((page.mode === "look" && prompt()) || `page_hint_${which}`);
  if ($("hint").textContent !== text) $("hint").firstChild.textContent = text;
  $("hint").classList.toggle("warning", Boolean(first && first.severity));
}

function begin(points, kind) {
  draft = {
    points,
    kind,
    seed: kind === "polygon" ? middle(points) : points[0],
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

export function draftOf(border) {
  const line = pairs(border.points);
  return {
    points: line.length > 40 ? simplify(line, 0.02) : line,
    kind: border.kind,
    seed: pairs(border.seed)[0],
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

// Whether something has been drawn or changed that nobody has saved.
const begun = () => (draft ? JSON.stringify(draftFields()) !== draft.stored : taps.length > 0);

// Whether it is still a polygon, or a line, without one of its corners.
const spareCorners = () => draft.points.length > (draft.kind === "polygon" ? 3 : 2);

function removeCorner(corner) {
  if (!spareCorners()) return;
  changeCorners(corner, 1, [], null);
  examine();
}

export const draftFields = (of = draft) => ({
  points: of.points.map((p) => p.map((v) => Number(v.toFixed(3)))),
  kind: of.kind,
  seed: of.seed.map((v) => Number(v.toFixed(3))),
  name: of.name,
  zone: of.zone,
  max_speed: row("zones", of.zone).limits_speed ? of.max_speed : 0,
  enabled: of.enabled,
  robots: of.robots,
});

// Asks what saving would do, one question at a time, and after each answer only the newest, which counts. The last answer
// stands until then: nothing jumps.
export async function examine() {
  checking = {};
  drawReview();
  if (asking) return;
  asking = true;
  let question, answer;
  do {
    question = checking;
    answer = await page.link.ask("preview", { draft: draftFields(), border: draft.border });
  } while (checking && checking !== question);
  asking = false;
  if (!checking) return; // there is no draft any more
  checking = null;
  check = answer;
  map.picture("region", answer.region || "");
  drawReview();
}

async function save() {
  const saved = draft,
    { border, revision } = draft;
  if (!begun()) {
    toast(say("page_saved"));
    return setMode("look");
  }
  const answer = border
    ? await ask("update", { draft: draftFields(), border, revision }, "page_saved")
    : await ask("add", { draft: draftFields() }, "page_saved");
  if (draft !== saved) return; // an answer that comes late is not about what is drawn now
  if (answer.ok) return setMode("look");
  check = answer;
  drawReview();
  // somebody else's change is told and shown before it is built upon
  if (["revision_conflict", "page_no_border"].includes(answer.code)) {
    lock($("panel")); // a double tap on Save is no second try
    draft.revision = view.borders.revision;
    if (!view.borders.list.some((one) => one.id === border)) {
      draft.border = draft.stored = ""; // what is drawn may be saved as another one
      toast(say("page_removed", { border: draft.name }), true);
    }
    examine();
  }
}

// What a border may do: what some robot keeps, and what it does already. "keep out" may always be drawn beforehand.
const zonesFor = ({ zone }) =>
  hello.zones
    .map(({ name }) => name)
    .filter((one, at) => at === 0 || one === zone || !view.offer || view.offer.zones.includes(one));

// Which robots a border is for: all, unless some are chosen.
function robotChoice() {
  const known = [...new Set([...((view.offer && view.offer.robots) || []), ...draft.robots])].filter(Boolean);
  if (known.length < 2) return null;
  const choose = (robots) => () => {
    draft.robots = robots.length === known.length ? [] : robots;
    examine();
  };
  const choice = (label, pressed, robots) =>
    element(
      "button",
      { "aria-pressed": String(pressed), "data-key": `robot ${label}`, onclick: choose(robots) },
      label,
    );
  return element(
    "div",
    { class: "row robots", role: "group", "aria-label": say("page_for") },
    choice(say("page_for_all"), !draft.robots.length, []),
    ...known.map((name) => {
      const chosen = draft.robots.includes(name);
      return choice(name, chosen, chosen ? draft.robots.filter((one) => one !== name) : [...draft.robots, name]);
    }),
  );
}

export function drawReview() {
  const box = $("review");
  box.hidden = page.mode === "look";
  if (page.mode === "look") {
    map.picture("region", "");
    return fill(box, []);
  }
  const cancel = button("page_discard", () => setMode("look"));
  if (page.mode === "go") return fill(box, reviewGo(cancel));
  if (page.mode !== "review") {
    const end = (kind, style, least) =>
      button(`page_end_${kind}`, () => begin([...taps], kind), style, { disabled: taps.length < least });
    const takeBack = button("page_take_back", () => showRough((taps = taps.slice(0, -1)), "taps"), "", {
      disabled: !taps.length,
    });
    const close =
      page.mode === "side" && draft.kind === "curve" && draft.points.length > 2
        ? button("page_end_polygon", () => {
            draft.kind = "polygon";
            draft.seed = middle(draft.points);
            setMode("review");
          })
        : null;
    return fill(box, [
      element("h2", {}, say(`page_title_${page.mode}`)),
      page.mode === "side" ? null : element("p", { class: "muted" }, say(`page_help_${page.mode}`)),
      element(
        "div",
        { class: "row" },
        cancel,
        ...(page.mode === "draw" ? [takeBack, end("curve", "", 2), end("polygon", "primary", 3)] : [close]),
      ),
    ]);
  }
  const wall = draft.kind === "wall";
  const name = nameField(words.border(draft.name), say(wall ? "page_name_wall" : "page_name_free"));
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
    examine();
  });
  const refused = check && !check.ok;
  fill(box, [
    element("h2", {}, say(draft.border ? "page_title_edit" : "page_title_review", what(draft.kind))),
    element("label", { class: "beside" }, element("span", {}, say("page_name")), name),
    // what saving would do stands above what can be chosen: it is seen before one saves, also on a small screen
    check === null
      ? element("p", { class: "muted" }, say("page_checking"))
      : refused
        ? element("p", { class: "issue error" }, words.tell(check))
        : wall
          ? null
          : figures(check.area),
    ...issues(refused ? [] : check && check.issues),
    wall
      ? null
      : select("page_zone", draft.zone, zonesFor(draft), (value) => {
          draft.zone = value;
          examine();
        }),
    row("zones", draft.zone).limits_speed ? element("label", {}, element("span", {}, say("page_speed")), speed) : null,
    robotChoice(),
    element(
      "div",
      { class: "row" },
      wall ? null : button("page_other_side", () => setMode("side")),
      wall && draft.points.length === 2
        ? null
        : button("page_remove_corner", () => removeCorner(chosenCorner), "", {
            disabled: chosenCorner === null || !spareCorners(),
          }),
    ),
    element(
      "div",
      { class: "row decide" },
      cancel,
      button("page_save", save, "primary", { disabled: Boolean(!check || checking || refused) }),
    ),
  ]);
}

below.isChanged = () => page.mode !== "look" && begun();
below.leave = () => setMode("look");
