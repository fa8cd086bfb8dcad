// The goals: cards for those that run, lines for those that have ended.

import {$, announce, make, report, setText} from "./elements.js";
import {placesIn, progressOf, turtleOf} from "./places.js";
import {FieldList, inWords, label, notationsOf, seconds, timeOfDay} from "./values.js";

const KIND = {
  ACCEPTED: "run", EXECUTING: "run", CANCELING: "warn", SUCCEEDED: "good",
  CANCELED: "warn", ABORTED: "bad", REJECTED: "bad", UNKNOWN: "",
};
export const kindOf = status => KIND[status] ?? "";

const MOST_OPEN = 3; // cards that run and show everything from the start

export class Goals {
  #cards = new Map();

  // `names()` gives the turtles, `describe(action, type)` a promise of an action's form.
  constructor(watch, {names, describe}) {
    this.watch = watch;
    this.names = names;
    this.describe = describe;
    watch.addEventListener("goal", ({detail}) => this.#show(detail));
    watch.addEventListener("dropped", ({detail}) => this.#remove(detail));
    watch.addEventListener("time", () => this.#tick());
  }

  #show({goal, before, isNews}) {
    let card = this.#cards.get(goal.id);
    if (card && card.hasEnded !== goal.has_ended) {
      this.#remove(goal.id);
      card = null;
    }
    if (!card) {
      card = goal.has_ended ? new Line(this, goal) : new Card(this, goal);
      this.#cards.set(goal.id, card);
      $(goal.has_ended ? "ended" : "active").prepend(card.element);
      this.describe(goal.action, goal.type).then(
        form => { const lists = form.goal.filter(({array}) => array).map(({name}) => name);
          card.notations = {feedback: notationsOf(form.feedback, lists), result: notationsOf(form.result, lists), request: notationsOf(form.goal)};
          card.show(this.watch.goals.get(goal.id) ?? goal); }, () => {});
    }
    card.show(goal);
    if (isNews && goal.has_ended && !before?.has_ended) announce(`${goal.action} ${stateOf(goal)}${tail(goal)}`);
  }

  #remove(id) {
    const card = this.#cards.get(id);
    if (!card) return;
    // The focus must not get lost with the card that has it.
    if (card.element.contains(document.activeElement)) $("tab-goals").focus();
    card.element.remove();
    this.#cards.delete(id);
  }

  #tick() {
    let running = 0;
    for (const [id, card] of this.#cards) {
      if (card.hasEnded) continue;
      running++;
      card.tick(this.watch.goals.get(id));
    }
    setText($("running"), running ? String(running) : "");
    $("no-goals").hidden = this.#cards.size > 0;
  }

  cancel(goal) {
    const uuid = btoa(String.fromCharCode(...goal.id.match(/../g).map(pair => parseInt(pair, 16))));
    const args = {goal_info: {goal_id: {uuid}}};
    report(this.watch.connection.call(`${goal.action}/_action/cancel_goal`, args),
      ({return_code}) => (return_code === 1 ? `${goal.action} does not cancel the goal` : ""));
  }

  setPaused(goal, isPaused) {
    report(this.watch.connection.call("/turtleact/web/set_paused", {id: goal.id, is_paused: isPaused}));
  }
}

const tail = goal => (goal.duration === null ? "" : ` after ${seconds(goal.duration)}`);

export const stateOf = goal => (goal.status === "UNKNOWN" ? "end unknown" : goal.status.toLowerCase());

function setPill(pill, goal, isLost = false) {
  const marks = [goal.is_resumed && "resumed", goal.is_paused && "paused"].filter(Boolean);
  setText(pill, isLost ? "connection lost" : stateOf(goal) + (marks.length ? ` (${marks.join(", ")})` : ""));
  pill.className = `pill ${isLost ? "bad" : kindOf(goal.status)}`;
}

class Card {
  hasEnded = false;
  notations = {};

  constructor(goals, goal) {
    this.goals = goals;
    this.title = make("b");
    this.pill = make("span", {class: "pill"});
    this.clock = make("span", {class: "clock"});
    this.bar = make("i");
    this.track = make("div", {class: "track", role: "progressbar", "aria-label": `Progress of ${goal.action}`,
      "aria-valuemin": 0, "aria-valuemax": 100, hidden: true}, this.bar);
    this.steps = make("ol", {class: "steps", "aria-label": "Targets", hidden: true});
    this.fields = new FieldList();
    this.cancel = make("button", {"aria-label": `Cancel ${goal.action}`, onclick: () => goals.cancel(this.goal)}, "Cancel");
    this.pause = make("button", {onclick: () => goals.setPaused(this.goal, !this.goal.is_paused)});
    const foot = make("div", {class: "foot"}, this.cancel, this.pause,
      make("span", {class: "dim", title: goal.id}, `${goal.id.slice(0, 8)} · since ${timeOfDay(goal.at)}`));
    this.element = make("details", {class: "goal", open: $("active").children.length < MOST_OPEN},
      make("summary", {}, this.title, this.pill, this.clock, this.track),
      make("div", {}, this.steps, this.fields.element, foot));
  }

