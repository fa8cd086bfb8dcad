// What Foxglove and Lichtblick do against a bridge: the calls of their rosbridge player, in its
// order, by their unchanged libraries. On each line it says what it saw.
// Its arguments are the address of the folder of packages and the port of the bridge.
import { createRequire } from "node:module";
const [packages, port] = process.argv.slice(2);
const require = createRequire(`${packages}/`);
globalThis.WebSocket = require("ws"); // as a browser has it
const roslib = require("@foxglove/roslibjs");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const tell = (name, value) => console.log(JSON.stringify([name, value]));
const ask = (method, ...args) => new Promise((resolve, reject) => ros[method](...args, (...given) => resolve(given), reject));
const ros = new roslib.Ros({ url: `ws://127.0.0.1:${port}` });
await new Promise((resolve, reject) => { ros.on("connection", resolve); ros.on("error", reject); });

// which topics there are, of which types; whether this is ROS 2 is told by one of them
const [{ topics, types, typedefs_full_text }] = await ask("getTopicsAndRawTypes");
tell("is ROS 2", types.includes("rcl_interfaces/msg/Log"));
const readers = new Map();
topics.forEach((topic, index) => {
  readers.set(topic, new MessageReader(parse(typedefs_full_text[index], { ros2: true })));
});

// the messages of each of them, as they are on the wire; the type is left out
const heard = topics.map(name => new Promise(resolve => {
  const topic = new roslib.Topic({ ros, name, compression: "cbor-raw" });
  topic.subscribe(({ bytes }) => {
    topic.unsubscribe();
    resolve([name, readers.get(name).readMessage(new Uint8Array(bytes))]);
  });
}));

// every node, and what it has
const [nodes] = await ask("getNodes");
for (const node of nodes) tell(node, await ask("getNodeDetails", node));

// a service, called by the type that it is said to have
const [serviceType] = await ask("getServiceType", "/add");
const add = new roslib.Service({ ros, name: "/add", serviceType });
const answers = new Promise((resolve, reject) => add.callService({ a: 1, b: 2 }, resolve, reject));
tell("sum", [serviceType, await answers]);

// a topic that it publishes to: whoever hears it publishes to all the others
const up = new roslib.Topic({ ros, name: "/up", messageType: "geometry_msgs/msg/Point", queue_size: 0 });
up.advertise();
up.publish({ x: 1, y: 2, z: 3 });
const numbers = (_, value) => (typeof value === "bigint" ? Number(value) : ArrayBuffer.isView(value) ? [...value] : value);
for (const [name, message] of await Promise.all(heard.filter((_, index) => topics[index] !== "/rosout"))) {
  tell(name, JSON.parse(JSON.stringify(message, numbers)));
}
ros.close();
