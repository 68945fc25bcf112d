// The page: what the server's view says, as words and buttons; what people press, as requests.
//
// mode is what a touch of the map means: "look" moves it and chooses borders; "draw" and "wall" put a line; "side" asks for the
// side to be restricted; "review" moves corners of the draft.
"use strict";
import { Link, Words } from "./link.js";
import { MapView, distance, inside, middle, pairs, simplify } from "./map.js";

const $ = (id) => document.getElementById(id);
const DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];
// what a person does in each state: the code of the answer that led there, so that it stands here and is not said twice
const DOES = { border: "draw_border", seed: "point_seed", guide: "guide" };
const COMMANDS = ["save", "define_seed", "define_border", "guide_robot", "cancel"];
const words = new Words();
const view = {};
const hello = { role: "nobody" };
let online = false, mode = "look", draft = null, taps = [], chosenCorner = null, check = null, checking = 0, chosenBorder = null, floorOn = false, floorSeers = "", watched = "", toastTimer = 0;

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
const button = (code, onclick, kind = "", values = {}) => element("button", { type: "button", class: kind, onclick }, say(code, values));
const operator = () => hello.role === "operator";
const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;
const commandName = (command) => say(`page_command_${command}`);

// Replaces a list's content if it changed: a button that is replaced under a finger is never pressed. What has the focus
// keeps it, by data-key.
const filled = new WeakMap();
function fill(parent, children) {
  const text = children.filter(Boolean).map((child) => child.outerHTML).join("");
  if (filled.get(parent) === text) return;
  filled.set(parent, text);
  const key = parent.contains(document.activeElement) && document.activeElement.dataset.key;
  parent.replaceChildren(...children.filter(Boolean));
  if (key) { const again = parent.querySelector(`[data-key="${CSS.escape(key)}"]`); if (again) again.focus({ preventScroll: true }); }
}

// An answer that stands on the page, for instance as a notice, is not said twice.
function dropStanding() {
  const standing = [...(view.notices || []).map((notice) => notice.code), DOES[document.body.dataset.state]];
  if ($("laser-refused").textContent) standing.push(view.state.last.code);
  if (standing.includes($("toast").dataset.code)) $("toast").textContent = "";
}

function toast(text, bad = false, code = "") {
  clearTimeout(toastTimer);
  $("toast").textContent = text;
  $("toast").dataset.code = code;
  dropStanding();
  $("toast").classList.toggle("bad", bad);
  toastTimer = setTimeout(() => { $("toast").textContent = ""; }, bad ? 9000 : 4500);
}

async function ask(action, fields, done = null) {
  const answer = await link.ask(action, fields);
  if (answer.ok && done) toast(say(done));
  else if (!answer.ok || action === "command") toast(words.tell(answer), !answer.ok, answer.code);
  return answer;
}

// ----------------------------------------------------------------- modes
const map = new MapView(words, {
  tap(point, picked) {
    if (mode === "look") choose(picked);
    else if (mode === "side") { draft.seed = point; setMode("review"); }
    else if (mode === "wall") { taps.push(point); taps.length === 2 ? begin([...taps], "wall") : showRough(taps, "taps"); }
    else if (mode === "draw") {
      if (taps.length > 2 && distance(taps[0], point) * map.view.scale < 24) return begin([...taps], "polygon");
      taps.push(point);
      showRough(taps, "taps");
    }
  },
  stroke(points, ended) {
    if (mode === "wall" && ended) return begin([points[0], points[points.length - 1]], "wall");
    if (mode !== "draw") return;
    if (!ended) return showRough(points, points.length > 1);
    const size = Math.max(...points.map((p) => distance(p, points[0])));
    if (size * map.view.scale < 20) return showRough(taps, "taps");
    const closed = distance(points[0], points[points.length - 1]) < .35 * size;
    let line = simplify(points, Math.max(.03, 3 / map.view.scale));
    if (closed && line.length > 3 && distance(line[0], line[line.length - 1]) < .15 * size) line = line.slice(0, -1);
    begin(line, closed && line.length > 2 ? "polygon" : "curve");
  },
  choose(corner) { chosenCorner = corner; map.setDraft(draft, chosenCorner); drawReview(); },
  drag(corner, point, ended) {
    const before = middleSeed();
    draft.points[corner] = point;
    if (before) draft.seed = middle(draft.points);
    map.setDraft(draft, chosenCorner = corner);
    if (ended) examine();
  },
  between(corner, point) {
    draft.points.splice(corner + 1, 0, point);
    map.setDraft(draft, chosenCorner = corner + 1);
    examine();
    return corner + 1;
  },
  removeCorner() { removeCorner(); },
});

