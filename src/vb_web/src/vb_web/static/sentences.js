// Sentences by code, in the language of the person who reads them.
"use strict";

export class Words {
  constructor() {
    this.table = {};
    this.language = "";
  }

  // Loads a language. Returns whether it is known; if not, the words stay as they are.
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

  // Returns a code's sentence with its values, or `fallback` for an unknown code.
  say(code, values = {}, fallback = "") {
    const sentence = this.table[code] || fallback || String(code).replaceAll("_", " ");
    return sentence.replace(/\{(\w+)\}/g, (_, name, offset) =>
      name in values || `${name}_code` in values ? this.value(name, values, offset === 0) : `(${name})`,
    );
  }

  // Returns a sentence's value. One whose name ends in _code is itself a code, with the sentence's other values, and begins
  // with a capital where it begins the sentence. Any other value is a text, perhaps a person's, and never read as a code.
  value(name, { [name]: text, [`${name}_code`]: code, ...others }, beginsSentence) {
    if (code === undefined) return name === "border" || name === "borders" ? this.border(text) : text;
    const phrase = this.say(code, others);
    return beginsSentence ? phrase.charAt(0).toUpperCase() + phrase.slice(1) : phrase;
  }

  // Returns a border's name, or several. A border or wall that nobody named is numbered in the reader's language: alone, in
  // quotes or in a list, as in vb_core/sentences.py. "my wall 3" is a person's own name.
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
