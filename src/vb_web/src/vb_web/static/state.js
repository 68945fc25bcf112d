// What all parts of the page share: the server's view, the words, and short questions about both.
"use strict";
import { Words } from "./sentences.js";

export const words = new Words();
export const view = {}; // the newest sections, by name
// Whether the server answers, what a touch of the map means (editor.js), and the link to the server.
export const page = { online: false, mode: "look", link: null };
export const hello = { role: "nobody", states: [], commands: [], zones: [] }; // interaction_tables.py, zones.py of vb_core
export const sentence = (code, values) => words.say(code, values);
export const isOperator = () => hello.role === "operator";
// Whether a command has an effect with what is connected. Where that is not known (null: not any more), all are offered.
export const isAvailable = (command) => !view.capabilities || view.capabilities.commands.includes(command);
export const robotValues = (name) => (name ? { who: name } : { who_code: "the_robot" });
export const row = (table, name) => hello[table].find((entry) => entry.name === name) || {};
// The code of the sentence that says what to do in the current state, or null. It is also the code of the answer that led
// there, so that one place on the page says it.
export const promptCode = () => row("states", document.body.dataset.state).prompt || null;
export const commandName = (command) => sentence(`page_command_${command}`);
export const kindWord = (kind) => ({ what_code: kind === "wall" ? "page_what_wall" : "page_what_border" });
export const sourceName = (source) => {
  const [kind] = String(source || "").split(" ");
  return words.has(`page_source_${kind}`) ? sentence(`page_source_${kind}`) : source;
};

// Lists the notices that no banner says.
export function shownNotices() {
  const state = view.state || {};
  const inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends_in_s };
  return (view.notices || []).filter((notice) => !inBanner[notice.code]);
}
