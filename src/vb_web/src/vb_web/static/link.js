// The link to the server: sections of the view come in, requests go out. A request keeps its id when it is sent again after
// the link was lost, so that it is carried out once.
"use strict";

const RESEND_MS = 8000,
  ANSWER_MS = 30000,
  SILENT_MS = 8000; // the server says something every two seconds

export class Link {
  constructor(onView, onHello, onDown, onSession) {
    Object.assign(this, {
      onView,
      onHello,
      onDown,
      onSession,
      waiting: new Map(),
      underWay: new Map(),
      socket: null,
      pause: 300,
      heard: 0,
    });
    this.connect();
    setInterval(() => {
      if (this.socket && Date.now() - this.heard > SILENT_MS) this.lost(this.socket);
    }, 1000);
    window.addEventListener("online", () => this.connect());
  }

  async connect() {
    if (this.socket || this.connecting) return;
    this.connecting = true;
    try {
      const session = await (await fetch("session", { cache: "no-store" })).json();
      this.onSession(session);
      if (session.role !== "nobody") this.open();
    } catch (_) {
      this.down();
    } finally {
      this.connecting = false;
    }
  }

  open() {
    const url = new URL("link", location.href);
    url.protocol = url.protocol.replace("http", "ws");
    url.hash = "";
    const socket = (this.socket = new WebSocket(url));
    this.heard = Date.now();
    socket.onopen = () => {
      this.pause = 300;
      const now = Date.now();
      for (const [id, one] of this.waiting) {
        if (now - one.asked < RESEND_MS) socket.send(this.text(id, one));
        else this.settle(id, { ok: false, code: "page_no_answer", values: {}, message: "" });
      }
    };
    socket.onmessage = (event) => {
      this.heard = Date.now();
      const message = JSON.parse(event.data);
      if (message.hello) this.onHello(message.hello);
      else if (message.view) this.onView(message.view);
      else if ("re" in message) this.settle(message.re, message);
    };
    socket.onclose = () => this.lost(socket);
  }

  // A phone that slept, or has another network, may be told of the end of its connection minutes later, or never.
  lost(socket) {
    if (this.socket !== socket) return;
    this.socket = null;
    socket.close();
    this.down();
  }

  down() {
    this.onDown();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), this.pause);
    this.pause = Math.min(3000, this.pause * 1.6);
  }

  // A command says how long ago it was given.
  text(id, { action, fields, asked }) {
    const age = action === "command" ? { age: Math.min(Math.max(0, Date.now() - asked), 60000) / 1000 } : {};
    return JSON.stringify({ do: action, id, ...fields, ...age });
  }

  settle(id, answer) {
    const one = this.waiting.get(id);
    if (!one) return;
    this.waiting.delete(id);
    clearTimeout(one.timer);
    one.resolve(answer);
  }

  // Resolves with the answer, never rejects. What is asked for again while it is under way, as by a double tap, is asked for
  // once; only stop always goes out.
  ask(action, fields = {}) {
    const what = JSON.stringify([action, fields]);
    if (fields.command === "stop") return this.send(action, fields);
    if (!this.underWay.has(what))
      this.underWay.set(
        what,
        this.send(action, fields).finally(() => this.underWay.delete(what)),
      );
    return this.underWay.get(what);
  }

  send(action, fields) {
    const id = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) =>
      byte.toString(16).padStart(2, "0"),
    ).join("");
    const one = { action, fields, asked: Date.now() };
    return new Promise((resolve) => {
      const timer = setTimeout(
        () => this.settle(id, { ok: false, code: "page_no_answer", values: {}, message: "" }),
        ANSWER_MS,
      );
      this.waiting.set(id, Object.assign(one, { resolve, timer }));
      if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(this.text(id, one));
      // "stop" that lies in a queue would be a lie: what is not on its way after a moment failed
      else
        setTimeout(() => {
          if (!this.socket || this.socket.readyState !== WebSocket.OPEN)
            this.settle(id, { ok: false, code: "page_offline", values: {}, message: "" });
        }, 1500);
    });
  }
}

// Sentences by code, in the language of whoever reads them.
export class Words {
  constructor() {
    this.table = {};
    this.language = "";
  }

  // Returns whether the language is known; if not, the words stay as they are.
  async load(language) {
    const found = await fetch(`words/${language}.json`);
    if (!found.ok) return false;
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
  value(name, { [name]: text, ...others }, at) {
    if (name === "border" || name === "borders") return this.border(text);
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
