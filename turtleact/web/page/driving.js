// Driving a turtle with the arrow keys on the map, and with the buttons below it.

import {$} from "./elements.js";

const DRIVES = {ArrowUp: [2, 0], ArrowDown: [-2, 0], ArrowLeft: [0, 2], ArrowRight: [0, -2]};
const EVERY = 100; // ms: turtlesim stops a turtle that hears nothing for a second

export class Driving {
  #keys = new Set();
  #driven = "";
  #timer = 0;

  constructor(connection, world, chosen) {
    Object.assign(this, {connection, chosen});
    const canvas = $("world");
    canvas.onkeydown = event => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.key in DRIVES) this.press(event.key);
      else if (event.key === "+" || event.key === "=") world.zoom(1.5);
      else if (event.key === "-") world.zoom(1 / 1.5);
      else if (event.key === "0") world.showAll();
      else return;
      event.preventDefault();
    };
    canvas.onkeyup = event => this.release(event.key);
    canvas.onblur = () => this.stop();
    addEventListener("blur", () => this.stop());
    for (const button of document.querySelectorAll("[data-drive]")) this.#hold(button, button.dataset.drive);
  }

  press(key) {
    if (this.#keys.has(key)) return;
    this.#keys.add(key);
    this.#drive();
    this.#timer ||= setInterval(() => this.#drive(), EVERY);
  }

  release(key) {
    if (this.#keys.delete(key)) this.#drive();
  }

  stop() {
    for (const key of [...this.#keys]) this.release(key);
  }

  #hold(button, key) {
    const press = () => { button.classList.add("on"); this.press(key); };
    const release = () => { button.classList.remove("on"); this.release(key); };
    button.onpointerdown = press;
    button.onpointerup = button.onpointerleave = button.onpointercancel = button.onblur = release;
    button.oncontextmenu = event => event.preventDefault();
    button.onkeydown = event => {
      if (event.key !== " " && event.key !== "Enter") return;
      press();
      event.preventDefault();
    };
    button.onkeyup = release;
  }

  #drive() {
    const isOver = !this.#keys.size, name = isOver ? this.#driven : this.chosen();
    if (isOver) {
      clearInterval(this.#timer);
      this.#timer = 0;
    }
    this.#driven = isOver ? "" : name;
    if (!name) return;
    const [linear, angular] = [...this.#keys].reduce(([l, a], key) => [l + DRIVES[key][0], a + DRIVES[key][1]], [0, 0]);
    const twist = {linear: {x: linear}, angular: {z: angular}};
    this.connection.publish(`/${name}/cmd_vel`, "geometry_msgs/msg/Twist", twist);
  }
}
