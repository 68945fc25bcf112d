// What the server's view says, and how it is said.
"use strict";
import { Words } from "./words.js";

export const words = new Words();
export const view = {};
// What all parts share: whether the server answers, what a touch of the map means (editor.js), and the link to the server.
export const page = { online: false, mode: "look", link: null };
export const hello = { role: "nobody", states: [], commands: [], zones: [] }; // with vb_core's tables: vocabulary.py, zones.py
export const say = (code, values) => words.say(code, values);
export const operator = () => hello.role === "operator";
// What is connected, and so what is offered; where it is not known (null: not any more), everything is.
export const offers = (command) => !view.offer || view.offer.commands.includes(command);
export const robotName = (name) => name || "$the_robot";
export const row = (table, name) => hello[table].find((one) => one.name === name) || {};
// What a person does in a state: the code of the answer that led there, so that it stands here and is not said twice.
export const prompt = () => row("states", document.body.dataset.state).prompt || null;
export const commandName = (command) => say(`page_command_${command}`);
export const what = (kind) => ({ what: kind === "wall" ? "$page_what_wall" : "$page_what_border" });
export const sourceName = (source) => {
  const [kind] = String(source || "").split(" ");
  return words.has(`page_source_${kind}`) ? say(`page_source_${kind}`) : source;
};

// The notices that no banner says.
export function standing() {
  const state = view.state || {},
    inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends_in_s };
  return (view.notices || []).filter((notice) => !inBanner[notice.code]);
}
