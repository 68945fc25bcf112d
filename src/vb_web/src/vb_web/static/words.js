// Sentences by code, in the language of the person who reads them.
"use strict";

export class Words {
  constructor() {
    this.table = {};
    this.language = "";
  }

  // Returns whether the language is known; if not, the words stay as they are.
  async load(language) {
    const found = await fetch(`words/${language}.json`).catch(() => null);
    if (!found || !found.ok) return false;
    this.table = await found.json();
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

  say(code, values = {}, otherwise = "") {
    const sentence = this.table[code] || otherwise || String(code).replaceAll("_", " ");
    return sentence.replace(/\{(\w+)\}/g, (_, name, at) =>
      name in values ? this.value(name, values, at) : `(${name})`,
    );
  }

  // A value that begins with $ is itself a code, with the sentence's other values; where a sentence begins with it, so with a capital.
  value(name, { [name]: given, ...others }, at) {
    const text = name === "border" || name === "borders" ? this.border(given) : given;
    if (!/^\$./.test(text)) return text;
    const said = this.say(text.slice(1), others);
    return at ? said : said.charAt(0).toUpperCase() + said.slice(1);
  }

  // A border or wall that nobody named is numbered in the reader's language.
  border(name) {
    return name.replace(/\b(border|wall) (\d+)\b/g, (_, kind, number) => this.say(`unnamed_${kind}`, { number }));
  }

  // Of anything that has code, values and message.
  tell(said) {
    return this.say(said.code, said.values, said.message);
  }

  number(value, digits = 1) {
    return Number(value).toLocaleString(this.language, { maximumFractionDigits: digits, minimumFractionDigits: 0 });
  }
}
