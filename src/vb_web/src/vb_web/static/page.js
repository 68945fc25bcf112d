// The page: what the server's view says, as words and buttons; what people press, as requests.
//
// mode is what a touch of the map means: "look" moves it and chooses borders; "draw" and "wall" put a line; "side" asks for the
// side to be restricted; "review" moves corners of the draft; "go" sends a robot there.
"use strict";
import { Link, Words } from "./link.js";
import { MapView, distance, inside, middle, pairs, simplify } from "./map.js";

const $ = (id) => document.getElementById(id);
const DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
const CHANGES = ["add", "update", "rename", "enable", "remove"]; // what undo takes back
const NAME_LENGTH = 60;
const words = new Words();
const view = {};
const hello = { role: "nobody", states: [], commands: [], zones: [] }; // with vb_core's tables: vocabulary.py, zones.py
const watched = new Map(); // camera: its picture, while somebody looks at it
let online = false,
  mode = "look",
  draft = null,
  taps = [],
  chosenCorner = null,
  check = null,
  checking = null, // the question that has no answer yet
  floorOn = false,
  floorSeers = "",
  toastTimer = 0;

// ----------------------------------------------------------------- small things
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "onclick") made.addEventListener("click", value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}
const say = (code, values) => words.say(code, values);
const button = (code, onclick, kind = "", values = {}) =>
  element("button", { type: "button", class: kind, onclick }, say(code, values));
const operator = () => hello.role === "operator";
const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;
// What is connected, and so what is offered; where it is not known (null: not any more), everything is.
const offers = (command) => !view.offer || view.offer.commands.includes(command);
const robotName = (name) => name || "$the_robot";
const row = (table, name) => hello[table].find((one) => one.name === name) || {};
// What a person does in a state: the code of the answer that led there, so that it stands here and is not said twice.
const prompt = () => row("states", document.body.dataset.state).prompt || null;
const commandName = (command) => say(`page_command_${command}`);

// Replaces a list's content if it changed: a button that is replaced under a finger is never pressed. What has the focus
// keeps it, by data-key.
const filled = new WeakMap();
function fill(parent, children) {
  const text = children
    .filter(Boolean)
    .map((child) => child.outerHTML)
    .join("");
  if (filled.get(parent) === text) return;
  filled.set(parent, text);
  const key = parent.contains(document.activeElement) && document.activeElement.dataset.key;
  parent.replaceChildren(...children.filter(Boolean));
  if (key) {
    const again = parent.querySelector(`[data-key="${CSS.escape(key)}"]`);
    if (again) again.focus({ preventScroll: true });
  }
}

// An answer that stands on the page, for instance as a notice, is not said twice.
function dropStanding() {
  const standing = [
    ...(view.notices || []).map((notice) => notice.code),
    prompt(),
    !online && "page_offline",
  ];
  if ($("laser-refused").textContent) standing.push(view.state.last.code);
  const { code } = $("toast").dataset; // none where it is no answer
  if (code && standing.includes(code)) $("toast").textContent = "";
}

// A second tap at once, as one zooms a picture, presses nothing that the first has brought up or uncovered.
const LOCKED_MS = 400;
const unlocking = new Map(); // part: the timer that ends its lock; an animation would stand still in a page that is not painted
function lock(part) {
  clearTimeout(unlocking.get(part));
  part.classList.add("locked");
  unlocking.set(
    part,
    setTimeout(() => part.classList.remove("locked"), LOCKED_MS),
  );
}

function toast(text, bad = false, code = "", more = null) {
  clearTimeout(toastTimer);
  lock($("line"));
  $("toast").replaceChildren(...(text ? [element("span", {}, text), more].filter(Boolean) : []));
  $("toast").dataset.code = code;
  dropStanding();
  $("toast").classList.toggle("bad", bad);
  if (text) toastTimer = setTimeout(() => toast(""), bad || more ? 9000 : 4500);
}

async function ask(action, fields, done = null, values = {}) {
  // a command is void after a stop that was not shown here yet
  const shown = (view.state && view.state.stop_number) || "";
  const seen = action === "command" ? { seen_stop: fields.command === "stop" ? "" : shown } : {};
  const answer = await link.ask(action, { ...fields, ...seen });
  if (answer.ok && done)
    toast(
      say(done, values),
      false,
      "",
      CHANGES.includes(action) ? button("page_undo", () => ask("command", { command: "undo" })) : null,
    );
  else if (!answer.ok || action === "command") toast(words.tell(answer), !answer.ok, answer.code);
  return answer;
}

