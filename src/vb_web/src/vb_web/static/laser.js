// The laser pointer: its state, commands and banners.
"use strict";
import { closeButton, show, whenAnswered } from "./dialog.js";
import { map } from "./editor.js";
import {
  commandName,
  hello,
  offers,
  operator,
  page,
  prompt,
  row,
  say,
  sourceName,
  view,
  what,
  words,
} from "./state.js";
import { $, ask, button, clock, dropStanding, element, figures, fill, issues } from "./ui.js";

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
    () => whenAnswered(ask("command", { command: "save" }), () => $("dialog").close()),
    "primary",
  );
  show(
    say("page_title_review", what("polygon")),
    preview.ok ? figures(preview.area) : element("p", { class: "issue error" }, words.tell(preview)),
    ...issues(preview.issues),
    element("div", { class: "row" }, closeButton("page_back"), go),
  );
}

export function drawState() {
  const state = view.state,
    there = page.online && view.health && view.health.manager;
  // where no manager belongs to the lab, nothing waits for one: the robots are what is ready or not
  const alone = view.offer && !view.offer.interaction && !there;
  const ready = alone && view.offer.state === "ready" ? "default" : alone && view.offer.state;
  const name = !page.online ? "offline" : ready || (!state || !there ? "absent" : state.name);
  document.body.dataset.state = name;
  document.body.style.setProperty("--state", prompt() ? row("states", name).color : "");
  const stopped = Boolean(page.online && state && state.stopped);
  document.body.classList.toggle("stopped", stopped);
  $("state-name").textContent = say(`page_state_${stopped ? "stopped" : name}`);
  $("stop").disabled = !page.online;
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
  if (page.mode === "look") map.picture("region", preview && preview.region ? preview.region : "");
  dropStanding();
}

export function drawBanners() {
  const state = view.state,
    list = [];
  const put = (kind, sentence, ...buttons) =>
    list.push(element("p", { class: kind }, element("span", {}, sentence), ...(operator() ? buttons : [])));
  if (!page.online) put("bad", say("page_offline"));
  else {
    // the person who draws is told by the state alone
    if (state && state.stopped && page.mode === "look")
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
        ].map(([code, same]) =>
          button(code, () => ask("confirm_map", { same, map_id: view.borders.map_id }, "page_noted")),
        ),
      );
    if (state && state.ends_in_s && state.name !== "default")
      put("", say("page_ends", { time: clock(state.ends_in_s) }));
  }
  fill($("banners"), list); // what is read out already is not read out again
}
