// Dialogs, and what Escape and a phone's Back do. Dialogs are not modal, because stop must be in reach all the time.
"use strict";
import { page, sentence } from "./state.js";
import { $, button, element, lock } from "./elements.js";

// The part of the page below a dialog: whether it has unsaved changes, and how it is left. The editor fills this in.
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
  // not the first field: a phone's keyboard would come up at once
  $("dialog-title").focus();
}

// Calls `next` with the answer to a dialog's request, unless the dialog was closed or replaced meanwhile.
export async function whenAnswered(promise, next) {
  const title = $("dialog-title");
  const answer = await promise;
  if ($("dialog").open && $("dialog-title") === title) next(answer);
}

export const closeButton = (code = "page_close") => button(code, () => leave());

// Leaves a dialog or a drawing for what follows, and asks first if something unsaved would be lost. A dialog's `unsaved`
// returns null, or the function that brings the dialog back from that question.
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

// Closes what lies on top, by Escape or by a phone's Back, which leaves the page only if nothing does.
function goBack() {
  if ($("dialog").open) $("dialog").onBack();
  else if (page.mode !== "look")
    leave(() => {
      $("dialog").close();
      below.leave();
    });
}

// Adds an entry to the history for what lies on top, so that a phone's Back does not leave the page.
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
  // the event comes after the dialog was closed, when another one may be open
  if ($("dialog").open) return;
  document.querySelector("main").inert = false;
  lock(document.querySelector("main"));
});