// ----------------------------------------------------------------- modes
const map = new MapView(words, {
  tap(point, picked) {
    if (mode === "look") borderDialog(picked);
    else if (mode === "go") sendRobot(point);
    else if (mode === "side") {
      draft.seed = point;
      setMode("review");
    } else if (taps.length && distance(taps[taps.length - 1], point) * map.view.scale < 12)
      return; // the same tap again
    else if (mode === "wall") {
      taps.push(point);
      taps.length === 2 ? begin([...taps], "wall") : showRough(taps, "taps");
    } else if (mode === "draw") {
      if (taps.length > 2 && distance(taps[0], point) * map.view.scale < 24) return begin([...taps], "polygon");
      taps.push(point);
      showRough(taps, "taps");
    }
  },
  stroke(points, ended) {
    if (mode === "wall" && ended) return begin([points[0], points[points.length - 1]], "wall");
    if (mode !== "draw") return;
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
    const before = middleSeed();
    draft.points[corner] = point;
    if (before) draft.seed = middle(draft.points);
    map.setDraft(draft, (chosenCorner = corner));
    if (ended) examine();
  },
  between(corner, point) {
    draft.points.splice(corner + 1, 0, point);
    map.setDraft(draft, (chosenCorner = corner + 1));
    examine();
    return corner + 1;
  },
  removeCorner() {
    removeCorner();
  },
  outside() {
    toast(say("page_off_map"), true);
  },
});

// Whether the seed follows the polygon: it does while nobody has put it outside.
const middleSeed = () => draft.kind === "polygon" && inside(draft.seed, draft.points);

function setMode(next) {
  mode = document.body.dataset.mode = next;
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
  drawBanners();
  if (next === "review") examine();
  drawBorders();
  drawReview();
  $("map-area").scrollIntoView({ block: "nearest" });
  if (["draw", "wall", "side", "go"].includes(next)) $("map").focus({ preventScroll: true });
}

// ----------------------------------------------------------------- go there
let sent = ""; // the robot that goes

async function sendRobot(goal) {
  const answer = await link.ask("send", { robot: sent, goal: goal.map((v) => Number(v.toFixed(3))) });
  if (answer.ok) setMode("look");
  toast(words.tell(answer), !answer.ok, answer.code);
}

function reviewGo(cancel) {
  const goes = view.offer ? view.offer.goes : [];
  if (!goes.includes(sent)) sent = goes.length ? goes[0] : "";
  const choices = goes.map((name) =>
    element(
      "button",
      {
        type: "button",
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
    goes.length > 1 ? element("div", { class: "row", role: "group", "aria-label": say("page_robot") }, ...choices) : null,
    element("div", { class: "row" }, cancel),
  ];
}

// Where robots are going, each with its own stop beside it.
function drawDrives() {
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
          ? element(
              "button",
              { type: "button", class: "danger", "data-key": `halt ${name}`, onclick: () => ask("halt", { robot: name }) },
              say("page_end_drive"),
            )
          : null,
      ),
    ),
  );
}

function showRough(points, kind) {
  map.setDraft({ points, kind: "curve" }, null, kind || "line");
  drawHint();
  drawReview();
}

// What a touch of the map does; while it only chooses a border, the first thing that people should know comes before that.
function drawHint() {
  const [first] = mode === "look" ? standing() : [];
  const which =
    mode === "look" && !operator()
      ? "watch"
      : mode === "look" && view.borders && !view.borders.list.length
        ? "empty"
        : mode === "review" && draft.kind === "wall"
          ? "ends"
          : taps.length && (mode === "draw" || mode === "wall")
            ? `${mode}_next`
            : mode;
  const text = first
    ? words.tell(first)
    : say((mode === "look" && prompt()) || `page_hint_${which}`);
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
    schedule: "",
    enabled: true,
    robots: [],
    border: "",
    revision: 0,
  };
  setMode(kind === "curve" ? "side" : "review");
}

function draftOf(border) {
  const line = pairs(border.points);
  return {
    points: line.length > 40 ? simplify(line, 0.02) : line,
    kind: border.kind,
    seed: pairs(border.seed)[0],
    name: border.name,
    zone: border.zone,
    max_speed: border.max_speed || 0.2,
    schedule: border.schedule,
    enabled: border.enabled,
    robots: border.robots,
    border: border.id,
    revision: view.borders.revision,
  };
}

function edit(border) {
  draft = draftOf(border);
  draft.stored = JSON.stringify(draftFields());
  setMode("review");
}

// Whether something has been drawn or changed that nobody has saved.
const begun = () => (draft ? JSON.stringify(draftFields()) !== draft.stored : taps.length > 0);

function removeCorner() {
  const least = draft.kind === "polygon" ? 3 : 2;
  if (chosenCorner === null || draft.points.length <= least) return;
  draft.points.splice(chosenCorner, 1);
  chosenCorner = null;
  map.setDraft(draft, null);
  examine();
}

const draftFields = (of = draft) => ({
  points: of.points.map((p) => p.map((v) => Number(v.toFixed(3)))),
  kind: of.kind,
  seed: of.seed.map((v) => Number(v.toFixed(3))),
  name: of.name,
  zone: of.zone,
  max_speed: row("zones", of.zone).limits_speed ? of.max_speed : 0,
  schedule: of.schedule,
  enabled: of.enabled,
  robots: of.robots,
});

