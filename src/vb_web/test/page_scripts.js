// What the page's tests do or measure in the page itself. page_rig.py's `run_script` calls these functions by name.

const centerOf = ({ left, top, width, height }) => [left + width / 2, top + height / 2];
const buttonAt = (point) => document.elementFromPoint(...point).closest("button");

// ------------------------------------------------------------- drawing and editing
/** Gives commands twice at one revision of the borders and once at the next. Returns what was sent to the server. */
async function giveCommandsAtRevisions() {
  const { page, view } = await import("/state.js");
  const { ask } = await import("/elements.js");
  const send = page.link.send;
  const sent = [];
  page.link.send = (action, fields) => {
    sent.push(fields.command || action);
    return new Promise(() => {});
  };
  for (const revision of [1, 1, 2]) {
    view.borders = { ...view.borders, revision };
    for (const command of ["undo", "save", "stop"]) ask("command", { command });
    ask("add", { draft: {} });
  }
  page.link.send = send;
  page.link.underWay.clear();
  return sent;
}

/**
 * Answers requests late: each when the person already does something else.
 * Returns the names in the previews that were asked for, the mode after each answer, and whether a dialog is open.
 */
async function answerLate() {
  const { draft, map, view } = window.virtualBorders;
  const [border] = view.borders.list;
  const { page } = await import("/state.js");
  const { edit, previewDraft, setMode } = await import("/editor.js");
  const press = (selector) => [...document.querySelectorAll(selector)].pop().click();
  // an earlier preview may still be under way
  while (page.link.waiting.size) await new Promise((next) => setTimeout(next, 20));
  const asked = [];
  page.link.send = (_action, fields) => new Promise((resolve) => asked.push({ fields, resolve }));
  const answer = (request) => {
    request.resolve({ ok: true, code: "ok", values: {}, area: 1, issues: [] });
    return new Promise((next) => setTimeout(next));
  };
  edit(border);
  for (draft().name of ["a", "b"]) previewDraft();
  for (const request of asked) await answer(request);
  const previews = asked.splice(0).map(({ fields }) => fields.draft.name);
  const modes = [];
  for (const [ask, begin] of [
    [() => press("#review button"), () => edit(border)],
    [() => (setMode("go"), map.on.tap([3, 1])), () => setMode("go")],
    [() => (press("#borders .name"), press("#dialog .danger")), () => press("#settings-button")],
  ]) {
    ask();
    setMode("look");
    begin();
    await answer(asked.splice(0)[0]);
    modes.push(page.mode);
    setMode("look");
  }
  return [previews, modes, document.getElementById("dialog").open];
}

/**
 * Moves a corner, removes it with the key Delete, and draws a new one beyond the middle at once, as a quick finger does.
 * Returns whether the corner is gone, and whether the seed is inside after the removal and at the end.
 */
async function changeCorners() {
  const { map, draft } = window.virtualBorders;
  const { inside } = await import("/shapes.js");
  map.on.drag(2, [6.5, 3.0], true);
  map.on.choose(0);
  const key = new KeyboardEvent("keydown", { key: "Delete", bubbles: true });
  document.querySelector("[data-corner='2']").dispatchEvent(key);
  const isGone = draft().points.every(([x]) => x < 6);
  const isInsideAfterRemoval = inside(draft().seed, draft().points);
  map.on.between(0, [3.5, 1.7]);
  return [isGone, isInsideAfterRemoval, inside(draft().seed, draft().points)];
}

/** Renders the form again while a part of the name is selected. Returns whether it is the same field, text, selection. */
function renderFormAgain() {
  const { map, draft } = window.virtualBorders;
  const before = document.querySelector("#review input");
  before.focus();
  before.value = draft().name = "Rug";
  before.setSelectionRange(1, 2);
  map.on.choose(1);
  const now = document.activeElement;
  return [now === before, now.value, now.selectionStart, now.selectionEnd];
}

/** Presses the dialog's last button, and Escape at once. Returns whether the page below the new dialog is inert. */
function closeAndReopenDialog() {
  [...document.querySelectorAll("#dialog button")].pop().click();
  document.dispatchEvent(new KeyboardEvent("keydown", { key: "Escape" }));
  return new Promise((done) => setTimeout(() => done(document.querySelector("main").inert), 0));
}

/** Closes the dialog. Returns the button that then takes a press at the centre of the map's last tool. */
function uncoverButton() {
  const button = document.querySelector("#map-tools button:last-child");
  button.scrollIntoView({ block: "center" });
  const center = centerOf(button.getBoundingClientRect());
  const dialog = document.getElementById("dialog");
  return new Promise((done) => {
    dialog.addEventListener("close", () => done(buttonAt(center)), { once: true });
    dialog.close();
  });
}

/** Returns the lengths [m] that a drawing shows. */
const shownLengths = () =>
  [...document.querySelectorAll("#placed .length")].map((text) => parseFloat(text.textContent));

/** Returns the lengths [m] of the two sides at the drawing's first corner. */
function sidesAtFirstCorner() {
  const { points } = window.virtualBorders.draft();
  const [x0, y0] = points[0];
  return [points[1], points[points.length - 1]].map(([x, y]) => Math.hypot(x - x0, y - y0));
}