  show(goal) {
    this.goal = goal;
    const switchTo = goal.is_paused ? "Resume" : "Pause";
    setText(this.pause, switchTo);
    this.pause.setAttribute("aria-label", `${switchTo} ${goal.action}`);
    const progress = progressOf(goal), facts = progress?.of ? {reached: `${progress.done} of ${progress.of}`} : {};
    const turtle = turtleOf(goal, this.goals.names());
    setText(this.title, turtle && !goal.action.startsWith(`/${turtle}/`) ? `${goal.action} · ${turtle}` : goal.action);
    const shown = goal.feedback ? "feedback" : "request";
    this.fields.show({...facts, ...goal[shown], ...facts}, this.notations[shown], goal.series);
    this.#showProgress(progress);
    this.#showSteps(goal, progress);
    this.tick(goal);
  }

  tick(goal) {
    const {watch} = this.goals, isLost = !watch.connection.isUp;
    setPill(this.pill, goal, isLost);
    this.cancel.disabled = this.pause.disabled = isLost || !["ACCEPTED", "EXECUTING"].includes(goal.status);
    setText(this.clock, seconds(Math.max(0, watch.time() - goal.accepted)));
  }

  #showProgress(progress) {
    this.track.hidden = progress?.share == null;
    if (this.track.hidden) return;
    const percent = Math.round(progress.share * 100);
    this.bar.style.width = `${percent}%`;
    this.track.setAttribute("aria-valuenow", percent);
  }

  #showSteps(goal, progress) {
    const count = progress?.of ? placesIn(goal.request?.targets).length : 0;
    this.steps.hidden = !count || count > 30;
    if (this.steps.hidden) return;
    while (this.steps.children.length < count) this.steps.append(make("li"));
    const next = progress.done % count, isOver = progress.done >= progress.of;
    [...this.steps.children].forEach((step, index) => {
      const isDone = isOver || index < next;
      step.className = isDone ? "done" : index === next ? "next" : "";
      setText(step, `${index + 1}${isDone ? " ✓" : index === next ? " →" : ""}`);
      step.setAttribute("aria-label", `target ${index + 1}${isDone ? ", reached" : index === next ? ", next" : ""}`);
    });
  }
}

class Line {
  hasEnded = true;
  notations = {};

  constructor(goals, goal) {
    this.pill = make("span", {class: "pill"});
    this.what = make("span", {class: "what"});
    this.clock = make("span", {class: "clock"});
    this.body = make("div");
    const summary = make("summary", {}, this.pill, make("b", {}, goal.action), this.what, this.clock);
    this.element = make("details", {class: "goal"}, summary, this.body);
    this.element.ontoggle = () => this.#fill();
  }

  show(goal) {
    this.goal = goal;
    setPill(this.pill, goal);
    const asked = goal.request ? inWords(firstOf(goal.request)) : "";
    const came = goal.result && goal.status === "SUCCEEDED" ? inWords(firstOf(goal.result)) : "";
    setText(this.what, goal.reason || [asked, came].filter(Boolean).join(" → "));
    setText(this.clock, [goal.duration === null ? "" : seconds(goal.duration), timeOfDay(goal.at)].filter(Boolean).join(" · "));
    this.#fill();
  }

  // What is shown when the line is opened; most lines never are.
  #fill() {
    if (!this.element.open) return;
    const {goal} = this, parts = [];
    if (goal.reason) parts.push(make("p", {class: "reason"}, goal.reason));
    for (const [part, title] of Object.entries({request: "Goal", result: "Result", feedback: "Last feedback"})) {
      if (!goal[part] || !Object.keys(goal[part]).length) continue;
      const list = new FieldList();
      list.show(goal[part], this.notations[part], part === "feedback" ? goal.series : {});
      parts.push(make("p", {class: "part"}, title), list.element);
    }
    parts.push(make("p", {class: "dim"}, `${goal.type} · ${goal.id}`));
    this.body.replaceChildren(...parts);
  }
}

// A short view of a message: its first field, of many places only how many they are.
function firstOf(values) {
  const [name, value] = Object.entries(values)[0] ?? [];
  if (name === undefined) return "";
  const places = Array.isArray(value) ? placesIn(value).length : 0;
  if (places > 2) return `${places} ${label(name)}`;
  return typeof value === "object" && !places ? value : `${label(name)} ${inWords(value)}`;
}