// Asks what saving would do; the newest question counts, and the last answer stands until its answer: nothing jumps.
async function examine() {
  const question = (checking = {});
  drawReview();
  const answer = await link.ask("preview", { draft: draftFields(), border: draft.border });
  if (question !== checking || !draft) return;
  checking = null;
  check = answer;
  map.picture("region", answer.region || "");
  drawReview();
}

async function save() {
  const { border, revision } = draft;
  if (!begun()) {
    toast(say("page_saved"));
    return setMode("look");
  }
  const answer = border
    ? await ask("update", { draft: draftFields(), border, revision }, "page_saved")
    : await ask("add", { draft: draftFields() }, "page_saved");
  if (answer.ok) setMode("look");
  else if (draft) {
    check = answer;
    drawReview();
  }
}

function issues(list) {
  return (list || []).map((one) => element("p", { class: `issue ${one.severity ? "error" : ""}` }, words.tell(one)));
}
const figures = (area) =>
  element("p", { class: "figures" }, element("b", {}, `${words.number(area, 2)} m²`), ` ${say("page_area")}`);
const what = (kind) => ({ what: kind === "wall" ? "$page_what_wall" : "$page_what_border" });

function nameField(value, placeholder = "") {
  const made = element("input", {
    maxlength: NAME_LENGTH,
    value,
    placeholder,
    "data-key": "name",
    autocomplete: "off",
  });
  made.addEventListener("input", () => {
    if (made.value.length === NAME_LENGTH) toast(say("page_name_long", { count: NAME_LENGTH }), true);
  });
  return made;
}

function select(code, value, options, onchange) {
  const made = element(
    "select",
    { "data-key": code },
    ...options.map((one) => element("option", { value: one, selected: one === value }, say(`${code}_${one}`))),
  );
  made.addEventListener("change", () => onchange(made.value));
  return element("label", {}, element("span", {}, say(code)), made);
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
      { type: "button", "aria-pressed": String(pressed), "data-key": `robot ${label}`, onclick: choose(robots) },
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

function drawReview() {
  const box = $("review");
  box.hidden = mode === "look";
  if (mode === "look") {
    map.picture("region", "");
    return fill(box, []);
  }
  const cancel = button("page_discard", () => setMode("look"));
  if (mode === "go") return fill(box, reviewGo(cancel));
  if (mode !== "review") {
    const end = (kind) =>
      Object.assign(
        button(`page_end_${kind}`, () => begin([...taps], kind), kind === "polygon" ? "primary" : ""),
        { disabled: taps.length < (kind === "polygon" ? 3 : 2) },
      );
    const takeBack = Object.assign(
      button("page_take_back", () => showRough((taps = taps.slice(0, -1)), "taps")),
      { disabled: !taps.length },
    );
    const close =
      mode === "side" && draft.kind === "curve" && draft.points.length > 2
        ? button("page_end_polygon", () => {
            draft.kind = "polygon";
            draft.seed = middle(draft.points);
            setMode("review");
          })
        : null;
    return fill(box, [
      element("h2", {}, say(`page_title_${mode}`)),
      mode === "side" ? null : element("p", { class: "muted" }, say(`page_help_${mode}`)),
      element(
        "div",
        { class: "row" },
        cancel,
        ...(mode === "draw" ? [takeBack, end("curve"), end("polygon")] : [close]).filter(Boolean),
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
    draft.max_speed = Math.max(0.05, Math.min(1, Number(speed.value) || 0.2));
    examine();
  });
  const refused = check && !check.ok;
  const corner = chosenCorner !== null && draft.points.length > (draft.kind === "polygon" ? 3 : 2);
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
        : Object.assign(button("page_remove_corner", removeCorner), { disabled: !corner }),
    ),
    element(
      "div",
      { class: "row decide" },
      cancel,
      Object.assign(button("page_save", save, "primary"), { disabled: !check || checking || refused }),
    ),
  ]);
}

// ----------------------------------------------------------------- borders
// Why a border is not in force; "" if it is.
function idle(border) {
  const code = !border.enabled
    ? "page_reason_disabled"
    : border.reason && !border.in_force
      ? `page_reason_${border.reason}`
      : "";
  return code && say(words.has(code) ? code : border.reason);
}

// How that is drawn, on the map and in the list: it waits for its time, or it is off.
const idleLook = (border) =>
  !idle(border) ? "" : border.enabled && border.reason === "off_schedule" ? "waits" : "off";
const markOf = (border) => element("span", { class: `mark ${idleLook(border)}` }, border.mark);