// ------------------------------------------------------------- what is seen
/** Returns whether an element can be seen at the middle of its upper and lower edge. */
function isUncovered(selector) {
  const element = document.querySelector(selector);
  const { left, width, top, bottom } = element.getBoundingClientRect();
  return [top + 2, bottom - 2].every((y) => document.elementFromPoint(left + width / 2, y) === element);
}

/** Returns whether the field with the focus can be seen. */
function isFocusInView() {
  const { left, top, height } = document.activeElement.getBoundingClientRect();
  return document.elementFromPoint(left + 20, top + height / 2) === document.activeElement;
}

/** Returns these style properties of each element of a selector and of its children, as one text for each element. */
function stylesOf(selector, properties) {
  const styleOf = (part) => properties.map((name) => getComputedStyle(part)[name]).join();
  return [...document.querySelectorAll(selector)].map((element) => [element, ...element.children].map(styleOf).join());
}

/** Returns the command buttons without the spoken command below; "Pause" is the same in both languages. */
const commandsWithoutWords = () =>
  [...document.querySelectorAll("#commands button")].filter(
    (button) => !button.querySelector("small") && button.textContent.toLowerCase() !== button.dataset.command,
  );

/** Shortens the wait of 8 s before another try to connect to 2 s, and counts the tries in window.asked. */
function hurryAndCountTries() {
  const wait = window.setTimeout;
  const ask = window.fetch;
  window.asked = 0;
  window.setTimeout = (work, time) => wait(work, time === 8000 ? 2000 : time);
  window.fetch = (...given) => ask(...given, ++window.asked);
}

// ------------------------------------------------------------- the map
/** Returns the length [m] that the scale says, and that of its bar. */
function scaleLengths() {
  const { map } = window.virtualBorders;
  map.layOut();
  const bar = document.getElementById("scale");
  return [parseFloat(bar.textContent), bar.getBoundingClientRect().width / map.view.scale];
}

/** Returns whether the map covers the centre of its frame. */
function isMapAtCenter() {
  const { map } = window.virtualBorders;
  const [width, height] = map.size();
  const [x0, x1, y0, y1] = map.box;
  const [left, top] = map.toScreen([x0, y1]);
  const [right, bottom] = map.toScreen([x1, y0]);
  return left < width / 2 && right > width / 2 && top < height / 2 && bottom > height / 2;
}

/** Shows borders with these lines [m], by name. */
function showBorders(lines) {
  const borders = Object.entries(lines).map(([name, line]) => ({
    id: name,
    mark: name,
    name: `A name of some length: ${name}`,
    note: "",
    area: 1,
    points: line.flat().map((value) => 100 * value),
    kind: line.length > 2 ? "polygon" : "wall",
  }));
  window.virtualBorders.map.setBorders(borders, "");
}

/** Moves the map. Returns each border's id, and text and box of its label and mark, as far as these are shown. */
function labelsInView(view) {
  const { map } = window.virtualBorders;
  map.view = { ...map.view, ...view };
  map.layOut();
  const isSeen = (text) => text.getClientRects().length && getComputedStyle(text).visibility !== "hidden";
  return [...document.querySelectorAll("#placed .name")].map((group) => {
    const texts = [...group.querySelectorAll(":scope > text, .mark")].filter(isSeen);
    return [group.border.id, ...texts.map((text) => [text.textContent, text.getBoundingClientRect().toJSON()])];
  });
}

/** Offers the floor's picture, switches it off, and connects again. Returns the button's state after each step. */
async function switchFloorOff() {
  const { view } = window.virtualBorders;
  const button = document.getElementById("floor-button");
  const { hello, page } = await import("/state.js");
  const { link } = page;
  const section = { map: { ...view.map, floor: 4 } };
  const pressed = [];
  for (const next of [() => {}, () => button.click(), () => link.onHello({ ...hello })]) {
    next();
    link.onView(section);
    pressed.push(button.getAttribute("aria-pressed"));
  }
  return pressed;
}

// ------------------------------------------------------------- Stop
const stopBox = () => document.getElementById("stop").getBoundingClientRect();

/** Returns left, top, width, height of Stop in screen coordinates: relative to the visual viewport, times its scale. */
function placeOfStop() {
  const { scale, offsetLeft, offsetTop } = visualViewport;
  const { left, top, width, height } = stopBox();
  return [(left - offsetLeft) * scale, (top - offsetTop) * scale, width * scale, height * scale];
}

/** Returns the id of the button that takes a press on Stop. */
const buttonOnStop = () => buttonAt(centerOf(stopBox())).id;

/** Returns the gap [px] of the screen between Stop and Resume, 0 unless all of Resume is on the screen. */
function gapBesideStop() {
  const stop = stopBox();
  const resume = document.getElementById("resume").getBoundingClientRect();
  const { scale, offsetLeft, offsetTop, width, height } = visualViewport;
  const isWithinWidth = resume.left >= offsetLeft && resume.right <= offsetLeft + width;
  const isWithinHeight = resume.top >= offsetTop && resume.bottom <= offsetTop + height;
  const across = Math.max(stop.left - resume.right, resume.left - stop.right);
  const down = Math.max(stop.top - resume.bottom, resume.top - stop.bottom);
  return isWithinWidth && isWithinHeight ? scale * Math.max(across, down) : 0;
}