// Whether the seed follows the polygon: it does while nobody has put it outside.
const middleSeed = () => draft.kind === "polygon" && inside(draft.seed, draft.points);

function setMode(next) {
  mode = document.body.dataset.mode = next;
  map.drawing = next === "draw" || next === "wall";
  map.picking = next === "side";
  if (next === "look") { draft = null; check = null; }
  if (next === "look" || next === "draw" || next === "wall") { taps = []; chosenCorner = null; }
  if (next !== "side" && next !== "draw" && next !== "wall") map.setCursor(null);
  map.setDraft(next === "review" || next === "side" ? draft : null, chosenCorner);
  $("hint").textContent = next === "look" ? "" : say(`page_hint_${next}`);
  if (next === "review") examine();
  drawBorders();
  drawReview();
  if (next === "draw" || next === "wall" || next === "side") {
    $("map-area").scrollIntoView({ block: "nearest" });
    $("map").focus({ preventScroll: true });
  }
}

function showRough(points, kind) {
  map.setDraft({ points, kind: "curve" }, null, kind || "line");
  $("hint").textContent = say(taps.length && mode === "draw" ? "page_hint_corners" : `page_hint_${mode}`);
  drawReview();
}

function begin(points, kind) {
  draft = { points, kind, seed: kind === "polygon" ? middle(points) : points[0], name: "", zone: "keep_out", max_speed: .2, schedule: "", border: "", revision: 0 };
  setMode(kind === "curve" ? "side" : "review");
}

function edit(border) {
  const line = pairs(border.points);
  draft = {
    points: line.length > 40 ? simplify(line, .02) : line, kind: border.kind, seed: pairs(border.seed)[0], name: border.name, zone: border.zone,
    max_speed: border.max_speed || .2, schedule: border.schedule, border: border.id, revision: view.borders.revision,
  };
  setMode("review");
}

function removeCorner() {
  const least = draft.kind === "polygon" ? 3 : 2;
  if (chosenCorner === null || draft.points.length <= least) return;
  draft.points.splice(chosenCorner, 1);
  chosenCorner = null;
  map.setDraft(draft, null);
  examine();
}

const draftFields = () => ({
  points: draft.points.map((p) => p.map((v) => Number(v.toFixed(3)))), kind: draft.kind, seed: draft.seed.map((v) => Number(v.toFixed(3))),
  name: draft.name, zone: draft.zone, max_speed: draft.zone === "slow" ? draft.max_speed : 0, schedule: draft.schedule,
});

// Asks what saving would do; the newest question counts.
async function examine() {
  const number = ++checking;
  check = null;
  drawReview();
  const answer = await link.ask("preview", { draft: draftFields(), border: draft.border });
  if (number !== checking || !draft) return;
  check = answer;
  map.picture("region", answer.region || "");
  drawReview();
}

async function save() {
  const { border, revision } = draft;
  const answer = border ? await ask("update", { draft: draftFields(), border, revision }, "page_saved") : await ask("add", { draft: draftFields() }, "page_saved");
  if (answer.ok) { chosenBorder = answer.border || border; setMode("look"); } else if (draft) { check = answer; drawReview(); }
}

function issues(list) {
  return (list || []).map((one) => element("p", { class: `issue ${one.severity ? "error" : ""}` }, words.tell(one)));
}
const figures = (area, parts) => element("div", { class: "figures" },
  element("div", {}, element("b", {}, `${words.number(area, 2)} m²`), say("page_area")),
  parts > 1 ? element("div", {}, element("b", {}, words.number(parts, 0)), say("page_parts")) : null);

function select(code, value, options, onchange) {
  const made = element("select", { "data-key": code }, ...options.map((one) => element("option", { value: one, selected: one === value }, say(`${code}_${one}`))));
  made.addEventListener("change", () => onchange(made.value));
  return element("label", {}, element("span", {}, say(code)), made);
}

