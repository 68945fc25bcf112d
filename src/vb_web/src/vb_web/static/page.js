// The page: shows the server's view as words and buttons, and turns what people press into requests.
"use strict";
import { borderDialog, drawBorders } from "./borders.js";
import { closeButton, show } from "./dialog.js";
import { draft, drawHint, drawReview, previewDraft, listeners, map, setMode } from "./editor.js";
import {
  drawGoals,
  drawEvents,
  drawHealth,
  drawNotices,
  floorOn,
  refreshFloor,
  setFloor,
  toggleWatching,
  watchedCameras,
} from "./status_panel.js";
import { drawBanners, drawState } from "./laser.js";
import { Link } from "./websocket.js";
import { hello, isOperator, page, sentence, view, words } from "./state.js";
import { $, ask, button, element, toast } from "./elements.js";

function drawAll() {
  drawHint();
  drawState();
  drawBanners();
  drawBorders();
  drawReview();
  drawNotices();
  drawHealth();
  drawEvents();
  drawGoals();
}

let wasFloorShown = false; // the floor is switched on automatically only once, in case somebody switches it off

// The functions that draw the parts of the page after a section of the view has changed, in this order.
const DRAW = {
  map(section) {
    map.setMap(section);
    $("floor-button").hidden = !section.floor;
    if (section.floor && isOperator() && !floorOn && !wasFloorShown) {
      wasFloorShown = true;
      setFloor(true);
    }
  },
  borders({ available_commands }) {
    drawHint();
    drawBorders();
    drawBanners();
    for (const command of ["undo", "redo"]) $(command).disabled = !available_commands.includes(command);
  },
  state() {
    drawState();
    drawBanners();
    drawNotices();
  },
  health() {
    drawState();
    drawBanners();
  },
  progress: (section) => map.setProgress(section),
  capabilities() {
    drawState();
    drawBanners();
    drawHealth();
    drawReview();
  },
  goals: drawGoals,
  preview: drawState,
  robots: (section) => map.setRobots(section),
  spots: (section) => map.setSpots(section),
  notices() {
    drawNotices();
    drawHealth();
  },
  cameras() {
    drawHealth();
    refreshFloor();
  },
  drivers: drawHealth,
  events: drawEvents,
};

// Loads the language that was chosen in this browser, or else the first of the browser's languages that the page has.
async function loadLanguage() {
  const tags = [localStorage.getItem("language"), ...navigator.languages, "en"].filter(Boolean);
  for (const language of tags.map((tag) => tag.slice(0, 2)))
    if (language === words.language || (await words.load(language))) return;
}

function settingsDialog() {
  const languages = element(
    "div",
    { class: "row", role: "group", "aria-label": sentence("page_language") },
    ...(hello.languages || []).map((language) =>
      element(
        "button",
        {
          lang: language,
          "aria-pressed": String(language === words.language),
          onclick: async () => {
            localStorage.setItem("language", language);
            await words.load(language);
            toast(""); // the toast is in the previous language
            drawAll();
            settingsDialog();
          },
        },
        new Intl.DisplayNames([language], { type: "language" }).of(language),
      ),
    ),
  );
  const invite = isOperator()
    ? button("page_invite", async () => {
        const answer = await page.link.ask("invite");
        if (!answer.ok) return toast(words.tell(answer), true);
        const codeLines = answer.operator
          ? [
              ["page_code_operator", answer.operator],
              ["page_code_viewer", answer.viewer],
            ].flatMap(([code, value]) => [element("p", {}, sentence(code)), element("p", { class: "code" }, value)])
          : [element("p", { class: "muted" }, sentence("page_only_here"))];
        show(
          sentence("page_invite"),
          ...answer.addresses.map((address) => element("p", {}, element("a", { href: address }, address))),
          ...codeLines,
          closeButton(),
        );
      })
    : null;
  const leave = hello.login
    ? button("page_leave", async () => {
        await fetch("session", { method: "DELETE" });
        location.reload();
      })
    : null;
  show(sentence("page_settings"), languages, invite, leave, closeButton());
}

const LOGIN_REFUSALS = { 401: "page_wrong_code", 429: "page_too_many_codes" }; // by HTTP status

async function logIn(code) {
  const { ok, status } = await fetch("session", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ code }),
  }).catch(() => ({}));
  if (ok) {
    $("login").hidden = true;
    page.link.connect();
  } else $("login-answer").textContent = sentence(LOGIN_REFUSALS[status] || "page_no_answer");
}

listeners.pick = borderDialog;
listeners.mode = () => {
  drawBanners();
  drawBorders();
};
window.virtualBorders = { map, draft: () => draft, view }; // for tests and the console
await loadLanguage();

page.link = new Link({
  onView(sections) {
    Object.assign(view, sections);
    for (const name of Object.keys(DRAW)) if (name in sections) DRAW[name](sections[name]);
  },
  onHello(message) {
    Object.assign(hello, message);
    for (const section of Object.keys(view)) delete view[section]; // a restarted server may have fewer sections
    document.body.dataset.role = hello.role;
    page.online = true;
    if (!words.language) loadLanguage().then(drawAll); // there was no server when the page was opened
    $("login").hidden = true;
    drawAll();
    if (page.mode === "review") previewDraft();
  },
  onDown() {
    page.online = false;
    drawState();
    drawBanners();
    map.live = false;
  },
  onSession(session) {
    document.body.dataset.role = session.role;
    if (session.role !== "nobody") return;
    $("login").hidden = false;
    $("login").querySelector("form").classList.toggle("closed", !session.login);
    $("login-text").textContent = sentence(session.login ? "page_login_help" : "page_only_local");
    for (const part of $("login").querySelectorAll("label, button")) part.hidden = !session.login;
    const code = new URLSearchParams(location.hash.slice(1)).get("code");
    if (code) {
      history.replaceState(null, "", location.pathname);
      logIn(code);
    }
  },
});

$("login")
  .querySelector("form")
  .addEventListener("submit", (event) => {
    event.preventDefault();
    logIn(event.target.elements.code.value);
  });

for (const command of ["stop", "resume", "undo", "redo"])
  $(command).addEventListener("click", () => ask("command", { command }));
$("settings-button").addEventListener("click", settingsDialog);
for (const mode of ["draw", "wall", "go"]) $(mode).addEventListener("click", () => setMode(mode));
$("zoom-in").addEventListener("click", () => map.zoom(1.4));
$("zoom-out").addEventListener("click", () => map.zoom(1 / 1.4));
$("zoom-fit").addEventListener("click", () => map.fit());
$("floor-button").addEventListener("click", () => setFloor(!floorOn));

$("health").addEventListener("toggle", () => {
  if (!$("health").open) [...watchedCameras.keys()].forEach(toggleWatching);
});

// Keeps position and size of Stop, Resume and the state on the screen while the page is enlarged by two fingers.
function keepOnScreen() {
  const { scale, offsetLeft, offsetTop } = window.visualViewport;
  for (const part of [$("stop"), $("standing")]) {
    part.style.transform = "";
    const { x, y } = part.getBoundingClientRect();
    if (scale > 1)
      part.style.transform = `translate(${offsetLeft + x / scale - x}px, ${offsetTop + y / scale - y}px) scale(${1 / scale})`;
  }
}

for (const event of ["resize", "scroll"]) window.visualViewport.addEventListener(event, keepOnScreen);

// an on-screen keyboard shrinks the page, so the field into which somebody types is scrolled into view
window.addEventListener("resize", () => {
  if (document.activeElement.matches("input")) document.activeElement.scrollIntoView({ block: "center" });
});
