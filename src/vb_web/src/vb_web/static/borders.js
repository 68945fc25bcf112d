// The list of borders, and what can be done with one.
"use strict";
import { closeButton, leave, show, whenAnswered } from "./dialog.js";
import { draft, edit, map } from "./editor.js";
import { hello, operator, row, say, view, words } from "./state.js";
import { $, ask, button, element, fill, nameField, toast } from "./ui.js";

// Why a border is not in force; "" if it is.
function idle(border) {
  const code = !border.enabled
    ? "page_reason_disabled"
    : border.reason && !border.in_force
      ? `page_reason_${border.reason}`
      : "";
  return code && say(words.has(code) ? code : border.reason);
}

// How that is drawn, on the map and in the list.
const idleLook = (border) => (idle(border) ? "off" : "");

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
  return [unkept, first, waiting, kind, only].filter(Boolean).join(" · ");
}

export function drawBorders() {
  if (!view.borders) return;
  const { list } = view.borders;
  map.setBorders(
    list.map((border) => ({ ...border, idle: idleLook(border), note: idle(border) })),
    draft && draft.border,
  );
  fill(
    $("borders"),
    !list.length
      ? [element("li", { class: "muted" }, say("page_no_borders"))]
      : list.map((border) => {
          const toggle = element("button", {
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

export function borderDialog(id, typed = null) {
  const find = () => view.borders.list.find((one) => one.id === id);
  const border = find();
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
  const change = (asked) =>
    whenAnswered(asked, ({ ok, code }) => {
      if (ok) $("dialog").close();
      // somebody else's change is told and shown before it is built upon
      else if (code === "revision_conflict") borderDialog(id, name.value);
    });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!name.value.trim()) toast(say("page_name_empty"), true);
    else if (name.value === words.border(border.name)) $("dialog").close();
    else change(ask("rename", { ...target, name: name.value }, "page_renamed"));
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
            edit(find() || border); // as it is now: the dialog may have been open for long
          }),
        "primary",
      ),
    ),
    form,
    element(
      "div",
      { class: "row" },
      button(border.enabled ? "page_switch_off" : "page_switch_on", () => leave(() => change(toggleBorder(border)))),
      button("page_remove", () => change(ask("remove", target, "page_removed", { border: border.name })), "danger"),
    ),
    closeButton(),
  );
  $("dialog").unsaved = () => (name.value === words.border(border.name) ? null : () => borderDialog(id, name.value));
}
