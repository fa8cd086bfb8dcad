// The goal that is being made: the form of the tab Send, and the places picked on the map.

import {$, make, say, setText} from "./elements.js";
import {Leaf, List, messageControl, takesXY, toJson} from "./fields.js";
import {placesIn} from "./places.js";

export class Draft extends EventTarget {
  #controls = new Map();
  #forms = new Map();
  #turtle = "";
  #turtles = new Map();
  #isPicked = false;
  #sent = null;
  #blamed = null;
  action = "";

  // Events: "change", and "accepted".
  constructor(connection, watch) {
    super();
    this.connection = connection;
    this.watch = watch;
    watch.addEventListener("graph", () => this.#list());
    watch.addEventListener("goal", ({detail}) => this.#notice(detail));
    connection.addEventListener("up", () => { this.#forms.clear(); this.#changed(); });
    connection.addEventListener("down", () => this.#changed());
    $("action").onchange = () => this.#choose($("action").value);
    $("form").onsubmit = event => { event.preventDefault(); this.send(); };
    $("form").addEventListener("input", () => { this.#isPicked = true; this.#forgive(); this.#changed(); });
    $("defaults").onclick = () => { this.#controls.delete(this.action); this.#choose(this.action); };
    $("copy").onclick = () => this.#copy();
    $("draft-send").onclick = () => this.send();
    $("draft-clear").onclick = () => { this.clearPlaces(); $("world").focus(); };
    this.#list();
  }

  // The description of an action's type, asked for once.
  describe(action, type) {
    const key = `${action} ${type}`;
    if (!this.#forms.has(key)) {
      const form = this.connection.call("/turtleact/web/form", {action, type});
      this.#forms.set(key, form);
      form.catch(() => this.#forms.delete(key));
    }
    return this.#forms.get(key);
  }

  get control() {
    return this.#controls.get(this.action);
  }

  // The turtle that the draft would move, if it names one.
  get turtle() {
    const field = this.control?.controls.get("turtle");
    return field instanceof Leaf ? field.input.value : "";
  }

  // The places in the form, as far as they can be read.
  places() {
    if (!this.control || !this.#isPicked) return [];
    return placesIn(this.control.read([]));
  }

  // A place picked on the map goes to the first list of places, or to x and y.
  async addPlace(x, y) {
    if (!this.#takesPlaces()) {
      if (!("/patrol" in this.watch.graph.actions)) return say(`${this.action || "No action"} takes no places`);
      await this.#choose("/patrol");
    }
    const place = {x: +x.toFixed(3), y: +y.toFixed(3)}, list = this.#placeList();
    if (list) {
      if (list.isFull) return say("The list of places is full");
      list.append(place);
    } else this.#placeGroup().write(place);
    this.#isPicked = true;
    this.#forgive();
    this.#changed();
  }

  clearPlaces() {
    this.#placeList()?.write([]);
    this.#isPicked = false;
    this.#forgive();
    this.#changed();
  }

  // The turtle chosen below the map is the one that the form names, unless it was changed there.
  chooseTurtle(name) {
    const before = this.#turtle;
    this.#turtle = name;
    const field = this.control?.controls.get("turtle");
    if (field instanceof Leaf && (field.input.value === before || !before)) field.write(name);
    this.#changed();
  }

  async send() {
    const args = this.#read();
    if (args === null) return;
    const type = this.watch.graph.actions[this.action];
    const sent = this.#sent = {action: this.action};
    say(`Sending the goal to ${this.action} …`);
    try {
      await this.connection.sendGoal(this.action, type, toJson(args));
      say("");
    } catch (error) {
      if (this.#sent === sent) this.#fail(error.message);
      else say(error.message);
    }
  }

  #list() {
    const names = Object.keys(this.watch.graph.actions), select = $("action");
    const shown = [...select.options].map(option => option.value);
    if (names.join() !== shown.join()) {
      select.replaceChildren(...names.map(name => make("option", {value: name}, name)));
    }
    if (!names.includes(this.action)) this.#choose(names.includes("/patrol") ? "/patrol" : names[0] ?? "");
    else select.value = this.action;
    $("do-send").disabled = $("copy").disabled = !names.length;
  }

  async #choose(action) {
    this.action = action;
    $("action").value = action;
    this.#forgive();
    $("command").hidden = true;
    this.#isPicked = false;
    const type = this.watch.graph.actions[action] ?? "";
    setText($("action-type"), type);
    if (type && !this.#controls.has(action)) {
      try {
        const form = await this.describe(action, type);
        if (!this.#controls.has(action)) this.#make(action, form);
      } catch (error) {
        setText($("form-error"), error.message);
      }
    }
    if (this.action !== action) return;
    $("fields").replaceChildren(...(this.control ? [this.control.element] : []));
    this.chooseTurtle(this.#turtle);
  }

  // The turtles of the map, of which the form lets one be chosen.
  offerTurtles(turtles) {
    this.#turtles = turtles;
    for (const {controls} of this.#controls.values()) {
      const field = controls.get("turtle");
      if (field?.input?.tagName === "SELECT") field.offer([...turtles.keys()]);
    }
  }

  #make(action, form) {
    const isChoice = ({name, type}) => this.#turtles.size && name === "turtle" && type === "string";
    const fields = form.goal.map(field => (isChoice(field) ? {...field, values: []} : field));
    this.#controls.set(action, messageControl(fields));
    this.offerTurtles(this.#turtles);
    const list = this.#placeList(), pose = () => this.#turtles.get(this.turtle)?.pose;
    if (list) list.first = () => pose() && {x: +pose().x.toFixed(2), y: +pose().y.toFixed(2)};
  }

  #placeList() {
    return [...(this.control?.controls.values() ?? [])].find(
      each => each instanceof List && each.field.fields && takesXY(each.field.fields));
  }

  #placeGroup() {
    const groups = [this.control, ...(this.control?.controls.values() ?? [])];
    return groups.find(each => each?.controls instanceof Map && each.controls.has("x") && each.controls.has("y"));
  }

  #takesPlaces() {
    return Boolean(this.#placeList() ?? this.#placeGroup());
  }

  // The values of the form; null if something does not fit, which is then said at the field.
  #read() {
    if (!this.control) return null;
    this.#forgive();
    const problems = [], values = this.control.read(problems);
    if (!problems.length) return values;
    this.dispatchEvent(new Event("problem"));
    problems[0][0].focus();
    return null;
  }

  // What the server says about the goal: "goal.targets[1].x: …" or "…: targets[1].x is …".
  #fail(message) {
    this.#sent = null;
    say("");
    const text = message.replace(/^Action goal was rejected:? ?/, "") || "The goal was rejected.";
    const path = /^(?:goal\.)?([a-z_]\w*(?:\[\d+\]|\.\w+)*)/.exec(text)?.[1] ?? "";
    const names = path.match(/[^.[\]]+/g) ?? [];
    const control = this.control?.controls.has(names[0]) ? this.control.locate(names) : null;
    const isPlace = control instanceof Leaf || control instanceof List;
    this.dispatchEvent(new Event("problem"));
    setText($("form-error"), isPlace ? "" : text);
    if (isPlace) {
      control.complain(text.replace(/^goal\./, ""));
      control.focus();
      this.#blamed = control;
    } else $("form-error").scrollIntoView({block: "nearest"});
  }

  // The server judged a goal that the form does not hold any more.
  #forgive() {
    setText($("form-error"), "");
    this.#blamed?.complain("");
    this.#blamed = null;
  }

  // A new goal of the action is taken for the one that was sent.
  #notice({goal, before, isNews}) {
    const sent = this.#sent;
    if (!sent || before || !isNews || goal.action !== sent.action || goal.status === "REJECTED") return;
    this.#sent = null;
    say("");
    this.dispatchEvent(new Event("accepted"));
    this.clearPlaces();
  }

  async #copy() {
    const values = this.#read();
    if (values === null) return;
    const form = await this.describe(this.action, this.watch.graph.actions[this.action]);
    const changed = form.goal.filter(({name, default: usual}) => toJson(values[name]) !== toJson(usual));
    const said = Object.fromEntries(changed.map(({name}) => [name, values[name]]));
    const quoted = `'${toJson(said).replaceAll("'", String.raw`'\''`)}'`;
    const command = `turtleact send-goal ${this.action} ${this.watch.graph.actions[this.action]} ${quoted}`;
    $("command").hidden = false;
    setText($("command"), command);
    try {
      await navigator.clipboard.writeText(command);
      say("Copied");
    } catch {
      say("Select the command below to copy it");
    }
  }

  #changed() {
    const count = this.places().length, who = this.turtle ? ` for ${this.turtle}` : "";
    const isPossible = this.#takesPlaces() || "/patrol" in this.watch.graph.actions;
    const hint = isPossible && this.#turtle ? `Choose places for ${this.turtle || this.#turtle} on the map` : "";
    setText($("draft-text"), count ? `${count} ${count === 1 ? "place" : "places"}${who} · ${this.action}` : hint);
    $("draft").classList.toggle("idle", !count);
    $("draft-send").hidden = $("draft-clear").hidden = !count;
    $("draft-send").disabled = $("do-send").disabled = !this.connection.isUp || !this.action;
    this.dispatchEvent(new Event("change"));
  }
}
