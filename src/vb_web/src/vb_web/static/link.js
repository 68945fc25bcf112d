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
    const limit = new AbortController(); // older browsers have no AbortSignal.timeout
    const timer = setTimeout(() => limit.abort(), SILENT_MS);
    let session = null;
    try {
      session = await (await fetch("session", { cache: "no-store", signal: limit.signal })).json();
    } catch (_) {
      // no server, none of ours, or none that answers
    } finally {
      clearTimeout(timer);
      this.connecting = false;
    }
    if (session === null) return this.down();
    this.onSession(session);
    if (session.role !== "nobody") this.open();
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
  // once; only stop always goes out. "What" is the request and `shown`, what it is about where its fields do not say that.
  ask(action, fields = {}, shown = null) {
    const what = JSON.stringify([action, fields, shown]);
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
