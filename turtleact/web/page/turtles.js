// The tab Turtles: where they are, their pens, and who comes and goes.

import {$, make, report, say, setText} from "./elements.js";
import {degrees, number} from "./values.js";
import {SIDE} from "./world.js";

export class Turtles {
  #rows = new Map();

  constructor(connection, watch, world, chosen) {
    Object.assign(this, {connection, watch, world, chosen});
    const input = (name, attributes) => make("label", {}, `${name} `, (this[name] = make("input", attributes)));
    this.body = make("tbody");
    this.setPen = make("button", {}, "Set pen");
    this.pen = make("form", {class: "row", "aria-label": "Pen", onsubmit: event => { event.preventDefault(); this.#pen(); }},
      input("Colour", {type: "color", value: "#b3b8ff"}), input("Width", {type: "number", min: 1, max: 255, value: 3}),
      make("label", {}, this.off = make("input", {type: "checkbox"}), " off"), this.setPen);
    this.doSpawn = make("button", {}, "Spawn");
    const place = {type: "number", min: 0, max: SIDE.toFixed(2), step: "any", value: 3, required: true};
    this.form = make("form", {class: "row", "aria-label": "Spawn a turtle", onsubmit: event => { event.preventDefault(); this.#spawnThere(); }},
      input("x", place), input("y", place),
      input("Name", {placeholder: "any", autocomplete: "off"}), this.doSpawn);
    this.reset = make("button", {class: "bad", onclick: () => {
      if (confirm("Reset the world? Its trails and all turtles but turtle1 go.")) report(connection.call("/reset"), () => "The world was reset");
    }}, "Reset world …");
    const head = make("tr", {}, ...["name", "x", "y", "heading", "speed"].map(text => make("th", {scope: "col"}, text)),
      make("th", {scope: "col"}, make("span", {class: "unseen"}, "actions")));
    this.title = make("h3");
    $("turtles").append(make("table", {}, make("thead", {}, head), this.body), this.title, this.pen,
      make("h3", {}, "World"), this.form, make("div", {class: "row"}, this.reset));
  }

  refresh() {
    const name = this.chosen(), has = service => this.connection.isUp && this.watch.has(service);
    for (const [id, [, row]] of this.#rows) if (!this.world.turtles.has(id)) { row.remove(); this.#rows.delete(id); }
    for (const id of this.world.names) if (!this.#rows.has(id)) this.#add(id);
    setText(this.title, name ? `Pen of ${name}` : "");
    this.pen.hidden = this.title.hidden = !this.watch.has(`/${name}/set_pen`);
    this.setPen.disabled = !this.connection.isUp;
    this.doSpawn.disabled = $("spawn-here").disabled = !has("/spawn");
    this.reset.disabled = !has("/reset");
    for (const [, , kill] of this.#rows.values()) kill.disabled = !has("/kill");
  }

  show() {
    for (const [id, [cells]] of this.#rows) {
      const pose = this.world.turtles.get(id)?.pose;
      if (!pose) continue;
      const told = [number(pose.x), number(pose.y), degrees(pose.theta), `${number(pose.linear_velocity)} m/s`];
      cells.forEach((cell, index) => setText(cell, told[index]));
    }
  }

  spawnSomewhere() {
    const [x, y] = [0, 0].map(() => +(1 + Math.random() * (SIDE - 2)).toFixed(2));
    this.#spawn(x, y, "");
  }

  #add(name) {
    const cells = [0, 1, 2, 3].map(() => make("td"));
    const kill = make("button", {onclick: () => report(this.connection.call("/kill", {name})), "aria-label": `Kill ${name}`}, "Kill");
    const row = make("tr", {}, make("th", {scope: "row"}, name), ...cells, make("td", {}, kill));
    this.body.append(row);
    this.#rows.set(name, [cells, row, kill]);
  }

  #pen() {
    const [r, g, b] = [1, 3, 5].map(at => parseInt(this.Colour.value.slice(at, at + 2), 16));
    const args = {r, g, b, width: +this.Width.value, off: +this.off.checked};
    const name = this.chosen();
    report(this.connection.call(`/${name}/set_pen`, args), () => `The pen of ${name} was set`);
  }

  #spawnThere() {
    const name = this.Name.value.trim();
    if (this.world.turtles.has(name)) return say(`There is a turtle named ${name} already`);
    this.#spawn(+this.x.value, +this.y.value, name);
  }

  #spawn(x, y, wanted) {
    report(this.connection.call("/spawn", {x, y, theta: 0, name: wanted}),
      ({name}) => (name ? `${name} is there` : "No turtle was spawned. The terminal of the world says why."));
  }
}
