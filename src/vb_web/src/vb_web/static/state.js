// The server's view, and its texts.
"use strict";
import { Words } from "./words.js";

export const words = new Words();
export const view = {};
// State shared by all parts: whether the server answers, the mode of the map (editor.js), and the connection to the server.
export const page = { online: false, mode: "look", link: null };
export const hello = { role: "nobody", states: [], commands: [], zones: [] }; // with vb_core's tables: vocabulary.py, zones.py
export const say = (code, values) => words.say(code, values);
export const operator = () => hello.role === "operator";
// The offer, from what is connected; if that is not known (null: no longer known), everything is offered.
export const offers = (command) => !view.offer || view.offer.commands.includes(command);
export const robotName = (name) => name || "$the_robot";
export const row = (table, name) => hello[table].find((one) => one.name === name) || {};
// The instruction for a state: the code of the answer that led to it, so that it is not shown twice.
export const prompt = () => row("states", document.body.dataset.state).prompt || null;
export const commandName = (command) => say(`page_command_${command}`);
export const what = (kind) => ({ what: kind === "wall" ? "$page_what_wall" : "$page_what_border" });
export const sourceName = (source) => {
  const [kind] = String(source || "").split(" ");
  return words.has(`page_source_${kind}`) ? say(`page_source_${kind}`) : source;
};

// The notices without a banner.
export function standing() {
  const state = view.state || {},
    inBanner = { stopped: state.stopped, interaction_ends_soon: state.ends_in_s };
  return (view.notices || []).filter((notice) => !inBanner[notice.code]);
}
