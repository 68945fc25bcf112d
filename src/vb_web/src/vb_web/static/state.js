// What all parts of the page share: the server's view, the texts, and short functions that query them.
"use strict";
import { Words } from "./sentences.js";

export const words = new Words();
export const view = {}; // the newest sections, by name
// Whether the server answers, what a touch of the map does (editor.js), and the link to the server.
export const page = { online: false, mode: "look", link: null };
export const hello = { role: "nobody", states: [], commands: [], zones: [] }; // interaction_tables.py, zones.py of vb_core
export const sentence = (code, values) => words.say(code, values);
export const isOperator = () => hello.role === "operator";
// Returns whether a command has an effect with what is connected. If that is unknown (null: no longer known), all do.
export const isAvailable = (command) => !view.capabilities || view.capabilities.commands.includes(command);
export const robotValues = (name) => (name ? { who: name } : { who_code: "the_robot" });
export const row = (table, name) => hello[table].find((entry) => entry.name === name) || {};
// Returns the code of the sentence that says what to do in the current state, or null. The answer that led to the state
// has the same code, so that only one part of the page shows the sentence.
export const promptCode = () => row("states", document.body.dataset.state).prompt || null;
export const commandName = (command) => sentence(`page_command_${command}`);
export const kindWord = (kind) => ({ what_code: kind === "wall" ? "page_what_wall" : "page_what_border" });
export const sourceName = (source) => {
  const [kind] = String(source || "").split(" ");
  return words.has(`page_source_${kind}`) ? sentence(`page_source_${kind}`) : source;
};

// Lists the notices that no banner shows.
export function shownNotices() {
  const state = view.state || {};
  const inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends_in_s };
  return (view.notices || []).filter((notice) => !inBanner[notice.code]);
}
