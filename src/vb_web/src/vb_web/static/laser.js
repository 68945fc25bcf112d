// The laser pointer's state and commands, and the banners.
"use strict";
import { closeButton, show, whenAnswered } from "./dialog.js";
import { map } from "./editor.js";
import {
  commandName,
  hello,
  isOperator,
  kindWord,
  isAvailable,
  page,
  promptCode,
  row,
  sentence,
  sourceName,
  view,
  words,
} from "./state.js";
import { $, areaLine, ask, button, clock, dropRepeatedToast, element, replaceContent, issueLines } from "./elements.js";

// Returns whether a command is what most people do next: save, or draw the parts that are missing.
const isNextStep = (command, available) =>
  command === "save" ||
  (command === "define_seed" && !available.has("save")) ||
  (command === "define_border" && view.state.name !== "default");

async function giveCommand(name) {
  if (name === "save" && view.preview && view.preview.available && !(view.state && view.state.confirm))
    return confirmSave();
  return ask("command", { command: name });
}

// Returns the content of a command's button: what it does now, and below, the spoken command if that is different.
function commandLabel(name) {
  if (name === "save" && view.state?.confirm) return [sentence("page_save_again")];
  const label = commandName(name);
  const { spoken } = row("commands", name);
  if (label.toLowerCase() === spoken) return [label];
  return [element("span", {}, label, element("small", {}, sentence("page_spoken", { command: spoken })))];
}

function confirmSave() {
  const preview = view.preview;
  const saveButton = button(
    preview.ok ? "page_save" : "page_try_save",
    () => whenAnswered(ask("command", { command: "save" }), () => $("dialog").close()),
    "primary",
  );
  show(
    sentence("page_title_review", kindWord("polygon")),
    preview.ok ? areaLine(preview.area) : element("p", { class: "issue error" }, words.tell(preview)),
    ...issueLines(preview.issues),
    element("div", { class: "row" }, closeButton("page_back"), saveButton),
  );
}

// Returns the name of the state that the page shows: that of the interaction, or one that says what is missing.
function stateName(hasManager) {
  if (!page.online) return "offline";
  // a lab without an interaction manager does not wait for one: the state is that of the robots
  if (view.capabilities && !view.capabilities.interaction && !hasManager)
    return view.capabilities.state === "ready" ? "default" : view.capabilities.state;
  return view.state && hasManager ? view.state.name : "absent";
}

// Returns the commands that have a button, in the buttons' order. If several commands share a button, the button shows
// the available one, or else the first.
function commandsWithButton(available) {
  const places = new Map();
  for (const { name, button_place } of hello.commands.filter((command) => command.button_place))
    if (available.has(name) || !places.has(button_place)) places.set(button_place, name);
  return [...places.keys()].sort((a, b) => a - b).map((place) => places.get(place));
}

// Returns the code of the sentence that says what people can do with the laser now.
function laserCode(hasManager) {
  if (!hasManager) return "page_manager_gone";
  if (!view.state) return "page_laser_absent";
  return promptCode() || "page_laser_default";
}

export function drawState() {
  const state = view.state;
  const hasManager = page.online && view.health?.manager;
  const isInteracting = hasManager && state && state.name !== "default";
  const name = stateName(hasManager);
  document.body.dataset.state = name;
  document.body.style.setProperty("--state", promptCode() ? row("states", name).color : "");
  const stopped = Boolean(page.online && state && state.stopped);
  document.body.classList.toggle("stopped", stopped);
  $("state-name").textContent = sentence(`page_state_${stopped ? "stopped" : name}`);
  $("stop").disabled = !page.online;
  $("stop").hidden = !isAvailable("stop");
  $("laser").hidden = (!state && !hasManager) || !isAvailable("define_border");
  $("go").hidden = !view.capabilities || !isAvailable("go");
  const available = new Set(hasManager && state ? state.available_commands.filter(isAvailable) : []);
  $("laser-text").textContent = sentence(laserCode(hasManager));
  // shows why nothing happened, even if the command was spoken or came from another phone
  const refused = isInteracting && state.last.command && !state.last.ok ? words.tell(state.last) : "";
  if ($("laser-refused").textContent !== refused) $("laser-refused").textContent = refused;
  replaceContent(
    $("commands"),
    commandsWithButton(available).map((command) =>
      element(
        "button",
        {
          "data-key": command,
          "data-command": command,
          disabled: !available.has(command),
          class: available.has(command) && isNextStep(command, available) ? "primary" : "",
          onclick: () => giveCommand(command),
        },
        ...commandLabel(command),
      ),
    ),
  );
  const preview = isInteracting && view.preview?.available ? view.preview : null;
  replaceContent(
    $("preview"),
    preview
      ? [
          preview.ok ? areaLine(preview.area) : element("p", { class: "issue error" }, words.tell(preview)),
          ...issueLines(preview.ok ? preview.issues : []),
        ]
      : [],
  );
  if (page.mode === "look") map.showPicture("region", preview && preview.region ? preview.region : "");
  dropRepeatedToast();
}

export function drawBanners() {
  const state = view.state;
  const list = [];
  const add = (kind, text, ...buttons) =>
    list.push(element("p", { class: kind }, element("span", {}, text), ...(isOperator() ? buttons : [])));
  if (!page.online) add("bad", sentence("page_offline"));
  else {
    // while somebody draws, only the state says this
    if (state && state.stopped && page.mode === "look")
      add("bad", sentence("page_stopped", { who: sourceName(state.stopped_by) }));
    // an interaction manager that hangs is connected but silent: the state that is shown is as old as its last message
    if (view.health && view.health.manager && view.health.silent)
      add("bad", sentence("page_state_old", { time: clock(view.health.silent) }));
    if (view.health && !view.health.integrator) add("bad", sentence("page_integrator_gone"));
    if (view.capabilities === null) add("bad", sentence("page_monitor_gone"));
    if (view.borders && view.borders.unconfirmed)
      add(
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
      add("", sentence("page_ends", { time: clock(state.ends_in_s) }));
  }
  replaceContent($("banners"), list); // nothing is replaced without a change, because a screen reader would read it out
}
