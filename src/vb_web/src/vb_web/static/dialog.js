// Dialogs, which are not modal so that Stop stays within reach; and the effect of Escape and a phone's Back.
"use strict";
import { page, say } from "./state.js";
import { $, button, element, lock } from "./ui.js";

// The activity below a dialog: whether it has unsaved work, and how to leave it.
export const below = { isChanged: () => false, leave: () => {} };

export function show(title, ...children) {
  const dialog = $("dialog");
  dialog.replaceChildren(
    element("h2", { id: "dialog-title", tabindex: -1 }, ...[title].flat()),
    ...children.filter(Boolean),
  );
  Object.assign(dialog, { unsaved: () => null, onBack: leave });
  // not modal, so that Stop stays within reach
  if (!dialog.open) dialog.show();
  lock(dialog);
  keepBack();
  document.querySelector("main").inert = true;
  // otherwise a phone's keyboard would appear at once
  $("dialog-title").focus();
}

// Continues when a dialog's request is answered, unless the dialog was closed or replaced meanwhile.
export async function whenAnswered(asked, next) {
  const title = $("dialog-title"),
    answer = await asked;
  if ($("dialog").open && $("dialog-title") === title) next(answer);
}

export const closeButton = (code = "page_close") => button(code, () => leave());

// Leaves a dialog or a drawing, and asks first if unsaved work would be lost: a dialog's `unsaved` returns null, or a
// function that reopens the dialog, for instance when Back leaves the question.
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

// Escape and a phone's Back close the topmost dialog; Back leaves the page only if none is open.
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
  // the event comes after the closing, when another dialog may be open
  if ($("dialog").open) return;
  document.querySelector("main").inert = false;
  lock(document.querySelector("main"));
});
