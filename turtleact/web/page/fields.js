// A form for a message, made from the description of its fields.
//
// Each control has `element`, `write(value)`, `read(problems)`, which collects [control, text] for
// what does not fit, and `locate(names)`, the control that a path such as targets[1].x means.

import {make, setText} from "./elements.js";
import {label} from "./values.js";

const INTEGER = /^[+-]?\d+$/;
const IS_INTEGER = /^u?int\d+$|^byte$|^char$/;
const IS_FLOAT = /^float(32|64)$/;

let count = 0;

export function messageControl(fields) {
  return new Group(fields);
}

function controlOf(field, isOutermost) {
  if (field.array) return new List(field, isOutermost);
  return field.fields ? new Group(field.fields, field) : new Leaf(field);
}

function limits(field) {
  const {array, longest} = field, words = [];
  if (array?.form === "fixed") words.push(`${array.size} values`);
  if (array?.form === "bounded") words.push(`at most ${array.size}`);
  if (longest !== undefined) words.push(`at most ${longest} characters`);
  if (field.least !== undefined && !/int(32|64)$/.test(field.type)) {
    words.push(`${field.least.replace("-", "−")} to ${field.most}`);
  }
  return words.join(", ");
}

// What is typed then replaces the text of an input.
function enter(control) {
  control?.focus();
  control?.select?.();
}

const noteOf = (...parts) => parts.filter(Boolean).join(" · ").replaceAll(". · ", ". ");
const plain = comment => comment.replaceAll("``", "");

// Whether places picked on the map fit.
export function takesXY(fields) {
  const names = fields.filter(({type, array}) => !array && IS_FLOAT.test(type)).map(({name}) => name);
  return names.includes("x") && names.includes("y");
}

// A few numbers without comments, such as a point, stand side by side.
const isCompact = fields => fields.length <= 4 && fields.every(
  ({type, array, comment}) => !array && !comment && (IS_FLOAT.test(type) || IS_INTEGER.test(type)));

export class Leaf {
  constructor(field, name = label(field.name), note = noteOf(plain(field.comment), limits(field))) {
    this.field = field;
    const id = `field-${++count}`;
    const described = {id, "aria-describedby": `${id}-note ${id}-error`};
    const options = (field.values ?? field.suggested)?.map(([value, text]) => make("option", {value}, text));
    this.input = field.values ? make("select", described, ...options) : make("input", {...described, autocomplete: "off",
      type: field.type === "bool" ? "checkbox" : "text",
      inputmode: IS_FLOAT.test(field.type) || IS_INTEGER.test(field.type) ? "decimal" : null});
    this.error = make("small", {id: `${id}-error`, class: "error"});
    this.note = make("small", {id: `${id}-note`}, note);
    this.element = make("div", {class: "field"},
      make("label", {for: id, title: field.type}, name), this.input, this.error, this.note);
    if (field.suggested) {
      this.input.setAttribute("list", `${id}-words`);
      this.element.append(make("datalist", {id: `${id}-words`}, ...options));
    }
    this.input.oninput = () => this.complain("");
    this.input.onchange = () => { this.complain(""); this.read([]); };
    this.write(field.array ? zeroOf(field) : field.default);
  }

  write(value) {
    const {type, values} = this.field;
    if (values && !values.some(([known]) => known === String(value))) return;
    if (type === "bool") this.input.checked = Boolean(value);
    else this.input.value = value === null ? "nan" : String(value);
    this.complain("");
  }

  // Gives a select other values to choose from.
  offer(names) {
    const {value} = this.input;
    this.field.values = names.map(name => [name, name]);
    this.input.replaceChildren(...names.map(name => make("option", {}, name)));
    this.write(value);
  }

  // What is wrong with it, or an empty text.
  complain(text) {
    setText(this.error, text);
    if (text) this.input.setAttribute("aria-invalid", "true");
    else this.input.removeAttribute("aria-invalid");
  }

  focus() {
    enter(this.input);
  }

  read(problems) {
    const [value, problem] = this.#parsed();
    if (problem) {
      this.complain(problem);
      problems.push([this, problem]);
    }
    return value;
  }

  locate() {
    return this;
  }

  #parsed() {
    const {type, least, most, longest} = this.field, text = this.input.value;
    if (type === "bool") return [this.input.checked, ""];
    if (IS_INTEGER.test(type)) {
      if (!INTEGER.test(text.trim())) return [0, "Enter a whole number"];
      const value = BigInt(text.trim().replace("+", ""));
      if (value < BigInt(least) || value > BigInt(most)) return [0, `Enter a number from ${least.replace("-", "−")} to ${most}`];
      return [Number.isSafeInteger(Number(value)) ? Number(value) : value, ""];
    }
    if (IS_FLOAT.test(type)) {
      if (text.trim().toLowerCase() === "nan") return [null, ""];
      const value = Number(text.trim().replace(",", ".").replace("−", "-"));
      if (!text.trim() || Number.isNaN(value)) return [0, "Enter a number"];
      return Number.isFinite(value) ? [value, ""] : [0, "Enter a finite number"];
    }
    if (longest !== undefined && [...text].length > longest) return [text, `Enter at most ${longest} characters, not ${[...text].length}`];
    return [text, ""];
  }
}

