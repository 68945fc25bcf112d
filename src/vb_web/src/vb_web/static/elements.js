// Elements, requests and their answers, of which every part of the page is made.
"use strict";
import { page, promptCode, sentence, view, words } from "./state.js";

export const $ = (id) => document.getElementById(id);
const CHANGES = ["add", "update", "rename", "enable", "remove"]; // actions that undo takes back
const NAME_LENGTH = 60;

// Makes an element. A true attribute has no value; false, null and undefined leave an attribute or a child out.
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

// Replaces an element's content if it has changed, as a button that is replaced under a finger is never pressed. What has
// the focus keeps it, by its data-key. A field that is being typed into stays, with its caret and half a number.
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

// Empties the toast if the page already says the same elsewhere, for instance as a notice.
export function dropRepeatedToast() {
  const codes = [...(view.notices || []).map((notice) => notice.code), promptCode(), !page.online && "page_offline"];
  if ($("laser-refused").textContent) codes.push(view.state.last.code);
  const { code } = $("toast").dataset; // "" if the toast is not an answer
  if (code && codes.includes(code)) $("toast").textContent = "";
}

const LOCKED_MS = 400;
const unlockTimers = new Map(); // by part; an animation would stand still in a page that is not painted

// Locks a part of the page for a moment: a second tap at once, as people zoom a picture, presses nothing that the first
// one has brought up or uncovered.
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

// Asks for an action and shows the answer, with the sentence of `doneCode` and its values if the action succeeded.
export async function ask(action, fields, doneCode = null, values = {}) {
  // a command is void after a stop that was not shown here yet
  const shownStop = (view.state && view.state.stop_number) || "";
  const seen = action === "command" ? { seen_stop: fields.command === "stop" ? "" : shownStop } : {};
  // undo and redo mean the borders as they are shown: pressed again after these have changed, they mean the next change
  const subject = ["undo", "redo"].includes(fields.command) ? (view.borders || {}).revision : null;
  const answer = await page.link.ask(action, { ...fields, ...seen }, subject);
  if (answer.ok && doneCode)
    toast(
      sentence(doneCode, values),
      false,
      "",
      CHANGES.includes(action) ? button("page_undo", () => ask("command", { command: "undo" })) : null,
    );
  else if (!answer.ok || action === "command") toast(words.tell(answer), !answer.ok, answer.code);
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

// Makes a labelled choice. The codes of its words are `code` and, for an option, `code` with the option's name.
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