function why(border) {
  const kind = row("zones", border.zone).limits_speed
    ? say(border.unkept ? "page_slow_meant" : "page_slow_at", { speed: words.number(border.max_speed, 2) })
    : border.zone === hello.zones[0].name
      ? ""
      : say(`page_zone_${border.zone}`);
  const first = idle(border) || (border.kind === "wall" ? say("page_kind_wall") : `${words.number(border.area, 2)} m²`);
  const only = border.robots.length ? say("page_only_for", { who: border.robots.join(", ") }) : "",
    unkept = border.unkept && !idle(border) ? words.tell(border.unkept) : "";
  const waiting = border.in_force && border.reason && say(`page_reason_${border.reason}`);
  return [unkept, first, waiting, kind, only, border.schedule && scheduleText(border.schedule)]
    .filter(Boolean)
    .join(" · ");
}

function drawBorders() {
  if (!view.borders) return;
  const { list } = view.borders;
  map.setBorders(
    list.map((border) => {
      const look = idleLook(border);
      return { ...border, idle: look, note: look === "waits" ? scheduleText(border.schedule) : idle(border) };
    }),
    draft && draft.border,
  );
  fill(
    $("borders"),
    !list.length
      ? [element("li", { class: "muted" }, say("page_no_borders"))]
      : list.map((border) => {
          const toggle = element("button", {
            type: "button",
            class: "switch operator",
            role: "switch",
            "aria-checked": String(border.enabled),
            "aria-label": say("page_switch", { border: border.name }),
            "data-key": `switch ${border.id}`,
            onclick: () => toggleBorder(border),
          });
          const open = element(
            "button",
            {
              type: "button",
              class: "name",
              "data-key": `border ${border.id}`,
              onclick: () => borderDialog(border.id),
            },
            markOf(border),
            element(
              "span",
              {},
              words.border(border.name) || say("page_no_name"),
              element("small", { class: border.unkept && !idle(border) ? "ill" : "" }, why(border)),
            ),
          );
          return element("li", {}, open, toggle);
        }),
  );
}

const toggleBorder = (border) =>
  ask(
    "enable",
    { border: border.id, enabled: !border.enabled, revision: view.borders.revision },
    border.enabled ? "page_event_disabled" : "page_event_enabled",
    { border: border.name },
  );

function scheduleText(schedule) {
  // a word joiner on both sides: the line does not break at the dash
  return schedule
    .replace(/\b(mon|tue|wed|thu|fri|sat|sun|daily)\b/g, (day) => say(`page_day_${day}`))
    .replaceAll("-", "\u2060–\u2060");
}

function parseSchedule(text) {
  const match = /^(?:([a-z,-]+) )?(\d\d?:\d\d)-(\d\d?:\d\d)$/.exec(text);
  if (!match) return { days: new Set(), from: "", to: "" };
  const days = new Set();
  for (const part of (match[1] || "mon-sun").replace("daily", "mon-sun").split(",")) {
    const [a, b] = part.split("-"),
      first = DAYS.indexOf(a),
      last = DAYS.indexOf(b || a);
    for (let i = first; i !== (last + 1) % 7 || days.size === 0; i = (i + 1) % 7) {
      days.add(DAYS[i]);
      if (i === last) break;
    }
  }
  return { days, from: match[2].padStart(5, "0"), to: match[3].padStart(5, "0") };
}

// "06:00" of "6", "6:00" and "0600"; "" if it is no time of day.
function parseTime(text) {
  const [, hours, minutes = "00"] = /^([01]?\d|2[0-4]):?([0-5]\d)?$/.exec(text.trim()) || [];
  return !hours || (hours === "24" && minutes !== "00") ? "" : `${hours.padStart(2, "0")}:${minutes}`;
}

function formatSchedule({ days, from, to }) {
  if (!days.size || days.size === 7) return `${from}-${to}`;
  const parts = [];
  for (let i = 0; i < 7; i++) {
    if (!days.has(DAYS[i])) continue;
    let j = i;
    while (j < 6 && days.has(DAYS[j + 1])) j++;
    parts.push(j - i > 1 ? `${DAYS[i]}-${DAYS[j]}` : DAYS.slice(i, j + 1).join(","));
    i = j;
  }
  return `${parts.join(",")} ${from}-${to}`;
}

function show(title, ...children) {
  const dialog = $("dialog");
  dialog.replaceChildren(
    element("h2", { id: "dialog-title", tabindex: -1 }, ...[title].flat()),
    ...children.filter(Boolean),
  );
  Object.assign(dialog, { unsaved: () => null, onBack: leave });
  // not modal: stop has to be in reach all the time
  if (!dialog.open) dialog.show();
  lock(dialog);
  keepBack();
  document.querySelector("main").inert = true;
  // else a phone's keyboard comes up at once
  $("dialog-title").focus();
}
const closeButton = (code = "page_close") => button(code, () => leave());

// Goes on to what follows a dialog or a drawing, and asks first if something unsaved would be lost: `unsaved` of a dialog
// returns null, or what brings it back, as Back does from the question.
function leave(next = () => $("dialog").close()) {
  const again = $("dialog").open
    ? $("dialog").unsaved()
    : mode !== "look" && begun()
      ? () => $("dialog").close()
      : null;
  if (!again) return next();
  show(
    say("page_unsaved"),
    element(
      "div",
      { class: "row" },
      button("page_discard_change", next, "danger"),
      button("page_continue", again, "primary"),
    ),
  );
  $("dialog").onBack = again;
}