function drawReview() {
  const box = $("review");
  box.hidden = mode === "look";
  if (mode === "look") { map.picture("region", ""); return fill(box, []); }
  const cancel = button("page_discard", () => setMode("look"));
  if (mode !== "review") {
    const done = mode === "draw" && taps.length > 1 ? button("page_finish", () => begin([...taps], taps.length > 2 ? "polygon" : "curve"), "primary") : null;
    const close = mode === "side" && draft.points.length > 2 ? button("page_close_line", () => { draft.kind = "polygon"; draft.seed = middle(draft.points); setMode("review"); }) : null;
    return fill(box, [element("h2", {}, say(mode === "wall" ? "page_wall" : `page_title_${mode}`)), mode === "side" ? null : element("p", { class: "muted" }, say(`page_help_${mode}`)), element("div", { class: "row" }, cancel, close, done)]);
  }
  const name = element("input", { maxlength: 60, value: words.border(draft.name), placeholder: say("page_name_free"), "data-key": "name", autocomplete: "off" });
  name.addEventListener("input", () => { draft.name = name.value; });
  const speed = element("input", { type: "number", min: .05, max: 1, step: .05, value: draft.max_speed, "data-key": "speed" });
  speed.addEventListener("change", () => { draft.max_speed = Math.max(.05, Math.min(1, Number(speed.value) || .2)); examine(); });
  const refused = check && !check.ok;
  const corner = chosenCorner !== null && draft.points.length > (draft.kind === "polygon" ? 3 : 2);
  fill(box, [
    element("h2", {}, say(draft.border ? "page_title_edit" : "page_title_review")),
    check === null ? element("p", { class: "muted" }, say("page_checking")) : refused ? element("p", { class: "issue error" }, words.tell(check)) : draft.kind === "wall" ? null : figures(check.area, check.parts),
    ...issues(refused ? [] : check && check.issues),
    element("div", { class: "row" }, button("page_discard", () => setMode("look")), Object.assign(button("page_save", save, "primary"), { disabled: !check || refused })),
    element("label", {}, element("span", {}, say("page_name")), name),
    select("page_zone", draft.zone, ["keep_out", "avoid", "slow"], (value) => { draft.zone = value; examine(); }),
    draft.zone === "slow" ? element("label", {}, element("span", {}, say("page_speed")), speed) : null,
    element("div", { class: "row" }, draft.kind === "wall" ? null : button("page_other_side", () => setMode("side")), corner ? button("page_remove_corner", removeCorner) : null),
  ]);
}

// ----------------------------------------------------------------- borders
function choose(id) {
  chosenBorder = id;
  drawBorders();
  if (id) borderDialog(id);
}

function why(border) {
  const idle = !border.enabled ? "page_reason_disabled" : border.reason && !border.acting ? `page_reason_${border.reason}` : "";
  const kind = border.zone === "slow" ? say("page_slow_at", { speed: words.number(border.max_speed, 2) }) : border.zone === "avoid" ? say("page_zone_avoid") : "";
  const first = idle ? say(words.has(idle) ? idle : border.reason) : border.kind === "wall" ? say("page_wall") : `${words.number(border.area, 2)} m²`;
  return [first, kind, border.schedule && scheduleText(border.schedule)].filter(Boolean).join(" · ");
}

function drawBorders() {
  if (!view.borders) return;
  const { list, revision, unconfirmed } = view.borders;
  map.setBorders(list, { id: chosenBorder, hidden: draft && draft.border });
  fill($("borders"), !list.length ? [element("li", { class: "muted" }, say("page_no_borders"))] : list.map((border) => {
    const toggle = element("button", {
      type: "button", class: "switch operator", role: "switch", "aria-checked": String(border.enabled), "aria-label": say("page_switch", { border: border.name }), "data-key": `switch ${border.id}`,
      onclick: () => ask("enable", { border: border.id, enabled: !border.enabled, revision: view.borders.revision }),
    });
    const open = element("button", { type: "button", class: "name", "data-key": `border ${border.id}`, onclick: () => choose(border.id) },
      element("span", {}, words.border(border.name) || say("page_no_name"), element("small", {}, why(border))));
    return element("li", {}, open, toggle);
  }));
}

function scheduleText(schedule) {
  return schedule.replace(/\b(mon|tue|wed|thu|fri|sat|sun|daily)\b/g, (day) => say(`page_day_${day}`));
}

