// Sentences by code, in the language of the person who reads them.
"use strict";

export class Words {
  constructor() {
    this.table = {};
    this.language = "";
  }

  // Loads a language. Returns whether the server has it; if not, the texts stay in the previous language.
  async load(language) {
    const response = await fetch(`words/${language}.json`).catch(() => null);
    if (!response || !response.ok) return false;
    this.table = await response.json();
    this.language = language;
    document.documentElement.lang = language;
    for (const element of document.querySelectorAll("[data-word]"))
      element.textContent = this.say(element.dataset.word);
    for (const element of document.querySelectorAll("[data-label]")) this.label(element, element.dataset.label);
    document.title = this.say("page_title");
    return true;
  }

  label(element, code, values) {
    element.setAttribute("aria-label", this.say(code, values));
    if (element.tagName === "BUTTON") element.title = this.say(code, values);
  }

  has(code) {
    return code in this.table;
  }

  // Returns the sentence with a code and its values, or `fallback` if the code is unknown.
  say(code, values = {}, fallback = "") {
    const sentence = this.table[code] || fallback || String(code).replaceAll("_", " ");
    return sentence.replace(/\{(\w+)\}/g, (_, name, offset) =>
      name in values || `${name}_code` in values ? this.value(name, values, offset === 0) : `(${name})`,
    );
  }

  // Returns the text of a sentence's value. If its name ends with _code, it is itself a code, whose text may contain
  // the sentence's other values, and begins with a capital at the sentence's beginning. Any other value is a text,
  // which may come from a person and is never read as a code.
  value(name, { [name]: text, [`${name}_code`]: code, ...others }, beginsSentence) {
    if (code === undefined) return name === "border" || name === "borders" ? this.border(text) : text;
    const phrase = this.say(code, others);
    return beginsSentence ? phrase.charAt(0).toUpperCase() + phrase.slice(1) : phrase;
  }

  // Returns the name of a border, or of several. If nobody has named a border or wall, its number and kind are
  // translated, whether alone, in quotes or in a list, as in vb_core/sentences.py. "my wall 3" is a name that a person
  // has given.
  border(name) {
    return name.replace(
      /(^'?|, )(border|wall) (\d+)(?=$|'$|, )/g,
      (_, before, kind, number) => before + this.say(`unnamed_${kind}`, { number }),
    );
  }

  // Returns the sentence of anything that has code, values and message.
  tell({ code, values, message }) {
    return this.say(code, values, message);
  }

  number(value, digits = 1) {
    return Number(value).toLocaleString(this.language, { maximumFractionDigits: digits, minimumFractionDigits: 0 });
  }
}