function borderDialog(id, typed = null) {
  const border = view.borders.list.find((one) => one.id === id);
  if (!border) return;
  const heading = [markOf(border), words.border(border.name) || say("page_no_name")];
  if (!operator()) return show(heading, element("p", { class: "muted" }, why(border)), closeButton());
  const target = { border: id, revision: view.borders.revision };
  const name = nameField(typed === null ? words.border(border.name) : typed);
  name.addEventListener("focus", () => name.select());
  const form = element(
    "form",
    {},
    element("label", {}, element("span", {}, say("page_name")), name),
    button("page_rename", () => form.requestSubmit()),
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (!name.value.trim()) toast(say("page_name_empty"), true);
    else if (
      name.value === words.border(border.name) ||
      (await ask("rename", { ...target, name: name.value }, "page_renamed")).ok
    )
      $("dialog").close();
  });
  show(
    heading,
    element("p", { class: "muted" }, why(border)),
    element(
      "div",
      { class: "row" },
      button(
        "page_edit",
        () =>
          leave(() => {
            $("dialog").close();
            edit(border);
          }),
        "primary",
      ),
      button("page_schedule", () => leave(() => scheduleDialog(border))),
    ),
    form,
    element(
      "div",
      { class: "row" },
      button(border.enabled ? "page_switch_off" : "page_switch_on", () =>
        leave(async () => {
          if ((await toggleBorder(border)).ok) $("dialog").close();
        }),
      ),
      button(
        "page_remove",
        async () => {
          if ((await ask("remove", target, "page_removed", { border: border.name })).ok) $("dialog").close();
        },
        "danger",
      ),
    ),
    closeButton(),
  );
  $("dialog").unsaved = () => (name.value === words.border(border.name) ? null : () => borderDialog(id, name.value));
}

function scheduleDialog(border, schedule = parseSchedule(border.schedule)) {
  const toggles = DAYS.map((day) =>
    element(
      "button",
      {
        type: "button",
        onclick: () =>
          press(
            schedule.days.has(day)
              ? DAYS.filter((one) => one !== day && schedule.days.has(one))
              : [...schedule.days, day],
          ),
      },
      say(`page_day_${day}`),
    ),
  );
  const press = (days) => {
    schedule.days = new Set(days);
    toggles.forEach((one, i) => one.setAttribute("aria-pressed", String(schedule.days.has(DAYS[i]))));
  };
  press(schedule.days);
  // not type=time, which has the browser's clock of 12 or 24 hours instead of the page's
  const times = [
    ["from", "page_from"],
    ["to", "page_to"],
  ].map(([key, code]) => {
    const made = element("input", {
      value: schedule[key],
      inputmode: "numeric",
      maxlength: 5,
      placeholder: "00:00",
      autocomplete: "off",
      "data-key": key,
    });
    made.addEventListener("input", () => {
      schedule[key] = parseTime(made.value);
    });
    made.addEventListener("change", () => {
      made.value = schedule[key] || made.value;
    });
    return element("label", {}, element("span", {}, say(code)), made);
  });
  // whoever says when a border is in force wants it switched on
  const put = async (text) => {
    if (text === border.schedule && border.enabled) {
      toast(say("page_saved"));
      return $("dialog").close();
    }
    const fields = { ...draftFields(draftOf(border)), points: pairs(border.points), schedule: text, enabled: true };
    const [saved, on] = text ? ["page_scheduled", "page_scheduled_and_on"] : ["page_saved", "page_saved_and_on"];
    if (
      (
        await ask(
          "update",
          { draft: fields, border: border.id, revision: view.borders.revision },
          border.enabled ? saved : on,
          { times: scheduleText(text) },
        )
      ).ok
    )
      $("dialog").close();
  };
  const save = () =>
    schedule.days.size && schedule.from && schedule.to
      ? put(formatSchedule(schedule))
      : toast(say("page_schedule_incomplete"), true);
  show(
    [markOf(border), say("page_schedule_of", { border: border.name })],
    element("p", { class: "muted" }, say("page_schedule_help")),
    element(
      "div",
      { class: "row" },
      button("page_weekdays", () => press(DAYS.slice(0, 5))),
      button("page_day_daily", () => press(DAYS)),
    ),
    element("div", { class: "days", role: "group", "aria-label": say("page_days") }, ...toggles),
    element("div", { class: "row" }, ...times),
    element(
      "div",
      { class: "row" },
      button("page_always", () => put("")),
      button("page_save", save, "primary"),
    ),
    closeButton(),
  );
  const shown = JSON.stringify([...schedule.days, schedule.from, schedule.to]);
  $("dialog").unsaved = () =>
    JSON.stringify([...schedule.days, schedule.from, schedule.to]) === shown
      ? null
      : () => scheduleDialog(border, schedule);
}

