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
    for (const [topic, {type, element}] of this.#rows) {
      if (topics[topic] === type) continue;
      element.open = false;
      element.remove();
      this.#rows.delete(topic);
    }
    for (const [topic, type] of Object.entries(topics)) if (!this.#rows.has(topic)) this.#add(topic, type);
    $("topics").append(...Object.keys(topics).map(topic => this.#rows.get(topic).element));
  }

  #add(topic, type) {
    const list = new FieldList(), heard = message => list.show(message);
    const summary = make("summary", {}, make("b", {}, topic), make("span", {class: "what"}, type));
    const element = make("details", {class: "goal"}, summary, make("div", {}, list.element));
    element.ontoggle = () => {
      if (element.open) this.connection.subscribe(topic, type, heard, EVERY);
      else this.connection.unsubscribe(topic, heard);
    };
    this.#rows.set(topic, {type, element});
  }
}
