// The tab Topics: what is on the graph, and the latest message of those that are opened.

import {$, make} from "./elements.js";
import {FieldList} from "./values.js";

const EVERY = 200; // ms between two messages

export class Topics {
  #rows = new Map();

  constructor(connection, watch) {
    Object.assign(this, {connection, watch});
    watch.addEventListener("graph", () => this.#list());
  }

  #list() {
    const {topics} = this.watch.graph;
    for (const [topic, row] of this.#rows) {
      if (topics[topic] === row.type) continue;
      this.#close(topic, row);
      row.element.remove();
      this.#rows.delete(topic);
    }
    for (const [topic, type] of Object.entries(topics)) if (!this.#rows.has(topic)) this.#add(topic, type);
    $("topics").append(...Object.keys(topics).map(topic => this.#rows.get(topic).element));
  }

  #add(topic, type) {
    const row = {type, list: null, body: make("div")};
    row.button = make("button", {"aria-expanded": "false", "aria-label": `Show ${topic}`, onclick: () => {
      if (row.list) this.#close(topic, row);
      else this.#open(topic, row);
    }}, "Show");
    row.element = make("div", {class: "topic"}, make("div", {class: "head"}, make("span", {}, topic, " ",
      make("span", {class: "dim"}, type)), row.button), row.body);
    this.#rows.set(topic, row);
  }

  #open(topic, row) {
    row.list = new FieldList();
    row.body.replaceChildren(make("p", {class: "dim"}, "No message yet"));
    this.#mark(row, "Hide");
    row.heard = message => {
      row.list.show(message);
      if (row.body.firstChild !== row.list.element) row.body.replaceChildren(row.list.element);
    };
    this.connection.subscribe(topic, row.type, row.heard, EVERY);
  }

  #mark({button, list}, text) {
    button.setAttribute("aria-expanded", list !== null);
    button.textContent = text;
  }

  #close(topic, row) {
    if (!row.list) return;
    row.list = null;
    row.body.replaceChildren();
    this.#mark(row, "Show");
    this.connection.unsubscribe(topic, row.heard);
  }
}