// ----------------------------------------------------------------- laser pointer: state and commands
async function command(name) {
  if (name === "save" && view.preview && view.preview.available && !(view.state && view.state.confirm))
    return confirmSave();
  return ask("command", { command: name });
}

// What one does now, and below it what one says for it, where that is another word.
function commandLabel(name) {
  const label = name === "save" && view.state && view.state.confirm ? say("page_save_again") : commandName(name),
    { spoken } = row("commands", name);
  return label.toLowerCase() === spoken || label === say("page_save_again")
    ? [label]
    : [element("span", {}, label, element("small", {}, say("page_spoken", { command: spoken })))];
}

function confirmSave() {
  const preview = view.preview;
  const go = button(
    preview.ok ? "page_save" : "page_try_save",
    async () => {
      await ask("command", { command: "save" });
      $("dialog").close();
    },
    "primary",
  );
  show(
    say("page_title_review", what("polygon")),
    preview.ok ? figures(preview.area) : element("p", { class: "issue error" }, words.tell(preview)),
    ...issues(preview.issues),
    element("div", { class: "row" }, closeButton("page_back"), go),
  );
}

function drawState() {
  const state = view.state,
    there = online && view.health && view.health.manager;
  // where no manager belongs to the lab, nothing waits for one: the robots are what is ready or not
  const alone = view.offer && !view.offer.interaction && !there;
  const ready = alone && view.offer.state === "ready" ? "default" : alone && view.offer.state;
  const name = !online ? "offline" : ready || (!state || !there ? "absent" : state.name);
  document.body.dataset.state = name;
  document.body.style.setProperty("--state", prompt() ? row("states", name).color : "");
  const stopped = Boolean(online && state && state.stopped);
  document.body.classList.toggle("stopped", stopped);
  $("state-name").textContent = say(`page_state_${stopped ? "stopped" : name}`);
  $("stop").disabled = !online;
  $("stop").hidden = !offers("stop");
  $("laser").hidden = (!state && !there) || !offers("define_border");
  $("go").hidden = !view.offer || !offers("go");
  const given = new Set(there && state ? state.available_commands.filter(offers) : []);
  const places = new Map(); // of commands that share a place, the one that is available is shown, or else the first
  for (const one of hello.commands.filter((command) => command.button_place))
    if (given.has(one.name) || !places.has(one.button_place)) places.set(one.button_place, one.name);
  const buttons = [...places.keys()].sort((a, b) => a - b).map((place) => places.get(place));
  $("laser-text").textContent = say(
    !there ? "page_manager_gone" : !state ? "page_laser_absent" : prompt() || "page_laser_default",
  );
  // also of a command by voice or from another phone: this is why nothing happened
  const refused =
    there && state && state.name !== "default" && state.last.command && !state.last.ok ? words.tell(state.last) : "";
  if ($("laser-refused").textContent !== refused) $("laser-refused").textContent = refused;
  fill(
    $("commands"),
    buttons.map((one) =>
      element(
        "button",
        {
          type: "button",
          "data-key": one,
          "data-command": one,
          disabled: !given.has(one),
          class: !given.has(one)
            ? ""
            : one === "save" ||
                (one === "define_seed" && !given.has("save")) ||
                (one === "define_border" && state.name !== "default")
              ? "primary"
              : "",
          onclick: () => command(one),
        },
        ...commandLabel(one),
      ),
    ),
  );
  const preview =
    there && state && state.name !== "default" && view.preview && view.preview.available ? view.preview : null;
  fill(
    $("preview"),
    preview
      ? [
          preview.ok ? figures(preview.area) : element("p", { class: "issue error" }, words.tell(preview)),
          ...issues(preview.ok ? preview.issues : []),
        ]
      : [],
  );
  if (mode === "look") map.picture("region", preview && preview.region ? preview.region : "");
  dropStanding();
}

function drawBanners() {
  const state = view.state,
    list = [];
  const put = (kind, sentence, ...buttons) =>
    list.push(element("p", { class: kind }, element("span", {}, sentence), ...(operator() ? buttons : [])));
  if (!online) put("bad", say("page_offline"));
  else {
    // whoever draws is told by the state alone
    if (state && state.stopped && mode === "look")
      put("bad", say("page_stopped", { who: sourceName(state.stopped_by) }));
    // a manager that hangs is there and says nothing: what is shown is as old as that
    if (view.health && view.health.manager && view.health.silent)
      put("bad", say("page_state_old", { time: clock(view.health.silent) }));
    if (view.health && !view.health.integrator) put("bad", say("page_integrator_gone"));
    if (view.offer === null) put("bad", say("page_monitor_gone"));
    if (view.borders && view.borders.unconfirmed)
      put(
        "",
        words.tell(view.borders),
        ...[
          ["page_same_place", true],
          ["page_other_place", false],
        ].map(([code, same]) => button(code, () => ask("confirm_map", { same, map_id: view.borders.map_id }, "page_noted"))),
      );
    if (state && state.ends_in_s && state.name !== "default")
      put("", say("page_ends", { time: clock(state.ends_in_s) }));
  }
  fill($("banners"), list); // what is read out already is not read out again
}

