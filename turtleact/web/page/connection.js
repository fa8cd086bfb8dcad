// rosbridge, as much of it as the page needs.

const LONGEST_WAIT = 8000;

export class Connection extends EventTarget {
  #socket = null;
  #count = 0;
  #calls = new Map();
  #goals = new Map();
  #topics = new Map();
  wait = 500;

  get isUp() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  // Events: "up", "down" (detail: ms until the next attempt), "trying", and "status" (detail: text).
  open() {
    const url = new URL("./" + location.search, location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = this.#socket = new WebSocket(url);
    socket.onopen = () => {
      this.wait = 500;
      this.#send({op: "set_level", level: "error"});
      for (const topic of this.#topics.keys()) this.#ask(topic);
      this.#tell("up");
    };
    socket.onmessage = event => this.#hear(JSON.parse(event.data));
    socket.onclose = () => {
      const lost = new Error("the connection was lost");
      for (const {reject} of [...this.#calls.values(), ...this.#goals.values()]) reject(lost);
      this.#calls.clear();
      this.#goals.clear();
      this.#tell("down", this.wait);
      setTimeout(() => { this.#tell("trying"); this.open(); }, this.wait);
      this.wait = Math.min(this.wait * 2, LONGEST_WAIT);
    };
  }

  call(service, args = {}) {
    return this.#request(this.#calls, "call", {op: "call_service", service, args});
  }

  // Resolves with the frame of the result, rejects if there is no result. `args` is JSON text,
  // because JavaScript's own numbers cannot hold every int64.
  sendGoal(action, type, args) {
    return this.#request(this.#goals, "goal", {op: "send_action_goal", action, action_type: type}, args);
  }

  // Reads a topic; `rate` is the least time between two messages (ms), and that of the first reader.
  subscribe(topic, type, heard, rate = 0) {
    const known = this.#topics.get(topic);
    if (known) return known.readers.add(heard);
    this.#topics.set(topic, {type, rate, readers: new Set([heard])});
    this.#ask(topic);
  }

  unsubscribe(topic, heard) {
    const known = this.#topics.get(topic);
    if (!known?.readers.delete(heard) || known.readers.size) return;
    this.#topics.delete(topic);
    this.#send({op: "unsubscribe", topic});
  }

  publish(topic, type, msg) {
    this.#send({op: "publish", topic, type, msg});
  }

  #request(table, kind, frame, args) {
    return new Promise((resolve, reject) => {
      if (!this.isUp) return reject(new Error("not connected"));
      const id = `${kind}:${++this.#count}`;
      table.set(id, {resolve, reject});
      const text = JSON.stringify({...frame, id});
      this.#socket.send(args === undefined ? text : `${text.slice(0, -1)},"args":${args}}`);
    });
  }

  #ask(topic) {
    const {type, rate} = this.#topics.get(topic);
    this.#send({op: "subscribe", topic, type, throttle_rate: rate});
  }

  #send(frame) {
    if (this.isUp) this.#socket.send(JSON.stringify(frame));
  }

  #hear(frame) {
    switch (frame.op) {
      case "publish": this.#topics.get(frame.topic)?.readers.forEach(heard => heard(frame.msg)); break;
      case "service_response": this.#settle(this.#calls, frame, frame.values); break;
      case "action_result": this.#settle(this.#goals, frame, frame); break;
      case "status": this.#tell("status", frame.msg); break;
    }
  }

  #settle(table, frame, value) {
    const waiting = table.get(frame.id);
    table.delete(frame.id);
    if (frame.result) waiting?.resolve(value);
    else waiting?.reject(new Error(frame.values));
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, {detail}));
  }
}
