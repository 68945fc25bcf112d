// Dialogs, which are not modal: stop has to be in reach all the time; and what Escape and a phone's Back do.
"use strict";
import { page, say } from "./state.js";
import { $, button, element, lock } from "./ui.js";

// What a dialog lies on: whether something unsaved is there, and how it is left.
export const below = { isChanged: () => false, leave: () => {} };

export function show(title, ...children) {
  const dialog = $("dialog");
  dialog.replaceChildren(
    element("h2", { id: "dialog-title", tabindex: -1 }, ...[title].flat()),
    ...children.filter(Boolean),
  );
  Object.assign(dialog, { unsaved: () => null, onBack: leave });
  // not modal: stop has to be in reach all the time
  if (!dialog.open) dialog.show();
  lock(dialog);
  keepBack();
  document.querySelector("main").inert = true;
  // else a phone's keyboard comes up at once
  $("dialog-title").focus();
}

// Goes on when what a dialog asked for is answered, unless it was closed or another one has come up meanwhile.
export async function whenAnswered(asked, next) {
  const title = $("dialog-title"),
    answer = await asked;
  if ($("dialog").open && $("dialog-title") === title) next(answer);
}

export const closeButton = (code = "page_close") => button(code, () => leave());

// Goes on to what follows a dialog or a drawing, and asks first if something unsaved would be lost: `unsaved` of a dialog
// returns null, or what brings it back, as Back does from the question.
export function leave(next = () => $("dialog").close()) {
  const again = $("dialog").open ? $("dialog").unsaved() : below.isChanged() ? () => $("dialog").close() : null;
  if (!again) return next();
  show(
    say("page_unsaved"),
    element(
      "div",
      { class: "row" },
      button("page_discard_change", next, "danger"),
      button("page_continue", again, "primary"),
    ),
  );
  $("dialog").onBack = again;
}

// What lies on top goes by Escape and by a phone's Back, which leaves the page only when there is nothing.
function goBack() {
  if ($("dialog").open) $("dialog").onBack();
  else if (page.mode !== "look")
    leave(() => {
      $("dialog").close();
      below.leave();
    });
}

export function keepBack() {
  if (!history.state && ($("dialog").open || page.mode !== "look")) history.pushState("on top", "");
}

window.addEventListener("popstate", () => {
  if (!history.state) {
    goBack();
    keepBack();
  }
});

document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") goBack();
});

$("dialog").addEventListener("close", () => {
  // the event comes later than the closing: another dialog may have come up
  if ($("dialog").open) return;
  document.querySelector("main").inert = false;
  lock(document.querySelector("main"));
});
