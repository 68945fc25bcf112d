// The list of borders, and the dialog for one border.
"use strict";
import { closeButton, leave, show, whenAnswered } from "./dialog.js";
import { draft, edit, map } from "./editor.js";
import { hello, isOperator, row, sentence, view, words } from "./state.js";
import { $, ask, button, element, replaceContent, nameField, toast } from "./elements.js";

// Says why a border is not in force. Returns "" if it is.
function idleReason(border) {
  if (!border.enabled) return sentence("page_reason_disabled");
  if (!border.reason || border.in_force) return "";
  const code = `page_reason_${border.reason}`;
  return sentence(words.has(code) ? code : border.reason);
}

// Returns the style class of a border on the map and in the list.
const idleClass = (border) => (idleReason(border) ? "off" : "");

const markOf = (border) => element("span", { class: `mark ${idleClass(border)}` }, border.mark);

// Says which zone a border is. Returns "" for the usual one, "keep out".
function zoneText(border) {
  const speed = words.number(border.max_speed, 2);
  if (row("zones", border.zone).limits_speed)
    return sentence(border.unkept ? "page_slow_meant" : "page_slow_at", { speed });
  return border.zone === hello.zones[0].name ? "" : sentence(`page_zone_${border.zone}`);
}

// Describes a border, for the line below its name: first any problem, then area, zone and robots.
function describe(border) {
  const size = border.kind === "wall" ? sentence("page_kind_wall") : `${words.number(border.area, 2)} m²`;
  const robots = border.robots.length ? sentence("page_only_for", { who: border.robots.join(", ") }) : "";
  const unkept = border.unkept && !idleReason(border) ? words.tell(border.unkept) : "";
  const waiting = border.in_force && border.reason && sentence(`page_reason_${border.reason}`);
  return [unkept, idleReason(border) || size, waiting, zoneText(border), robots].filter(Boolean).join(" · ");
}

export function drawBorders() {
  if (!view.borders) return;
  const { list } = view.borders;
  map.setBorders(
    list.map((border) => ({ ...border, idle: idleClass(border), note: idleReason(border) })),
    draft && draft.border,
  );
  replaceContent(
    $("borders"),
    !list.length
      ? [element("li", { class: "muted" }, sentence("page_no_borders"))]
      : list.map((border) => {
          const toggle = element("button", {
            class: "switch operator",
            role: "switch",
            "aria-checked": String(border.enabled),
            "aria-label": sentence("page_switch", { border: border.name }),
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
              words.border(border.name) || sentence("page_no_name"),
              element("small", { class: border.unkept && !idleReason(border) ? "ill" : "" }, describe(border)),
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

// Shows the dialog for a border, with a name that was typed before the dialog was left, if there is one.
export function borderDialog(id, typedName = null) {
  const find = () => view.borders.list.find((border) => border.id === id);
  const border = find();
  if (!border) return;
  const heading = [markOf(border), words.border(border.name) || sentence("page_no_name")];
  if (!isOperator()) return show(heading, element("p", { class: "muted" }, describe(border)), closeButton());
  const target = { border: id, revision: view.borders.revision };
  const name = nameField(typedName === null ? words.border(border.name) : typedName);
  name.addEventListener("focus", () => name.select());
  const form = element(
    "form",
    {},
    element("label", {}, element("span", {}, sentence("page_name")), name),
    button("page_rename", () => form.requestSubmit()),
  );
  const change = (promise) =>
    whenAnswered(promise, ({ ok, code }) => {
      if (ok) $("dialog").close();
      // a change that somebody else has made is shown first; only a second try overwrites it
      else if (code === "revision_conflict") borderDialog(id, name.value);
    });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!name.value.trim()) toast(sentence("page_name_empty"), true);
    else if (name.value === words.border(border.name)) $("dialog").close();
    else change(ask("rename", { ...target, name: name.value }, "page_renamed"));
  });
  show(
    heading,
    element("p", { class: "muted" }, describe(border)),
    element(
      "div",
      { class: "row" },
      button(
        "page_edit",
        () =>
          leave(() => {
            $("dialog").close();
            edit(find() || border); // the newest version, because the dialog may have been open for a long time
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