// ----------------------------------------------------------------- the rest of the panel
const sourceName = (source) => {
  const [kind] = String(source || "").split(" ");
  return words.has(`page_source_${kind}`) ? say(`page_source_${kind}`) : source;
};

// The notices that no banner says.
function standing() {
  const state = view.state || {},
    inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends_in_s };
  return (view.notices || []).filter((notice) => !inBanner[notice.code]);
}

function drawNotices() {
  drawHint();
  fill(
    $("notices"),
    standing().map((notice) =>
      element("li", { class: ["info", "warning", "error"][notice.severity] || "error" }, words.tell(notice)),
    ),
  );
  dropStanding();
}

function drawHealth() {
  const cameras = view.cameras || [],
    drivers = view.drivers || {};
  // each camera and robot with a problem once, whoever tells it; a notice about the only robot has its name in a value
  const about = (one) =>
    one.camera ? `camera ${one.camera}` : one.robot || one.values.who ? `robot ${one.robot || one.values.who}` : "";
  const told = [...(view.offer ? view.offer.lines : []), ...(view.notices || [])].filter((one) => one.severity);
  const bad = new Set([
    ...cameras.filter((one) => !one.there).map((one) => `camera ${one.name}`),
    ...Object.keys(drivers).filter((name) => !drivers[name].there).map((name) => `robot ${robotName(name)}`),
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
                type: "button",
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
function watch(camera) {
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

function drawEvents() {
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

function drawStudy() {
  const form = $("study-form");
  for (const key of ["participant", "condition"])
    if (document.activeElement !== form.elements[key]) form.elements[key].value = (view.study || {})[key] || "";
}

// A camera that comes or goes changes what there is to see of the floor.
function refreshFloor() {
  const seeing = view.cameras
    .filter((one) => one.there && one.hz)
    .map((one) => one.name)
    .join();
  if (floorOn && seeing !== floorSeers) setFloor(true);
  floorSeers = seeing;
}

function setFloor(on) {
  floorOn = on;
  $("floor-button").setAttribute("aria-pressed", String(on));
  map.picture("floor", on ? `floor.webp?${Date.now()}` : "");
}

function drawAll() {
  drawHint();
  drawState();
  drawBanners();
  drawBorders();
  drawReview();
  drawNotices();
  drawHealth();
  drawEvents();
  drawStudy();
  drawDrives();
}

const DRAW = {
  map(section) {
    map.setMap(section);
    $("floor-button").hidden = !section.floor;
    if (section.floor && operator() && !floorOn && !view.floorTried) {
      view.floorTried = true;
      setFloor(true);
    }
  },
  borders({ available_commands }) {
    drawHint();
    drawBorders();
    drawBanners();
    for (const one of ["undo", "redo"]) $(one).disabled = !available_commands.includes(one);
  },
  state() {
    drawState();
    drawBanners();
    drawNotices();
  },
  health() {
    drawState();
    drawBanners();
  },
  progress(section) {
    map.setProgress(section);
  },
  offer() {
    drawState();
    drawBanners();
    drawHealth();
    drawReview();
  },
  drives: drawDrives,
  preview: drawState,
  robots(section) {
    map.setRobots(section);
  },
  spots(section) {
    map.setSpots(section);
  },
  notices() {
    drawNotices();
    drawHealth();
  },
  cameras() {
    drawHealth();
    refreshFloor();
  },
  drivers: drawHealth,
  events: drawEvents,
  study: drawStudy,
};

// ----------------------------------------------------------------- beginning
// The language that was chosen here, or the first of the browser's that there is.
async function speak() {
  const asked = [localStorage.getItem("language"), ...navigator.languages, "en"].filter(Boolean);
  for (const one of asked.map((tag) => tag.slice(0, 2))) if (one === words.language || (await words.load(one))) return;
}

async function settings() {
  const languages = element(
    "div",
    { class: "row", role: "group", "aria-label": say("page_language") },
    ...(hello.languages || []).map((one) =>
      element(
        "button",
        {
          type: "button",
          lang: one,
          "aria-pressed": String(one === words.language),
          onclick: async () => {
            localStorage.setItem("language", one);
            await words.load(one);
            toast(""); // it is in the language before
            drawAll();
            settings();
          },
        },
        new Intl.DisplayNames([one], { type: "language" }).of(one),
      ),
    ),
  );
  const invite = operator()
    ? button("page_invite", async () => {
        const answer = await link.ask("invite");
        if (!answer.ok) return toast(words.tell(answer), true);
        const lines = answer.operator
          ? [
              ["page_code_operator", answer.operator],
              ["page_code_viewer", answer.viewer],
            ].flatMap(([code, value]) => [element("p", {}, say(code)), element("p", { class: "code" }, value)])
          : [element("p", { class: "muted" }, say("page_only_here"))];
        show(
          say("page_invite"),
          ...answer.addresses.map((one) => element("p", {}, element("a", { href: one }, one))),
          ...lines,
          closeButton(),
        );
      })
    : null;
  const leave = hello.login
    ? button("page_leave", async () => {
        await fetch("session", { method: "DELETE" });
        location.reload();
      })
    : null;
  show(say("page_settings"), languages, invite, leave, closeButton());
}

async function logIn(code) {
  const answer = await fetch("session", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ code }),
  });
  if (answer.ok) {
    $("login").hidden = true;
    link.connect();
  } else $("login-answer").textContent = say(answer.status === 429 ? "page_too_many_codes" : "page_wrong_code");
}

window.virtualBorders = { map, draft: () => draft, view }; // for tests and the console
await speak();
const link = new Link(
  (sections) => {
    Object.assign(view, sections);
    for (const name of Object.keys(DRAW)) if (name in sections) DRAW[name](sections[name]);
  },
  (found) => {
    Object.assign(hello, found);
    document.body.dataset.role = hello.role;
    online = true;
    $("login").hidden = true;
    drawAll();
    if (mode === "review") examine();
  },
  () => {
    online = false;
    drawState();
    drawBanners();
    map.live = false;
  },
  (session) => {
    document.body.dataset.role = session.role;
    if (session.role !== "nobody") return;
    $("login").hidden = false;
    $("login").querySelector("form").classList.toggle("closed", !session.login);
    $("login-text").textContent = say(session.login ? "page_login_help" : "page_only_local");
    for (const part of $("login").querySelectorAll("label, button")) part.hidden = !session.login;
    const code = new URLSearchParams(location.hash.slice(1)).get("code");
    if (code) {
      history.replaceState(null, "", location.pathname);
      logIn(code);
    }
  },
);

$("login")
  .querySelector("form")
  .addEventListener("submit", (event) => {
    event.preventDefault();
    logIn(event.target.elements.code.value);
  });
for (const command of ["stop", "resume"]) $(command).addEventListener("click", () => ask("command", { command }));
$("settings-button").addEventListener("click", settings);
$("draw").addEventListener("click", () => setMode("draw"));
$("wall").addEventListener("click", () => setMode("wall"));
$("go").addEventListener("click", () => setMode("go"));
for (const command of ["undo", "redo"]) $(command).addEventListener("click", () => ask("command", { command }));
$("zoom-in").addEventListener("click", () => map.zoom(1.4));
$("zoom-out").addEventListener("click", () => map.zoom(1 / 1.4));
$("zoom-fit").addEventListener("click", () => map.fit());
$("floor-button").addEventListener("click", () => setFloor(!floorOn));
$("study-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const { participant, condition } = event.target.elements;
  ask("study", { participant: participant.value, condition: condition.value }, "page_noted");
});
$("mark-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const text = event.target.elements.text;
  if ((await ask("mark", { text: text.value || say("page_mark") }, "page_noted")).ok) text.value = "";
});
$("health").addEventListener("toggle", () => {
  if (!$("health").open) [...watched.keys()].forEach(watch);
});
// What lies on top goes by Escape and by a phone's Back, which leaves the page only when there is nothing.
function goBack() {
  if ($("dialog").open) $("dialog").onBack();
  else if (mode !== "look")
    leave(() => {
      $("dialog").close();
      setMode("look");
    });
}
function keepBack() {
  if (!history.state && ($("dialog").open || mode !== "look")) history.pushState("on top", "");
}
window.addEventListener("popstate", () => {
  if (!history.state) {
    goBack();
    keepBack();
  }
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") goBack();
});
$("dialog").addEventListener("close", () => {
  document.querySelector("main").inert = false;
  lock(document.querySelector("main"));
});
// Stop and, as far from it as ever, the state with Resume keep place and size on the screen also while two fingers have
// enlarged the page, which helps to read it.
function keepOnScreen() {
  const { scale, offsetLeft, offsetTop } = window.visualViewport;
  for (const part of [$("stop"), $("standing")]) {
    part.style.transform = "";
    const { x, y } = part.getBoundingClientRect();
    if (scale > 1)
      part.style.transform = `translate(${offsetLeft + x / scale - x}px, ${offsetTop + y / scale - y}px) scale(${1 / scale})`;
  }
}
for (const change of ["resize", "scroll"]) window.visualViewport.addEventListener(change, keepOnScreen);
// a keyboard that shrinks the page covers no field that one types in
window.addEventListener("resize", () => {
  if (document.activeElement.matches("input")) document.activeElement.scrollIntoView({ block: "center" });
});