function parseSchedule(text) {
  const match = /^(?:([a-z,-]+) )?(\d\d?:\d\d)-(\d\d?:\d\d)$/.exec(text);
  if (!match) return { days: new Set(DAYS), from: "22:00", to: "06:00" };
  const days = new Set();
  for (const part of (match[1] || "mon-sun").replace("daily", "mon-sun").split(",")) {
    const [a, b] = part.split("-"), first = DAYS.indexOf(a), last = DAYS.indexOf(b || a);
    for (let i = first; i !== (last + 1) % 7 || days.size === 0; i = (i + 1) % 7) { days.add(DAYS[i]); if (i === last) break; }
  }
  return { days, from: match[2].padStart(5, "0"), to: match[3].padStart(5, "0") };
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
  dialog.replaceChildren(element("h2", { id: "dialog-title", tabindex: -1 }, title), ...children.filter(Boolean));
  // not modal: stop has to be in reach all the time
  if (!dialog.open) dialog.show();
  document.querySelector("main").inert = true;
  // else a phone's keyboard comes up at once
  $("dialog-title").focus();
}
const closeButton = (code = "page_close") => button(code, () => $("dialog").close());

function borderDialog(id) {
  const border = view.borders.list.find((one) => one.id === id);
  if (!border) return;
  const heading = words.border(border.name) || say("page_no_name");
  if (!operator()) return show(heading, element("p", { class: "muted" }, why(border)), closeButton());
  const target = { border: id, revision: view.borders.revision };
  const name = element("input", { maxlength: 60, value: words.border(border.name), autocomplete: "off" });
  const form = element("form", {}, element("label", {}, element("span", {}, say("page_name")), name), button("page_rename", () => form.requestSubmit()));
  form.addEventListener("submit", async (event) => { event.preventDefault(); if (name.value.trim() && (await ask("rename", { ...target, name: name.value }, "page_renamed")).ok) $("dialog").close(); });
  show(heading, element("p", { class: "muted" }, why(border)),
    element("div", { class: "row" }, button("page_edit", () => { $("dialog").close(); edit(border); }, "primary"), button("page_schedule", () => scheduleDialog(border))),
    form,
    element("div", { class: "row" }, button("page_remove", async () => {
      if ((await ask("remove", target, "page_removed")).ok) { chosenBorder = null; $("dialog").close(); }
    }, "danger"), closeButton()));
}

function scheduleDialog(border) {
  const schedule = parseSchedule(border.schedule);
  const days = element("div", { class: "days", role: "group", "aria-label": say("page_days") }, ...DAYS.map((day) => {
    const toggle = element("button", { type: "button", "aria-pressed": String(schedule.days.has(day)), onclick: () => {
      schedule.days[schedule.days.has(day) ? "delete" : "add"](day);
      toggle.setAttribute("aria-pressed", String(schedule.days.has(day)));
    } }, say(`page_day_${day}`));
    return toggle;
  }));
  const times = [["from", "page_from"], ["to", "page_to"]].map(([key, code]) => { const made = element("input", { type: "time", value: schedule[key] }); made.addEventListener("change", () => { if (made.value) schedule[key] = made.value; }); return element("label", {}, element("span", {}, say(code)), made); });
  const put = async (text) => {
    edit(border);
    draft.schedule = text;
    const fields = draftFields();
    fields.points = pairs(border.points);
    setMode("look");
    if ((await ask("update", { draft: fields, border: border.id, revision: view.borders.revision }, "page_saved")).ok) $("dialog").close();
  };
  show(say("page_schedule"), element("p", { class: "muted" }, say("page_schedule_help")), days, element("div", { class: "row" }, ...times),
    element("div", { class: "row" }, button("page_always", () => put("")), button("page_save", () => put(formatSchedule(schedule)), "primary")), closeButton());
}

// ----------------------------------------------------------------- laser pointer: state and commands
async function command(name) {
  if (name === "save" && view.preview && view.preview.available && !(view.state && view.state.confirm)) return confirmSave();
  return ask("command", { command: name });
}

