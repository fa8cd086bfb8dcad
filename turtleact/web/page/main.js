// The page: puts the parts together.

import {Connection} from "./connection.js";
import {Draft} from "./draft.js";
import {Driving} from "./driving.js";
import {$, announce, make, report, say, setText} from "./elements.js";
import {Goals} from "./goals.js";
import {Timeline} from "./timeline.js";
import {Topics} from "./topics.js";
import {Turtles} from "./turtles.js";
import {degrees} from "./values.js";
import {Watch} from "./watch.js";
import {World} from "./world.js";

const connection = new Connection(), watch = new Watch(connection), draft = new Draft(connection, watch);
const chosen = () => $("turtle").value;

function choose(name) {
  driving.stop();
  $("turtle").value = name;
  draft.chooseTurtle(name);
  turtles.refresh();
  world.refresh();
  showState();
}

const world = new World(connection, watch, draft, {chosen, choose});
const driving = new Driving(connection, world, chosen);
const turtles = new Turtles(connection, watch, world, chosen);
new Goals(watch, {names: () => world.names, describe: (action, type) => draft.describe(action, type)});
new Topics(connection, watch);
new Timeline(watch);

// the header

connection.addEventListener("up", () => { tell("connected", "good"); say(""); watch.follow(); });
connection.addEventListener("trying", () => tell("connecting …", ""));
connection.addEventListener("down", ({detail}) => { driving.stop(); tell(`not connected, trying again in ${detail / 1000} s`, "bad"); });
connection.addEventListener("status", ({detail}) => say(detail));
watch.addEventListener("problem", ({detail}) => say(detail));

function tell(text, kind) {
  setText($("line"), text);
  $("line").className = `pill ${kind}`;
  document.body.classList.toggle("down", kind !== "good");
  for (const each of document.querySelectorAll("#pause, #clear, #action, [data-drive]")) each.disabled = !connection.isUp;
  turtles.refresh();
}

const many = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
watch.addEventListener("graph", () => {
  const {nodes, actions} = watch.graph;
  setText($("graph"), `${many(nodes.length, "node")} · ${many(Object.keys(actions).length, "action")}`);
  $("pause").hidden = !watch.has("/world/set_simulation_state");
  turtles.refresh();
  // A graph without turtles needs no map.
  const hasMap = world.turtles.size > 0 || watch.has("/spawn");
  $("map").hidden = !hasMap;
  document.body.classList.toggle("bare", !hasMap);
});

const isPaused = () => watch.rate < .001;
function showRate() {
  const whole = Math.round(watch.rate), isWhole = Math.abs(watch.rate / whole - 1) < .15;
  setText($("rate"), !connection.isUp ? "" : isPaused() ? "paused" : `time ${isWhole ? whole : watch.rate.toFixed(1)}×`);
  setText($("pause"), isPaused() ? "Resume world" : "Pause world");
}
watch.addEventListener("time", showRate);
$("pause").onclick = () => {
  const rate = +isPaused(), state = 2 - rate; // PLAYING is 1, PAUSED 2
  $("pause").disabled = true;
  const call = connection.call("/world/set_simulation_state", {state: {state}});
  call.then(() => watch.expect(rate), () => {}).then(() => {
    $("pause").disabled = !connection.isUp;
    showRate();
  });
  report(call, ({result}) => result.error_message);
};

// the turtles

world.onchange = () => {
  const names = world.names, before = chosen();
  $("turtle").replaceChildren(...names.map(name => make("option", {}, name)));
  $("turtle").disabled = !names.length;
  draft.offerTurtles(world.turtles);
  choose(names.includes(before) ? before : names[0] ?? "");
};
$("turtle").onchange = () => choose(chosen());
$("spawn-here").onclick = () => turtles.spawnSomewhere();
$("clear").onclick = () => report(connection.call(watch.has("/clear") ? "/clear" : "/turtleact/web/clear_trails"));

function showState() {
  const pose = world.turtles.get(chosen())?.pose;
  const [place, motion] = $("state").children;
  setText(place, pose ? `x ${pose.x.toFixed(2)} · y ${pose.y.toFixed(2)}` : "");
  setText(motion, pose ? `${degrees(pose.theta)} · ${pose.linear_velocity.toFixed(1)} m/s` : "");
}
setInterval(() => {
  showState();
  if (!$("turtles").hidden) turtles.show();
}, 200);
setInterval(() => $("world").setAttribute("aria-label", world.inWords()), 2000);

$("nearer").onclick = () => world.zoom(1.5);
$("farther").onclick = () => world.zoom(1 / 1.5);
$("all").onclick = () => { world.showAll(); $("nearer").focus(); };

// the tabs: one can be reached with Tab, the others with the arrow keys

const tabs = [...document.querySelectorAll("[role=tab]")];
function open(tab) {
  for (const each of tabs) {
    each.setAttribute("aria-selected", each === tab);
    each.tabIndex = each === tab ? 0 : -1;
    $(each.getAttribute("aria-controls")).hidden = each !== tab;
  }
}
tabs.forEach((tab, index) => {
  const turn = tab => { // what was said belongs to the tab before
    if (tab.getAttribute("aria-selected") !== "true") say("");
    open(tab);
  };
  tab.onclick = () => turn(tab);
  tab.onkeydown = ({key}) => {
    const to = {ArrowRight: index + 1, ArrowLeft: index - 1, Home: 0, End: tabs.length - 1}[key];
    if (to === undefined) return;
    const next = tabs[(to + tabs.length) % tabs.length];
    turn(next);
    next.focus();
  };
});
open(tabs[0]);

draft.addEventListener("problem", () => open($("tab-send")));
draft.addEventListener("accepted", () => {
  const hadFocus = $("send").contains(document.activeElement);
  open($("tab-goals"));
  if (hadFocus) $("tab-goals").focus();
  announce(`${draft.action} has accepted the goal`);
});

connection.open();
