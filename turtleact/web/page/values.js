// Values as people read them: numbers, times, fields with units, and small plots.

import {draw, make, setText} from "./elements.js";

export const label = name => name.replaceAll("_", " ");

export function number(value) {
  if (typeof value !== "number") return value === null ? "not a number" : String(value);
  if (Number.isInteger(value)) return String(value).replace("-", "−");
  const size = Math.abs(value);
  const text = size >= 1e6 || size < 1e-3 ? value.toPrecision(3) : value.toFixed(size < 10 ? 2 : size < 1000 ? 1 : 0);
  return (+text === 0 ? "0" : text).replace("-", "−");
}

export const degrees = theta => `${number(Math.round(theta * 180 / Math.PI))}°`;

export function seconds(value) {
  if (value < 60) return `${value.toFixed(1)} s`;
  return `${Math.floor(value / 60)}:${String(Math.floor(value % 60)).padStart(2, "0")} min`;
}

const CLOCK = new Intl.DateTimeFormat([], {hour: "2-digit", minute: "2-digit", hourCycle: "h23"});
export const timeOfDay = at => CLOCK.format(at * 1000);

const isObject = value => value !== null && typeof value === "object" && !Array.isArray(value);

// A value in one line.
export function inWords(value) {
  if (typeof value === "string") return value || "(empty)";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (Array.isArray(value)) {
    if (!value.length) return "(none)";
    const words = value.slice(0, 24).map(inWords), rest = value.length - words.length;
    return words.join(value.some(isObject) ? "; " : " ") + (rest ? ` … ${rest} more` : "");
  }
  if (!isObject(value)) return number(value);
  if ("x" in value && "y" in value) {
    const place = [number(value.x), number(value.y)];
    if (value.z) place.push(number(value.z));
    if ("theta" in value) place.push(degrees(value.theta));
    return place.join(", ");
  }
  return Object.entries(value).map(([name, each]) => `${label(name)} ${inWords(each)}`).join(", ");
}

const UNIT = /[([]((?:m|s|rad|deg|%|kg|N|V|A|Hz|°|cm|mm|ms)(?:\/s(?:\^?2|²)?)?)[)\]]/;

// "The index of the target" and "The indices of the targets" count the goal's targets from 0.
const INDEX = /\bind(?:ex|ices) of the (\w+)/i;

// Functions that write values as the comments of a described message say: with a unit, or as an
// index. They are kept by path. `lists` names the lists of the goal.
export function notationsOf(fields, lists = [], prefix = "", notations = {}) {
  for (const field of fields) {
    const unit = UNIT.exec(field.comment)?.[1], noun = INDEX.exec(field.comment)?.[1].replace(/s$/, "");
    if (unit) notations[prefix + field.name] = value => inWords(value) + (typeof value === "number" ? ` ${unit}` : "");
    if (noun && lists.includes(`${noun}s`)) notations[prefix + field.name] = value => ordinals(value, noun);
    if (field.fields && !field.array) notationsOf(field.fields, lists, `${prefix}${field.name}.`, notations);
  }
  return notations;
}

// Indices count from 0, but people, the map and the steps of a goal count from 1: say both.
function ordinals(value, noun) {
  if (typeof value === "number") return `${noun} ${value + 1} (index ${value})`;
  return Array.isArray(value) && value.length ? value.map(each => ordinals(each, noun)).join(", ") : inWords(value);
}

// A list of fields that is updated in place.
export class FieldList {
  #rows = new Map();

  constructor() {
    this.element = make("dl");
  }

  show(values, notations = {}, series = {}) {
    const seen = new Set();
    this.#rowsOf(values, "", notations, series, seen);
    for (const [path, row] of this.#rows) {
      if (seen.has(path)) continue;
      this.#rows.delete(path);
      row.forEach(cell => cell.remove());
    }
  }

  #rowsOf(values, prefix, notations, series, seen) {
    for (const [name, value] of Object.entries(values)) {
      const path = prefix + name;
      if (isObject(value) && !("x" in value) && Object.values(value).some(each => typeof each === "object")) {
        this.#rowsOf(value, `${path}.`, notations, series, seen);
        continue;
      }
      seen.add(path);
      const [, text, plot] = this.#row(path);
      setText(text, (notations[path] ?? inWords)(value));
      plotInto(plot, series[path], label(path));
    }
  }

  #row(path) {
    if (!this.#rows.has(path)) {
      const row = [make("dt", {}, label(path)), make("dd"), make("dd")];
      this.element.append(...row);
      this.#rows.set(path, row);
    }
    return this.#rows.get(path);
  }
}

function plotInto(cell, points, name) {
  const values = points?.map(([, value]) => value).filter(Number.isFinite) ?? [];
  const least = Math.min(...values), most = Math.max(...values);
  if (values.length < 3 || values.length < points.length || least === most) {
    if (cell.firstChild) cell.replaceChildren();
    return;
  }
  const from = points[0][0], span = points.at(-1)[0] - from || 1;
  const at = ([time, value]) =>
    `${(2 + 92 * (time - from) / span).toFixed(1)},${(18 - 16 * (value - least) / (most - least)).toFixed(1)}`;
  const line = points.map(at).join(" ");
  let svg = cell.firstChild;
  if (!svg) {
    svg = draw("svg", {viewBox: "0 0 96 20", role: "img"},
      draw("polyline", {fill: "none", stroke: "currentColor", "stroke-width": 1.5, "stroke-linejoin": "round"}));
    cell.append(svg);
  }
  svg.firstChild.setAttribute("points", line);
  svg.setAttribute("aria-label", `${name} over time: from ${number(values[0])} to ${number(values.at(-1))}`);
}
