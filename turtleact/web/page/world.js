// The map: turtles, their trails, and the places that goals lead to.

import {$, setText} from "./elements.js";
import {placesIn, progressOf, turtleOf} from "./places.js";
import {number} from "./values.js";

export const SIDE = 499 / 45; // of turtlesim's world (m)
const PIXELS = 500; // of turtlesim's window, in which pens are measured
const MANY = 12;
const MOST = 64;
const NEAREST = 1, FARTHEST = 12;

export class World {
  turtles = new Map();
  #canvas = $("world");
  #pen = this.#canvas.getContext("2d");
  #ink = document.createElement("canvas").getContext("2d");
  #view = {x: SIDE / 2, y: SIDE / 2, zoom: 1};
  #inked = "";
  #isStale = true;
  #pointers = new Map();
  #moved = 0;
  #spread = 0;

  // `draft` holds the places that are being picked; `chosen()` names the chosen turtle, and
  // `choose(name)` chooses another.
  constructor(connection, watch, draft, {chosen, choose}) {
    Object.assign(this, {connection, watch, draft, chosen, choose});
    watch.addEventListener("graph", () => this.#look());
    watch.addEventListener("trails", ({detail}) => { if (detail) this.#inked = ""; this.#isStale = true; });
    watch.addEventListener("goal", () => { this.#isStale = true; });
    watch.addEventListener("poses", ({detail}) => this.#placeAt(detail));
    draft.addEventListener("change", () => { this.#isStale = true; });
    new ResizeObserver(() => { this.#isStale = true; }).observe(this.#canvas);
    this.#listen();
    const frame = () => {
      if (this.#isStale) this.#draw();
      requestAnimationFrame(frame);
    };
    frame();
  }

  get names() {
    return [...this.turtles.keys()];
  }

  refresh() {
    this.#isStale = true;
  }

  // Which turtles there are; `onchange` hears of it.
  onchange() {}

  #look() {
    const found = new Map();
    for (const [topic, type] of Object.entries(this.watch.graph.poses)) {
      found.set(topic.slice(1, -"/pose".length), {topic, type});
    }
    let isNew = false;
    for (const [name, {topic, heard}] of this.turtles) {
      if (found.has(name)) continue;
      this.turtles.delete(name);
      this.connection.unsubscribe(topic, heard);
      isNew = true;
    }
    for (const [name, {topic, type}] of found) {
      if (this.turtles.has(name) || this.turtles.size >= MOST) continue;
      this.#add(name, topic, type, found.size > MANY ? 50 : 0);
      isNew = true;
    }
    if (isNew) this.onchange();
  }

  #add(name, topic, type, rate) {
    const turtle = {name, topic, pose: null, hue: this.watch.graph.hues[topic]};
    turtle.heard = pose => {
      const last = turtle.pose;
      turtle.pose = pose;
      if (!last || last.x !== pose.x || last.y !== pose.y || last.theta !== pose.theta) this.#isStale = true;
    };
    this.turtles.set(name, turtle);
    this.connection.subscribe(topic, type, turtle.heard, rate);
  }

  // In a paused world, turtles publish no poses.
  #placeAt(poses) {
    for (const [name, [x, y, theta]] of Object.entries(poses)) {
      const turtle = this.turtles.get(name);
      if (turtle) turtle.pose ??= {x, y, theta, linear_velocity: 0};
    }
    this.#isStale = true;
  }

  // drawing

  #draw() {
    this.#isStale = false;
    const canvas = this.#canvas, pen = this.#pen, dots = devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * dots), height = Math.round(canvas.clientHeight * dots);
    if (!width || !height) return; // the map is hidden
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    const unit = Math.min(width, height) / SIDE * this.#view.zoom;
    const shift = [width / 2 - this.#view.x * unit, height / 2 - (SIDE - this.#view.y) * unit];
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, width, height);
    const size = dots / unit;
    pen.setTransform(unit, 0, 0, unit, ...shift);
    this.#drawGrid(size);
    this.#drawTrails(width, height, unit, shift);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.#ink.canvas, 0, 0);
    pen.setTransform(unit, 0, 0, unit, ...shift);
    this.#drawEnds();
    for (const goal of this.watch.goals.values()) if (!goal.has_ended) this.#drawGoal(goal, size);
    this.#drawPlaces(this.draft.places(), {size, turtle: this.draft.turtle, isDraft: true});
    for (const turtle of this.turtles.values()) if (turtle.pose) this.#drawTurtle(turtle, size);
  }

  // A line each metre, numbers at each second one, and a darker ground outside of the world.
  #drawGrid(size) {
    const pen = this.#pen;
    pen.fillStyle = "rgb(0 0 40 / .45)";
    pen.beginPath();
    pen.rect(-SIDE, -SIDE, 3 * SIDE, 3 * SIDE);
    pen.rect(0, 0, SIDE, SIDE);
    pen.fill("evenodd");
    pen.strokeStyle = "rgb(255 255 255 / .13)";
    pen.fillStyle = "rgb(255 255 255 / .75)";
    pen.lineWidth = size;
    pen.font = `${11 * size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (let at = 1; at < SIDE; at++) {
      pen.strokeRect(at, 0, 0, SIDE);
      pen.strokeRect(0, SIDE - at, SIDE, 0);
      if (at % 2) continue;
      pen.fillText(at, at, SIDE - 9 * size);
      pen.fillText(at, 9 * size, SIDE - at);
    }
  }

  // Trails have a canvas of their own, which is kept while the view is the same.
  #drawTrails(width, height, unit, shift) {
    const view = [width, height, unit, ...shift].join(), ink = this.#ink;
    if (view !== this.#inked) {
      this.#inked = view;
      Object.assign(ink.canvas, {width, height});
      this.drawn = new Map();
    }
    ink.setTransform(unit, 0, 0, unit, ...shift);
    ink.lineCap = ink.lineJoin = "round";
    for (const [name, points] of this.watch.trails) {
      const last = points.at(-1), from = Math.max(1, points.lastIndexOf(this.drawn.get(name)) + 1);
      for (let i = from; i < points.length; i++) line(ink, points[i - 1], points[i]);
      if (last) this.drawn.set(name, last);
    }
  }

  // From the last known point to where the turtle is.
  #drawEnds() {
    const pen = this.#pen;
    pen.lineCap = "round";
    for (const {name, pose} of this.turtles.values()) {
      const last = this.watch.trails.get(name)?.at(-1);
      if (pose && last && Math.hypot(pose.x - last[0], pose.y - last[1]) < 1) line(pen, last, [pose.x, pose.y, last[2], last[3]]);
    }
  }

  #drawGoal(goal, size) {
    const places = placesIn(goal.request), turtle = turtleOf(goal, this.names);
    if (!places.length && goal.feedback?.target) places.push(...placesIn(goal.feedback.target));
    const progress = progressOf(goal), done = progress?.done ?? 0;
    const isOver = progress?.of && done >= progress.of;
    this.#drawPlaces(places, {size, turtle, next: isOver ? places.length : done % places.length});
  }

  // Places as numbered rings, with a dashed way from the turtle through those ahead.
  #drawPlaces(places, {size, turtle, next = 0, isDraft = false}) {
    if (!places.length) return;
    const pen = this.#pen, found = this.turtles.get(turtle), pose = found?.pose;
    const ahead = places.slice(next).map(({x, y}) => [x, SIDE - y]);
    if (pose) ahead.unshift([pose.x, SIDE - pose.y]);
    pen.strokeStyle = isDraft ? "#fff" : `hsl(${found?.hue ?? 0} 85% 85%)`;
    pen.lineWidth = 1.5 * size;
    pen.setLineDash([5 * size, 5 * size]);
    pen.beginPath();
    ahead.forEach(([x, y], index) => (index ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
    pen.setLineDash([]);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    places.forEach(({x, y}, index) => {
      const isDone = index < next, isNext = index === next && !isDraft;
      pen.beginPath();
      pen.arc(x, SIDE - y, (isNext ? 13 : 11) * size, 0, 7);
      pen.fillStyle = isDone ? "#0b7a50" : isDraft ? "#fff" : "#26339f";
      pen.fill();
      pen.strokeStyle = "#fff";
      pen.lineWidth = (isNext ? 3 : 1.5) * size;
      pen.stroke();
      pen.fillStyle = isDraft ? "#26339f" : "#fff";
      pen.font = `600 ${13 * size}px system-ui, sans-serif`;
      pen.fillText(isDone ? "✓" : index + 1, x, SIDE - y + size);
    });
  }

  #drawTurtle({name, pose: {x, y, theta}, hue}, size) {
    const pen = this.#pen, dark = `hsl(${hue} 60% 30%)`, light = `hsl(${hue} 65% 64%)`;
    const blob = (cx, cy, rx, ry, fill, turn = 0) => {
      pen.fillStyle = fill;
      pen.beginPath();
      pen.ellipse(cx, cy, rx, ry, turn, 0, 7);
      pen.fill();
    };
    pen.save();
    pen.translate(x, SIDE - y);
    pen.rotate(-theta);
    if (this.turtles.size > 1 && name === this.chosen()) {
      blob(0, 0, .58, .58, "rgb(255 255 255 / .18)");
      pen.strokeStyle = "#fff";
      pen.lineWidth = 1.5 * size;
      pen.stroke();
    }
    blob(.37, 0, .14, .11, light);
    for (const side of [1, -1]) {
      blob(.19, .23 * side, .12, .07, light, .7 * side);
      blob(-.2, .21 * side, .11, .065, light, -.6 * side);
      blob(.43, .045 * side, .02, .02, "#111");
    }
    blob(-.34, 0, .09, .03, light);
    blob(0, 0, .29, .24, dark);
    pen.strokeStyle = light;
    pen.lineWidth = .022;
    pen.beginPath();
    pen.ellipse(0, 0, .14, .12, 0, 0, 7);
    for (const a of [.6, 2.5, 3.8, 5.7]) {
      pen.moveTo(.14 * Math.cos(a), .12 * Math.sin(a));
      pen.lineTo(.28 * Math.cos(a), .23 * Math.sin(a));
    }
    pen.stroke();
    pen.restore();
    if (this.turtles.size < 20 || name === this.chosen()) this.#drawName(name, x, SIDE - y - .48 - 7 * size, size);
  }

  #drawName(name, x, y, size) {
    const pen = this.#pen, shown = name.length > 24 ? `${name.slice(0, 23)}…` : name;
    pen.font = `600 ${12.5 * size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const half = pen.measureText(shown).width / 2 + 2 * size;
    const at = [Math.min(Math.max(x, half), Math.max(half, SIDE - half)), Math.max(y, 9 * size)];
    pen.lineWidth = 3 * size;
    pen.strokeStyle = "rgb(20 26 90 / .7)";
    pen.strokeText(shown, ...at);
    pen.fillStyle = "#fff";
    pen.fillText(shown, ...at);
  }

  // the view

  zoom(factor, at = this.#view) {
    const view = this.#view, next = Math.min(Math.max(view.zoom * factor, NEAREST), FARTHEST), k = view.zoom / next;
    view.x = within(at.x + (view.x - at.x) * k);
    view.y = within(at.y + (view.y - at.y) * k);
    view.zoom = next;
    if (next === NEAREST) view.x = view.y = SIDE / 2;
    $("all").hidden = next === NEAREST;
    this.#canvas.classList.toggle("zoomed", next !== NEAREST);
    this.#isStale = true;
  }

  showAll() {
    this.zoom(0);
  }

  #place(event) {
    const box = this.#canvas.getBoundingClientRect(), unit = Math.min(box.width, box.height) / SIDE * this.#view.zoom;
    return {x: this.#view.x + (event.clientX - box.left - box.width / 2) / unit,
      y: this.#view.y - (event.clientY - box.top - box.height / 2) / unit, unit};
  }

  // A click picks a place or a turtle, a drag moves the view, two fingers zoom.
  #listen() {
    const canvas = this.#canvas, pointers = this.#pointers;
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), this.#place(event));
    }, {passive: false});
    canvas.onpointerdown = event => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, event);
      if (pointers.size === 1) this.#moved = 0;
      this.#spread = 0;
    };
    canvas.onpointermove = event => {
      const {x, y} = this.#place(event);
      setText($("at"), `${x.toFixed(2)}, ${y.toFixed(2)}`);
      this.#move(event);
    };
    canvas.onpointerleave = () => setText($("at"), "");
    canvas.onpointerup = event => {
      if (pointers.size === 1 && this.#moved <= 6) this.#pick(this.#place(event));
      pointers.delete(event.pointerId);
    };
    canvas.onpointercancel = event => pointers.delete(event.pointerId);
  }

  #move(event) {
    const pointers = this.#pointers, last = pointers.get(event.pointerId), view = this.#view;
    if (!last) return;
    const before = this.#place(last), now = this.#place(event);
    this.#moved += Math.hypot(event.clientX - last.clientX, event.clientY - last.clientY);
    pointers.set(event.pointerId, event);
    if (pointers.size === 2) {
      const [a, b] = [...pointers.values()], apart = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      this.#moved = 99;
      if (this.#spread) this.zoom(apart / this.#spread, now);
      this.#spread = apart;
    } else if (this.#moved > 6 && view.zoom > NEAREST) {
      view.x = within(view.x + before.x - now.x);
      view.y = within(view.y + before.y - now.y);
      this.#isStale = true;
    }
  }

  #pick({x, y, unit}) {
    const near = [...this.turtles.values()].find(({pose}) => pose && Math.hypot(pose.x - x, pose.y - y) < Math.max(.4, 14 / unit));
    if (near && this.turtles.size > 1 && near.name !== this.chosen()) this.choose(near.name);
    else if (x >= 0 && x <= SIDE && y >= 0 && y <= SIDE) this.draft.addPlace(x, y);
  }

  // The map in words, for those who do not see it.
  inWords() {
    const shown = [...this.turtles.values()].filter(({pose}) => pose).slice(0, 8);
    const told = shown.map(({name, pose}) => `${name} at ${number(pose.x)}, ${number(pose.y)}`);
    const rest = this.turtles.size - shown.length;
    return `The world: ${told.join("; ") || "no turtles"}${rest > 0 ? `; and ${rest} more` : ""}`;
  }
}

const within = value => Math.min(Math.max(value, 0), SIDE);

function line(pen, [x, y], [nextX, nextY, colour, width]) {
  if (!colour) return;
  pen.strokeStyle = colour;
  pen.lineWidth = width * SIDE / PIXELS;
  pen.beginPath();
  pen.moveTo(x, SIDE - y);
  pen.lineTo(nextX, SIDE - nextY);
  pen.stroke();
}