function confirmSave() {
  const preview = view.preview;
  const go = button(preview.ok ? "page_save" : "page_try_save", async () => {
    await ask("command", { command: "save" });
    $("dialog").close();
  }, "primary");
  show(say("page_title_review"), preview.ok ? figures(preview.area, preview.parts) : element("p", { class: "issue error" }, words.tell(preview)),
    ...issues(preview.issues), element("div", { class: "row" }, closeButton("page_back"), go));
}

function drawState() {
  const state = view.state, there = online && view.health && view.health.manager;
  const name = !online ? "offline" : !state || !there ? "absent" : state.name;
  document.body.dataset.state = name;
  $("state-name").textContent = say(`page_state_${name}`);
  $("elapsed").textContent = there && state && state.name !== "default" ? clock(state.elapsed) : "";
  const stopped = Boolean(state && state.stopped);
  $("stop").classList.toggle("resume", stopped);
  $("stop-word").textContent = say(stopped ? "page_resume" : "page_stop");
  words.label($("stop"), stopped ? "page_resume" : "page_stop_all");
  $("stop").dataset.command = stopped ? "resume" : "stop";
  $("stop").disabled = !online;
  $("laser").hidden = !state && !there;
  const given = new Set(there && state ? state.commands : []);
  $("laser-text").textContent = say(!there ? "page_manager_gone" : !state ? "page_laser_absent" : DOES[state.name] || "page_laser_default");
  // also of a command by voice or from another phone: this is why nothing happened
  const refused = there && state && state.name !== "default" && state.last.command && !state.last.ok ? words.tell(state.last) : "";
  if ($("laser-refused").textContent !== refused) $("laser-refused").textContent = refused;
  fill($("commands"), COMMANDS.filter((one) => given.has(one)).map((one) => element("button", {
    type: "button", "data-key": one, "data-command": one, class: one === "save" || (one === "define_seed" && !given.has("save")) || (one === "define_border" && state.name !== "default") ? "primary" : "", onclick: () => command(one),
  }, one === "save" && state.confirm ? say("page_save_again") : commandName(one))));
  const preview = there && state && state.name !== "default" && view.preview && view.preview.available ? view.preview : null;
  fill($("preview"), preview ? [preview.ok ? figures(preview.area, preview.parts) : element("p", { class: "issue error" }, words.tell(preview)), ...issues(preview.ok ? preview.issues : [])] : []);
  if (mode === "look") map.picture("region", preview && preview.region ? preview.region : "");
  dropStanding();
}

function drawBanners() {
  // a banner moves the map: not while a finger draws on it
  if (map.pointers.size) return void setTimeout(drawBanners, 200);
  const state = view.state, list = [];
  if (!online) list.push(["page_offline", {}, true]);
  else {
    if (state && state.stopped) list.push(["page_stopped", { who: sourceName(state.stopped_by) }, true]);
    // a manager that hangs is there and says nothing: what is shown is as old as that
    if (view.health && view.health.manager && view.health.silent) list.push(["page_state_old", { time: clock(view.health.silent) }, true]);
    if (view.health && !view.health.integrator) list.push(["page_integrator_gone", {}, true]);
    if (view.borders && view.borders.unconfirmed) list.push([view.borders.code, view.borders.values, "ask", view.borders.message]);
    if (state && state.ends && state.name !== "default") list.push(["page_ends", { time: clock(state.ends) }, false]);
  }
  const made = list.map(([code, values, bad, message]) => [words.say(code, values, message), bad]);
  const text = JSON.stringify(made);
  if ($("banners").dataset.text === text) return;  // what is read out already is not read out again
  $("banners").dataset.text = text;
  $("banners").replaceChildren(...made.map(([sentence, bad]) => element("p", { class: bad === true ? "bad" : "" }, sentence,
    bad === "ask" && operator() ? element("span", { class: "row" }, button("page_same_place", () => ask("confirm_map", { same: true }, "page_noted")), button("page_other_place", () => ask("confirm_map", { same: false }, "page_noted"))) : null)));
}

// ----------------------------------------------------------------- the rest of the panel
const sourceName = (source) => { const [kind, rest] = String(source || "").split(" "); return words.has(`page_source_${kind}`) ? say(`page_source_${kind}`) + (rest ? ` ${rest}` : "") : source; };

function drawNotices() {
  const state = view.state || {}, inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends };
  fill($("notices"), (view.notices || []).filter((notice) => !inBanner[notice.code]).map((notice) => element("li", { class: ["info", "warning", "error"][notice.severity] || "error" }, words.tell(notice))));
  dropStanding();
}

