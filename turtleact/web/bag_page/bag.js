// A recorded world: the map at one moment, goals as bars, and a slider over the whole bag.

import {$, make, setText} from "./elements.js";
import {kindOf} from "./goals.js";
import {World} from "./world.js";

const WINDOW = 10; // of poses that are fetched together (s)
const KEPT = 24; // windows
const TRAIL = 20; // (s)
const INK = ["rgb(255 255 255 / .55)", 3];

const get = async path => {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
};

// Poses by topic, fetched a window at a time; the latest windows are kept.
class Poses {
  #windows = new Map();

  constructor({duration, first}, onnews) {
    Object.assign(this, {duration, first, onnews});
  }

  // The window with a moment, or null while it is on its way.
  at(time) {
    const index = Math.floor(time / WINDOW), held = this.#windows.get(index);
    if (held !== undefined) return held;
    this.#windows.set(index, null);
    const start = index * WINDOW, end = Math.min(start + WINDOW, this.duration + 1);
    get(`poses?start=${start}&end=${Math.max(start, end)}`).then(found => {
      this.#windows.set(index, found);
      for (const old of [...this.#windows.keys()].slice(0, -KEPT)) this.#windows.delete(old);
      this.onnews();
    }, error => {
      this.#windows.delete(index);
      setText($("about"), error.message);
    });
    return null;
  }

  // The last pose of a topic up to a moment, from its window or the one before. Before the first
  // pose of the bag, that pose.
  pose(topic, time) {
    const first = this.first[topic];
    if (first && time < first[0]) return first;
    for (const moment of [time, time - WINDOW]) {
      if (moment < 0) break;
      const found = this.at(moment)?.[topic] ?? [], last = found[before(found, time)];
      if (last) return last;
    }
    return null;
  }

  // The poses of a topic in the seconds up to a moment.
  trail(topic, time) {
    const points = [];
    for (let moment = Math.max(0, time - TRAIL); moment < time + WINDOW; moment += WINDOW) {
      const found = this.at(Math.min(moment, time))?.[topic] ?? [];
      for (const each of found) if (each[0] <= time && each[0] > (points.at(-1)?.[0] ?? time - TRAIL)) points.push(each);
    }
    return points.map(([, x, y]) => [x, y, ...INK]);
  }
}

// The place of the last entry whose time has come; -1 if there is none.
function before(found, time) {
  let low = 0, high = found.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (found[middle][0] <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

class Bag extends EventTarget {
  goals = new Map();
  trails = new Map();
  heard = new Map();
  #time = 0;
  #isPlaying = false;
  #shown = -1;

  constructor(about) {
    super();
    this.about = about;
    this.all = [];
    this.poses = new Poses(about, () => this.#show());
    this.graph = {poses: about.poses, hues: about.hues};
    const draft = Object.assign(new EventTarget(), {places: () => [], addPlace() {}, turtle: ""});
    const connection = {subscribe: (topic, _, heard) => this.heard.set(topic, heard), unsubscribe() {}};
    this.world = new World(connection, this, draft, {chosen: () => "", choose() {}});
    this.dispatchEvent(new CustomEvent("graph"));
    this.#listen();
    this.#show();
  }

  get time() {
    return this.#time;
  }

  seek(time) {
    this.#time = Math.min(Math.max(time, 0), this.about.duration);
    this.#show();
  }

  take(goals) {
    this.all = goals;
    const names = [...new Set(goals.map(goal => goal.action))].sort();
    $("rows").replaceChildren(...names.flatMap(name => this.#row(name)));
    this.#show();
  }

  #row(name) {
    const lane = make("div", {class: "lane"}), {duration} = this.about;
    for (const goal of this.all.filter(each => each.action === name)) {
      const from = Math.max(0, goal.start / duration), to = (goal.end ?? (goal.has_ended ? goal.start : duration)) / duration;
      const bar = make("i", {class: kindOf(goal.status), title: goal.status.toLowerCase(), tabindex: 0, role: "button"});
      bar.style.left = `${(from * 100).toFixed(3)}%`;
      bar.style.width = `${(Math.max(0, to - from) * 100).toFixed(3)}%`;
      bar.onclick = event => { event.stopPropagation(); this.#choose(goal); };
      bar.onkeydown = ({key}) => { if (key === "Enter" || key === " ") this.#choose(goal); };
      lane.append(bar);
    }
    lane.append(make("b"));
    lane.onclick = event => {
      const box = lane.getBoundingClientRect();
      this.seek((event.clientX - box.left) / box.width * duration);
    };
    return [make("span", {class: "name", title: name}, name), lane];
  }

  #choose(goal) {
    this.seek(Math.max(0, goal.start));
    const told = goal.end === null ? goal.status : `${goal.status} after ${(goal.end - goal.start).toFixed(1)} s`;
    const part = (name, value) => [make("h3", {}, name), make("pre", {}, value === null ? "not recorded" : JSON.stringify(value, null, 1))];
    $("told").replaceChildren(make("h3", {}, goal.action), make("p", {class: "dim"}, `${goal.id}: ${told}, ${goal.feedback_count} feedback`),
      ...part("Goal", goal.request), ...part("Result", goal.result));
  }

  #listen() {
    $("scrub").max = this.about.duration;
    $("scrub").oninput = () => this.seek(Number($("scrub").value));
    $("play").onclick = () => this.#play(!this.#isPlaying);
    $("all").onclick = () => this.world.showAll();
    document.onkeydown = event => {
      if (event.key === " " && event.target === document.body) { event.preventDefault(); this.#play(!this.#isPlaying); }
    };
  }

  #play(isPlaying) {
    if (isPlaying && this.#time >= this.about.duration) this.#time = 0;
    this.#isPlaying = isPlaying;
    setText($("play"), isPlaying ? "Stop" : "Play");
    let last = performance.now();
    const frame = now => {
      if (!this.#isPlaying) return;
      // Time waits for poses that are still on their way.
      const isThere = !Object.keys(this.about.poses).length || this.poses.at(this.#time) !== null;
      if (isThere) this.seek(this.#time + (now - last) / 1000 * Number($("speed").value));
      last = now;
      if (this.#time >= this.about.duration) this.#play(false);
      else requestAnimationFrame(frame);
    };
    if (isPlaying) requestAnimationFrame(frame);
  }

  #show() {
    const time = this.#time, {duration, poses} = this.about;
    $("scrub").value = time;
    setText($("time"), `${time.toFixed(1)} s`);
    for (const line of document.querySelectorAll("#rows b")) line.style.left = `${time / duration * 100}%`;
    for (const topic of Object.keys(poses)) {
      const pose = this.poses.pose(topic, time), name = topic.replace(/^\//, "").replace(/\/pose$/, "");
      if (pose) this.heard.get(topic)?.({x: pose[1], y: pose[2], theta: pose[3]});
      this.trails.set(name, this.poses.trail(topic, time));
    }
    if (time + 2 < duration) this.poses.at(time + 2); // soon needed
    this.goals = new Map(this.all.filter(goal => goal.start <= time && !((goal.end ?? Infinity) < time) && goal.status !== "REJECTED")
      .map(goal => [goal.id, {...goal, status: "EXECUTING", has_ended: false, feedback: {reached: goal.reached.filter(each => each <= time).length}, series: {}}]));
    if (this.#shown !== time) this.dispatchEvent(new CustomEvent("trails", {detail: true}));
    this.#shown = time;
    this.world.refresh();
  }
}

const about = await get("bag").catch(error => {
  setText($("about"), error.message);
  throw error;
});
setText($("name"), about.name);
document.title = about.name;
setText($("about"), `${about.messages} messages, ${about.duration.toFixed(1)} s${about.is_closed ? "" : ", not closed"}`);
$("topics").append(...about.topics.flatMap(([name, type, count]) => [make("dt", {title: type}, name), make("dd", {}, String(count))]));
export const bag = new Bag(about);
try {
  bag.take(await get("goals"));
} catch (error) {
  setText($("about"), error.message);
}
