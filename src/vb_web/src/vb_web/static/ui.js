// What every part of the page is made of: elements, answers and requests.
"use strict";
import { page, prompt, say, view, words } from "./state.js";

export const $ = (id) => document.getElementById(id);
const CHANGES = ["add", "update", "rename", "enable", "remove"]; // what undo takes back
const NAME_LENGTH = 60;

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  if (tag === "button") made.type = "button";
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "onclick") made.addEventListener("click", value);
    else if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export const button = (code, onclick, kind = "", attributes = {}) =>
  element("button", { class: kind, onclick, ...attributes }, say(code));

export const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

// Replaces a list's content if it changed: a button that is replaced under a finger is never pressed. What has the focus
// keeps it, by data-key; a field that is being typed into stays, with its caret and half a number.
const filled = new WeakMap();

export function fill(parent, children) {
  const made = children.filter(Boolean);
  const text = made.map((child) => child.outerHTML).join("");
  if (filled.get(parent) === text) return;
  filled.set(parent, text);
  const focused = parent.contains(document.activeElement) ? document.activeElement : parent;
  const key = `[data-key="${CSS.escape(focused.dataset.key || "")}"]`;
  const at = made.findIndex((child) => child.matches(key) || child.querySelector(key));
  if (at >= 0 && focused.matches("input")) {
    const kept = [...parent.children].find((child) => child.contains(focused));
    for (const child of [...parent.children]) if (child !== kept) child.remove();
    kept.before(...made.slice(0, at));
    kept.after(...made.slice(at + 1));
    return;
  }
  parent.replaceChildren(...made);
  if (at >= 0) parent.querySelector(key).focus({ preventScroll: true });
}

// An answer that stands on the page, for instance as a notice, is not said twice.
export function dropStanding() {
  const standing = [...(view.notices || []).map((notice) => notice.code), prompt(), !page.online && "page_offline"];
  if ($("laser-refused").textContent) standing.push(view.state.last.code);
  const { code } = $("toast").dataset; // none where it is no answer
  if (code && standing.includes(code)) $("toast").textContent = "";
}

// A second tap at once, as one zooms a picture, presses nothing that the first has brought up or uncovered.
const LOCKED_MS = 400;
const unlocking = new Map(); // part: the timer that ends its lock; an animation would stand still in a page that is not painted

export function lock(part) {
  clearTimeout(unlocking.get(part));
  part.classList.add("locked");
  unlocking.set(
    part,
    setTimeout(() => part.classList.remove("locked"), LOCKED_MS),
  );
}

let toastTimer = 0;

export function toast(text, bad = false, code = "", more = null) {
  clearTimeout(toastTimer);
  lock($("line"));
  $("toast").replaceChildren(...(text ? [element("span", {}, text), more].filter(Boolean) : []));
  $("toast").dataset.code = code;
  dropStanding();
  $("toast").classList.toggle("bad", bad);
  if (text) toastTimer = setTimeout(() => toast(""), bad || more ? 9000 : 4500);
}

export async function ask(action, fields, done = null, values = {}) {
  // a command is void after a stop that was not shown here yet
  const shown = (view.state && view.state.stop_number) || "";
  const seen = action === "command" ? { seen_stop: fields.command === "stop" ? "" : shown } : {};
  // undo and redo are about the borders as they are shown: pressed again once these have changed, they mean the next change
  const about = ["undo", "redo"].includes(fields.command) ? (view.borders || {}).revision : null;
  const answer = await page.link.ask(action, { ...fields, ...seen }, about);
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

export function issues(list) {
  return (list || []).map((one) => element("p", { class: `issue ${one.severity ? "error" : ""}` }, words.tell(one)));
}

export const figures = (area) =>
  element("p", { class: "figures" }, element("b", {}, `${words.number(area, 2)} m²`), ` ${say("page_area")}`);

export function nameField(value, placeholder = "") {
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

export function select(code, value, options, onchange) {
  const made = element(
    "select",
    { "data-key": code },
    ...options.map((one) => element("option", { value: one, selected: one === value }, say(`${code}_${one}`))),
  );
  made.addEventListener("change", () => onchange(made.value));
  return element("label", {}, element("span", {}, say(code)), made);
}