function drawHealth() {
  const cameras = view.cameras || [], ill = view.diagnostics || [];
  const bad = cameras.filter((one) => !one.there).length + ill.length;
  $("health-sum").textContent = bad ? say("page_problems", { count: bad }) : cameras.length ? say("page_all_well") : "";
  $("health-sum").className = bad ? "ill" : "good";
  fill($("cameras"), cameras.map((one) => element("li", {},
    element("span", {}, one.name, element("small", { class: "muted" }, one.there ? say("page_camera_rate", { hz: words.number(one.hz, 0), ms: words.number(one.ms, 0) }) : say("page_camera_gone"))),
    operator() ? element("button", { type: "button", "data-key": `see ${one.name}`, "aria-pressed": String(watched === one.name), "aria-label": say("page_see_camera", { camera: one.name }), onclick: () => watch(watched === one.name ? "" : one.name) }, say("page_see")) : null)));
  fill($("diagnostics"), ill.map((one) => element("li", {}, element("span", { class: "ill" }, `${one.name}: ${one.message}`))));
}

function watch(camera) {
  watched = camera;
  drawHealth();
  if (!camera) return $("camera-view").replaceChildren();
  const image = element("img", { alt: say("page_camera_image", { camera }) });
  $("camera-view").replaceChildren(image);
  const next = () => { if (watched === camera && image.isConnected && $("health").open && !document.hidden) image.src = `camera/${encodeURIComponent(camera)}.jpg?${Date.now()}`; else if (watched === camera) watch(""); };
  image.onload = () => setTimeout(next, 400);
  image.onerror = () => { if (watched === camera) { watch(""); toast(say("page_no_image"), true); } };
  next();
}

function drawEvents() {
  const format = new Intl.DateTimeFormat(words.language, { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });
  $("events").replaceChildren(...(view.events || []).slice().reverse().map((event) => {
    const values = { ...event.values };
    if (values.command) values.command = commandName(values.command);
    if (values.code) values.reason = say(values.code, values);
    const at = new Date(event.at * 1000);
    return element("li", {}, element("time", { datetime: at.toISOString() }, format.format(at)), element("span", {}, say(event.code, values), event.source ? element("small", { class: "muted" }, sourceName(event.source)) : null));
  }));
}

function drawStudy() {
  const form = $("study-form");
  for (const key of ["participant", "condition"]) if (document.activeElement !== form.elements[key]) form.elements[key].value = (view.study || {})[key] || "";
}

// A camera that comes or goes changes what there is to see of the floor.
function refreshFloor() {
  const seeing = view.cameras.filter((one) => one.there && one.hz).map((one) => one.name).join();
  if (floorOn && seeing !== floorSeers) setFloor(true);
  floorSeers = seeing;
}

function setFloor(on) {
  floorOn = on;
  $("floor-button").setAttribute("aria-pressed", String(on));
  map.picture("floor", on ? `floor.webp?${Date.now()}` : "");
}

function drawAll() { drawState(); drawBanners(); drawBorders(); drawReview(); drawNotices(); drawHealth(); drawEvents(); drawStudy(); }

const DRAW = {
  map(section) {
    map.setMap(section);
    $("floor-button").hidden = !section.floor;
    if (section.floor && operator() && !floorOn && !view.floorTried) { view.floorTried = true; setFloor(true); }
  },
  borders() { drawBorders(); drawBanners(); }, state() { drawState(); drawBanners(); drawNotices(); }, health() { drawState(); drawBanners(); },
  progress(section) { map.setProgress(section); }, preview: drawState, robots(section) { map.setRobots(section); }, spots(section) { map.setSpots(section); },
  level(section) { $("level").hidden = section === null; $("level").querySelector("meter").value = section === null ? -60 : section; },
  notices: drawNotices, cameras() { drawHealth(); refreshFloor(); }, diagnostics: drawHealth, events: drawEvents, study: drawStudy,
};

// ----------------------------------------------------------------- beginning
function language() {
  const asked = [localStorage.getItem("language"), ...navigator.languages, "en"].filter(Boolean).map((one) => one.slice(0, 2));
  return asked.find((one) => (hello.languages || ["en", "de"]).includes(one)) || "en";
}

