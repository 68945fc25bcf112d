// When a border is in force, as text, as what people type, and as words.
"use strict";
import { say } from "./state.js";

export const DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];

export function scheduleText(schedule) {
  // a word joiner on both sides: the line does not break at the dash
  return schedule
    .replace(/\b(mon|tue|wed|thu|fri|sat|sun|daily)\b/g, (day) => say(`page_day_${day}`))
    .replaceAll("-", "\u2060–\u2060");
}

export function parseSchedule(text) {
  const match = /^(?:([a-z,-]+) )?(\d\d?:\d\d)-(\d\d?:\d\d)$/.exec(text);
  if (!match) return { days: new Set(), from: "", to: "" };
  const days = new Set();
  for (const part of (match[1] || "mon-sun").replace("daily", "mon-sun").split(",")) {
    const [a, b] = part.split("-"),
      first = DAYS.indexOf(a),
      last = DAYS.indexOf(b || a);
    if (first < 0 || last < 0) return { days: new Set(), from: "", to: "" };
    for (let i = first; ; i = (i + 1) % 7) {
      days.add(DAYS[i]);
      if (i === last) break;
    }
  }
  return { days, from: match[2].padStart(5, "0"), to: match[3].padStart(5, "0") };
}

// "06:00" of "6", "6:00" and "0600"; "" if it is no time of day.
export function parseTime(text) {
  const [, hours, minutes = "00"] = /^([01]?\d|2[0-4]):?([0-5]\d)?$/.exec(text.trim()) || [];
  return !hours || (hours === "24" && minutes !== "00") ? "" : `${hours.padStart(2, "0")}:${minutes}`;
}

export function formatSchedule({ days, from, to }) {
  if (!days.size || days.size === 7) return `${from}-${to}`;
  const parts = [];
  for (let i = 0; i < 7; i++) {
    if (!days.has(DAYS[i])) continue;
    let j = i;
    while (j < 6 && days.has(DAYS[j + 1])) j++;
    parts.push(j - i > 1 ? `${DAYS[i]}-${DAYS[j]}` : DAYS.slice(i, j + 1).join(","));
    i = j;
  }
  return `${parts.join(",")} ${from}-${to}`;
}
