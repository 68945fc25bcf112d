// The list of borders, and what can be done with one.
"use strict";
import { closeButton, leave, show } from "./dialog.js";
import { draft, draftFields, draftOf, edit, map } from "./editor.js";
import { DAYS, formatSchedule, parseSchedule, parseTime, scheduleText } from "./schedule.js";
import { pairs } from "./shapes.js";
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

export function drawBorders() {
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

export function borderDialog(id, typed = null) {
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
  // people who say when a border is in force want it switched on
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