async function settings() {
  const languages = element("div", { class: "row", role: "group", "aria-label": say("page_language") }, ...(hello.languages || []).map((one) =>
    element("button", { type: "button", lang: one, "aria-pressed": String(one === words.language), onclick: async () => { localStorage.setItem("language", one); await words.load(one); drawAll(); settings(); } }, new Intl.DisplayNames([one], { type: "language" }).of(one))));
  const invite = operator() ? button("page_invite", async () => {
    const answer = await link.ask("invite");
    if (!answer.ok) return toast(words.tell(answer), true);
    const lines = answer.operator ? [["page_code_operator", answer.operator], ["page_code_viewer", answer.viewer]].flatMap(([code, value]) => [element("p", {}, say(code)), element("p", { class: "code" }, value)]) : [element("p", { class: "muted" }, say("page_only_here"))];
    show(say("page_invite"), ...answer.addresses.map((one) => element("p", {}, element("a", { href: one }, one))), ...lines, closeButton());
  }) : null;
  const leave = hello.login ? button("page_leave", async () => { await fetch("logout", { method: "POST" }); location.reload(); }) : null;
  show(say("page_settings"), languages, invite, leave, closeButton());
}

async function logIn(code) {
  const answer = await fetch("login", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ code }) });
  if (answer.ok) { $("login").hidden = true; link.connect(); }
  else $("login-answer").textContent = say(answer.status === 429 ? "page_too_many_codes" : "page_wrong_code");
}

window.virtualBorders = { map, draft: () => draft, view };  // for tests and the console
await words.load(language());
const link = new Link(
  (sections) => {
    Object.assign(view, sections);
    for (const name of Object.keys(DRAW)) if (name in sections) DRAW[name](sections[name]);
  },
  async (found) => {
    Object.assign(hello, found);
    document.body.dataset.role = hello.role;
    online = true;
    $("login").hidden = true;
    if (words.language !== language()) await words.load(language());
    drawAll();
    map.fit();
  },
  () => { online = false; drawState(); drawBanners(); map.live = false; },
  (session) => {
    document.body.dataset.role = session.role;
    if (session.role !== "nobody") return;
    $("login").hidden = false;
    $("login").querySelector("form").classList.toggle("closed", !session.login);
    $("login-text").textContent = say(session.login ? "page_login_help" : "page_only_local");
    for (const part of $("login").querySelectorAll("label, button")) part.hidden = !session.login;
    const code = new URLSearchParams(location.hash.slice(1)).get("code");
    if (code) { history.replaceState(null, "", location.pathname); logIn(code); }
  });

$("login").querySelector("form").addEventListener("submit", (event) => { event.preventDefault(); logIn(event.target.elements.code.value); });
$("stop").addEventListener("click", () => ask("command", { command: $("stop").dataset.command || "stop" }));
$("settings-button").addEventListener("click", settings);
$("draw").addEventListener("click", () => setMode("draw"));
$("wall").addEventListener("click", () => setMode("wall"));
for (const change of ["undo", "redo"]) $(change).addEventListener("click", async () => {
  // whoever taps twice wants two steps, and is not told that the first is still under way
  $("undo").disabled = $("redo").disabled = true;
  await ask("command", { command: change });
  $("undo").disabled = $("redo").disabled = false;
});
$("zoom-in").addEventListener("click", () => map.zoom(1.4));
$("zoom-out").addEventListener("click", () => map.zoom(1 / 1.4));
$("zoom-fit").addEventListener("click", () => map.fit());
$("floor-button").addEventListener("click", () => setFloor(!floorOn));
$("study-form").addEventListener("submit", (event) => { event.preventDefault(); const { participant, condition } = event.target.elements; ask("study", { participant: participant.value, condition: condition.value }, "page_noted"); });
$("mark-form").addEventListener("submit", async (event) => { event.preventDefault(); const text = event.target.elements.text; if ((await ask("mark", { text: text.value || say("page_mark") }, "page_noted")).ok) text.value = ""; });
$("health").addEventListener("toggle", () => { if (!$("health").open) watch(""); });
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  if ($("dialog").open) $("dialog").close();
  else if (mode !== "look") setMode("look");
});
$("dialog").addEventListener("close", () => { document.querySelector("main").inert = false; });
