// Makes elements and sends requests: functions that every part of the page uses.
"use strict";
import { page, promptCode, sentence, view, words } from "./state.js";

export const $ = (id) => document.getElementById(id);
const CHANGES = ["add", "update", "rename", "enable", "remove"]; // actions that can be undone
const NAME_LENGTH = 60;

// Makes an element. An attribute that is true has no value. If an attribute or a child is false, null or undefined, it
// is left out.
export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  if (tag === "button") node.type = "button";
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "onclick") node.addEventListener("click", value);
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

export const button = (code, onclick, kind = "", attributes = {}) =>
  element("button", { class: kind, onclick, ...attributes }, sentence(code));

export const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

const contents = new WeakMap(); // the HTML that `replaceContent` has put into each parent

// Replaces an element's content, but only if it has changed: a button that is replaced under a finger cannot be
// pressed. The focus moves to the new element with the same data-key. A field into which somebody types is not
// replaced, so that it keeps its caret and what was typed.
export function replaceContent(parent, children) {
  const nodes = children.filter(Boolean);
  const html = nodes.map((node) => node.outerHTML).join("");
  if (contents.get(parent) === html) return;
  contents.set(parent, html);
  const focused = parent.contains(document.activeElement) ? document.activeElement : parent;
  const key = `[data-key="${CSS.escape(focused.dataset.key || "")}"]`;
  const index = nodes.findIndex((node) => node.matches(key) || node.querySelector(key));
  if (index >= 0 && focused.matches("input")) {
    const kept = [...parent.children].find((child) => child.contains(focused));
    for (const child of [...parent.children]) if (child !== kept) child.remove();
    kept.before(...nodes.slice(0, index));
    kept.after(...nodes.slice(index + 1));
    return;
  }
  parent.replaceChildren(...nodes);
  if (index >= 0) parent.querySelector(key).focus({ preventScroll: true });
}

// Empties the toast if another part of the page says the same, for instance a notice.
export function dropRepeatedToast() {
  const codes = [...(view.notices || []).map((notice) => notice.code), promptCode(), !page.online && "page_offline"];
  if ($("laser-refused").textContent) codes.push(view.state.last.code);
  const { code } = $("toast").dataset; // "" if the toast is not an answer
  if (code && codes.includes(code)) $("toast").textContent = "";
}

const LOCKED_MS = 400;
const unlockTimers = new Map(); // by part; not an animation, which would stand still while the page is not painted

// Locks a part of the page for a moment. A second tap right after the first, such as in a double tap, then cannot press
// a button that the first tap has brought up or uncovered.
export function lock(part) {
  clearTimeout(unlockTimers.get(part));
  part.classList.add("locked");
  unlockTimers.set(
    part,
    setTimeout(() => part.classList.remove("locked"), LOCKED_MS),
  );
}

let toastTimer = 0;

// Shows a text for some seconds, with a button if one is given, or empties the toast. `code` is that of an answer.
export function toast(text, bad = false, code = "", action = null) {
  clearTimeout(toastTimer);
  lock($("line"));
  $("toast").replaceChildren(...(text ? [element("span", {}, text), action].filter(Boolean) : []));
  $("toast").dataset.code = code;
  dropRepeatedToast();
  $("toast").classList.toggle("bad", bad);
  if (text) toastTimer = setTimeout(() => toast(""), bad || action ? 9000 : 4500);
}

// Asks for an action and shows the answer. If the action succeeded, that is the sentence of `doneCode` with `values`.
export async function ask(action, fields, doneCode = null, values = {}) {
  const allFields = { ...fields };
  if (action === "command") {
    // a command is void after a stop that this page has not shown yet
    const shownStop = (view.state && view.state.stop_number) || "";
    allFields.seen_stop = fields.command === "stop" ? "" : shownStop;
  }
  // undo and redo apply to the borders that are shown: pressed again after these have changed, they are new requests
  const subject = ["undo", "redo"].includes(fields.command) ? (view.borders || {}).revision : null;
  const answer = await page.link.ask(action, allFields, subject);
  if (answer.ok && doneCode) {
    const undoButton = button("page_undo", () => ask("command", { command: "undo" }));
    toast(sentence(doneCode, values), false, "", CHANGES.includes(action) ? undoButton : null);
  } else if (!answer.ok || action === "command") toast(words.tell(answer), !answer.ok, answer.code);
  return answer;
}

export function issueLines(issues) {
  return (issues || []).map((issue) =>
    element("p", { class: `issue ${issue.severity ? "error" : ""}` }, words.tell(issue)),
  );
}

export const areaLine = (area) =>
  element("p", { class: "figures" }, element("b", {}, `${words.number(area, 2)} m²`), ` ${sentence("page_area")}`);

export function nameField(value, placeholder = "") {
  const field = element("input", {
    maxlength: NAME_LENGTH,
    value,
    placeholder,
    "data-key": "name",
    autocomplete: "off",
  });
  field.addEventListener("input", () => {
    if (field.value.length === NAME_LENGTH) toast(sentence("page_name_long", { count: NAME_LENGTH }), true);
  });
  return field;
}

// Makes a choice with a label. The label's code is `code`, and that of an option is `code` with the option's name.
export function select(code, value, options, onchange) {
  const choice = element(
    "select",
    { "data-key": code },
    ...options.map((option) =>
      element("option", { value: option, selected: option === value }, sentence(`${code}_${option}`)),
    ),
  );
  choice.addEventListener("change", () => onchange(choice.value));
  return element("label", {}, element("span", {}, sentence(code)), choice);
}
