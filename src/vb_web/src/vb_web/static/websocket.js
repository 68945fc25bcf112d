// The link to the server, which receives sections of the view and sends requests. After the link was lost, unanswered
// requests are sent again with the same id, so that each is carried out only once.
"use strict";

const RESEND_MS = 8000;
const ANSWER_MS = 30000;
const SILENT_MS = 8000; // the server says something every two seconds

const noAnswer = (code) => ({ ok: false, code, values: {}, message: "" });

export class Link {
  // The callbacks get the changed sections; the first message of each connection; nothing, when the connection is lost;
  // and {role, login}.
  constructor({ onView, onHello, onDown, onSession }) {
    Object.assign(this, {
      onView,
      onHello,
      onDown,
      onSession,
      waiting: new Map(), // requests without an answer, by id
      underWay: new Map(), // promises of answers, by the content of the request
      socket: null,
      reconnectMs: 300,
      heardAt: 0,
    });
    this.connect();
    setInterval(() => {
      if (this.socket && Date.now() - this.heardAt > SILENT_MS) this.lost(this.socket);
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
      // there is no server, or another program's, or it does not answer
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
    this.heardAt = Date.now();
    socket.onopen = () => {
      this.reconnectMs = 300;
      const now = Date.now();
      for (const [id, request] of this.waiting) {
        if (now - request.askedAt < RESEND_MS) socket.send(this.text(id, request));
        else this.settle(id, noAnswer("page_no_answer"));
      }
    };
    socket.onmessage = (event) => {
      this.heardAt = Date.now();
      const message = JSON.parse(event.data);
      if (message.hello) this.onHello(message.hello);
      else if (message.view) this.onView(message.view);
      else if ("re" in message) this.settle(message.re, message);
    };
    socket.onclose = () => this.lost(socket);
  }

  // Gives up a connection. Without this, a phone that slept or changed its network may notice the loss after minutes.
  lost(socket) {
    if (this.socket !== socket) return;
    this.socket = null;
    socket.close();
    this.down();
  }

  down() {
    this.onDown();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), this.reconnectMs);
    this.reconnectMs = Math.min(3000, this.reconnectMs * 1.6);
  }

  // Returns a request as JSON. A command says how long ago it was given.
  text(id, { action, fields, askedAt }) {
    const age = action === "command" ? { age: Math.min(Math.max(0, Date.now() - askedAt), 60000) / 1000 } : {};
    return JSON.stringify({ do: action, id, ...fields, ...age });
  }

  settle(id, answer) {
    const request = this.waiting.get(id);
    if (!request) return;
    this.waiting.delete(id);
    clearTimeout(request.timer);
    request.resolve(answer);
  }

  // Asks for an action. The promise resolves with the answer, and is never rejected. If the same request is made again
  // before the answer, as by a double tap, it is not sent again, unless it is a stop. `subject` distinguishes requests
  // that have the same fields.
  ask(action, fields = {}, subject = null) {
    const key = JSON.stringify([action, fields, subject]);
    if (fields.command === "stop") return this.send(action, fields);
    if (!this.underWay.has(key))
      this.underWay.set(
        key,
        this.send(action, fields).finally(() => this.underWay.delete(key)),
      );
    return this.underWay.get(key);
  }

  send(action, fields) {
    const id = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) =>
      byte.toString(16).padStart(2, "0"),
    ).join("");
    const askedAt = Date.now();
    return new Promise((resolve) => {
      const timer = setTimeout(() => this.settle(id, noAnswer("page_no_answer")), ANSWER_MS);
      const request = { action, fields, askedAt, resolve, timer };
      this.waiting.set(id, request);
      const isOpen = () => Boolean(this.socket) && this.socket.readyState === WebSocket.OPEN;
      if (isOpen()) {
        this.socket.send(this.text(id, request));
        return;
      }
      // a request that cannot be sent soon has failed: people would be deceived by a stop that waits in a queue
      setTimeout(() => {
        if (!isOpen()) this.settle(id, noAnswer("page_offline"));
      }, 1500);
    });
  }
}
