// Dialogs, and what Escape and a phone's Back do. Dialogs are not modal, because Stop must always be within reach.
"use strict";
import { page, sentence } from "./state.js";
import { $, button, element, lock } from "./elements.js";

// The part of the page below a dialog: whether it has unsaved changes, and how to leave it. The editor sets this.
export const below = { isChanged: () => false, leave: () => {} };

export function show(title, ...children) {
  const dialog = $("dialog");
  dialog.replaceChildren(
    element("h2", { id: "dialog-title", tabindex: -1 }, ...[title].flat()),
    ...children.filter(Boolean),
  );
  Object.assign(dialog, { unsaved: () => null, onBack: leave });
  if (!dialog.open) dialog.show();
  lock(dialog);
  closeOnBack();
  document.querySelector("main").inert = true;
  // the focus is not on the first field, because a phone's keyboard would then appear at once
  $("dialog-title").focus();
}

// Calls `next` with the answer to a dialog's request, unless the dialog was closed or replaced meanwhile.
export async function whenAnswered(promise, next) {
  const title = $("dialog-title");
  const answer = await promise;
  if ($("dialog").open && $("dialog-title") === title) next(answer);
}

export const closeButton = (code = "page_close") => button(code, () => leave());

// Leaves a dialog or a drawing, and then calls what follows. Asks first if something unsaved would be lost. A dialog's
// function `unsaved` returns null, or a function that shows the dialog again after that question.
export function leave(next = () => $("dialog").close()) {
  let comeBack = null;
  if ($("dialog").open) comeBack = $("dialog").unsaved();
  else if (below.isChanged()) comeBack = () => $("dialog").close();
  if (!comeBack) return next();
  show(
    sentence("page_unsaved"),
    element(
      "div",
      { class: "row" },
      button("page_discard_change", next, "danger"),
      button("page_continue", comeBack, "primary"),
    ),
  );
  $("dialog").onBack = comeBack;
}

// Closes the topmost dialog or drawing, on Escape or a phone's Back. Back leaves the page only if there is none.
function goBack() {
  if ($("dialog").open) $("dialog").onBack();
  else if (page.mode !== "look")
    leave(() => {
      $("dialog").close();
      below.leave();
    });
}

// Adds an entry to the browser's history for the topmost dialog or drawing, so that Back does not leave the page.
export function closeOnBack() {
  if (!history.state && ($("dialog").open || page.mode !== "look")) history.pushState("on top", "");
}

window.addEventListener("popstate", () => {
  if (!history.state) {
    goBack();
    closeOnBack();
  }
});

document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") goBack();
});

$("dialog").addEventListener("close", () => {
  // the event comes later than the dialog was closed, and another one may already be open
  if ($("dialog").open) return;
  document.querySelector("main").inert = false;
  lock(document.querySelector("main"));
});