function zeroOf({type}) {
  return type === "bool" ? false : type === "string" || type === "wstring" ? "" : 0;
}

class Group {
  constructor(fields, field = null, name = field && label(field.name)) {
    this.controls = new Map(fields.map(each => [each.name, controlOf(each, !field)]));
    const inside = [...this.controls.values()].map(({element}) => element);
    if (!field) this.element = make("div", {}, ...inside);
    else this.element = make("fieldset", {class: isCompact(fields) ? "compact" : null}, make("legend", {}, name, " ", make("small", {}, plain(field.array ? "" : field.comment))), ...inside);
    if (field && !field.array && field.default) this.write(field.default);
  }

  write(values) {
    for (const [name, value] of Object.entries(values)) this.controls.get(name)?.write(value);
  }

  read(problems) {
    return Object.fromEntries([...this.controls].map(([name, control]) => [name, control.read(problems)]));
  }

  locate([name, ...rest]) {
    return this.controls.get(name)?.locate(rest) ?? this;
  }

  complain() {}

  focus() {
    enter(this.element.querySelector("input, select, button"));
  }
}

export class List {
  controls = [];

  // The value that the first item begins with; undefined for its type's default.
  first() {}

  constructor(field, isOutermost) {
    this.field = field;
    this.items = make("div", {class: field.fields ? "items" : "items short"});
    this.error = make("small", {class: "error", role: "alert"});
    this.isFixed = field.array.form === "fixed";
    this.add = make("button", {type: "button", hidden: this.isFixed, onclick: () => {
      this.append(this.controls.at(-1)?.read([]) ?? this.first()).focus();
      this.#changed();
    }}, `Add to ${label(field.name)}`);
    const hint = isOutermost && field.fields && takesXY(field.fields) ? "You can also choose them on the map." : "";
    const note = noteOf(plain(field.comment), limits(field), hint);
    this.element = make("fieldset", {}, make("legend", {}, label(field.name), " ", make("small", {}, note)),
      this.items, this.error, make("div", {class: "row"}, this.add));
    this.write(Array.isArray(field.default) ? field.default : []);
  }

  get isFull() {
    return this.field.array.form === "bounded" && this.controls.length >= this.field.array.size;
  }

  append(value) {
    const number = this.controls.length + 1, name = `${label(this.field.name)} ${number}`;
    const control = this.field.fields ? new Group(this.field.fields, this.field, name) : new Leaf(this.field, String(number), "");
    if (value !== undefined) control.write(value);
    const item = make("div", {class: "item"}, control.element);
    if (!this.isFixed) {
      item.append(make("button", {type: "button", "aria-label": `Remove ${name}`, onclick: () => this.#remove(control)}, "✕"));
    }
    this.items.append(item);
    this.controls.push(control);
    this.#note();
    return control;
  }

  write(values) {
    this.items.replaceChildren();
    this.controls = [];
    for (const value of values) this.append(value);
    this.#note();
  }

  read(problems) {
    return this.controls.map(control => control.read(problems));
  }

  locate([index, ...rest]) {
    return this.controls[index]?.locate(rest) ?? this;
  }

  complain(text) {
    setText(this.error, text);
  }

  focus() {
    enter(this.items.querySelector("input, select") ?? this.add);
  }

  #remove(control) {
    const at = this.controls.indexOf(control), problems = [];
    const values = this.controls.filter(each => each !== control).map(each => each.read(problems));
    this.write(values);
    const buttons = [...this.items.children].map(item => item.lastChild);
    (buttons[Math.min(at, buttons.length - 1)] ?? this.add).focus();
    this.#changed();
  }

  #note() {
    this.add.disabled = this.isFull;
    this.complain("");
  }

  // Buttons cause no input event of their own.
  #changed() {
    this.element.dispatchEvent(new Event("input", {bubbles: true}));
  }
}

// JSON text of values that may hold BigInts.
export function toJson(value) {
  if (typeof value === "bigint") return String(value);
  if (Array.isArray(value)) return `[${value.map(toJson).join(",")}]`;
  if (value !== null && typeof value === "object") {
    return `{${Object.entries(value).map(([name, each]) => `${JSON.stringify(name)}:${toJson(each)}`).join(",")}}`;
  }
  return JSON.stringify(value);
}
