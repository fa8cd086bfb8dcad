// The time line: which goal of which action ran when.

import {$, make, setText} from "./elements.js";
import {kindOf, stateOf} from "./goals.js";
import {seconds} from "./values.js";

const MOST_ROWS = 4;
const SPANS = [30, 60, 120, 300, 600, 1800, 3600]; // s

export class Timeline {
  #rows = new Map();

  constructor(watch) {
    this.watch = watch;
    this.scale = make("div", {class: "scale"}, make("span"), make("span", {}, "now"));
    $("rows").append(this.scale);
    watch.addEventListener("time", () => this.#show());
  }

  #show() {
    const now = this.watch.time(), goals = [...this.watch.goals.values()].filter(goal => now - goal.accepted < SPANS.at(-1));
    const latest = goals.sort((a, b) => endOf(b, now) - endOf(a, now));
    const names = [...new Set(latest.map(goal => goal.action))].slice(0, MOST_ROWS).sort();
    const shown = latest.filter(goal => names.includes(goal.action)).slice(0, 100);
    const oldest = Math.max(0, ...shown.slice(0, 12).map(goal => now - goal.accepted));
    const span = SPANS.find(each => each > oldest * 1.05) ?? SPANS.at(-1);
    for (const [name, row] of this.#rows) {
      if (names.includes(name)) continue;
      row.forEach(cell => cell.remove());
      this.#rows.delete(name);
    }
    for (const name of names) this.#fill(name, shown.filter(goal => goal.action === name && endOf(goal, now) > now - span), now, span);
    $("rows").append(...names.flatMap(name => this.#rows.get(name)), this.scale);
    setText(this.scale.firstChild, `${inWords(span)} ago`);
    setText(this.scale.lastChild, this.watch.connection.isUp ? "now" : "connection lost");
    $("timeline").hidden = !names.length;
  }

  #fill(name, goals, now, span) {
    if (!this.#rows.has(name)) this.#rows.set(name, [make("span", {class: "name", title: name}, name), make("div", {class: "lane", role: "img"})]);
    const lane = this.#rows.get(name)[1];
    while (lane.children.length > goals.length) lane.lastChild.remove();
    while (lane.children.length < goals.length) lane.append(make("i"));
    // Goals that ran at the same time lie below each other.
    const ends = [], slots = goals.sort((a, b) => a.accepted - b.accepted).map(goal => {
      const free = ends.findIndex(end => end <= goal.accepted), slot = free < 0 ? ends.length : free;
      ends[slot] = endOf(goal, now);
      return slot;
    });
    lane.style.height = `${Math.max(14, 7 * ends.length)}px`;
    goals.forEach((goal, index) => {
      const [from, to] = [goal.accepted, endOf(goal, now)].map(at => Math.min(Math.max(1 - (now - at) / span, 0), 1));
      const bar = lane.children[index];
      bar.className = kindOf(goal.status);
      bar.title = `${stateOf(goal)}${goal.duration === null ? "" : `, ${seconds(goal.duration)}`}`;
      bar.style.left = `min(${(from * 100).toFixed(2)}%, 100% - 4px)`; // min-width
      bar.style.width = `${((to - from) * 100).toFixed(2)}%`;
      bar.style.top = `${100 * slots[index] / ends.length}%`;
      bar.style.height = `calc(${100 / ends.length}% - ${ends.length > 1 ? 1 : 0}px)`;
    });
    lane.setAttribute("aria-label", `${goals.length} ${goals.length === 1 ? "goal" : "goals"} of ${name} in the last ${inWords(span)}`);
  }
}

const inWords = span => (span < 60 ? `${span} s` : `${span / 60} min`);
const endOf = (goal, now) => goal.has_ended ? goal.accepted + (goal.duration ?? 0) : now;
