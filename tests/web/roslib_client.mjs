// What an unchanged roslib does against a bridge, and says on each line what it saw.
// Its arguments are the address of the folder of packages and the port of the bridge.
const [packages, port] = process.argv.slice(2);
const { Action, Ros, Service, Topic } = await import(`${packages}/roslib/dist/RosLib.js`);

const tell = (name, value) => console.log(JSON.stringify([name, value]));
const ros = new Ros({ url: `ws://127.0.0.1:${port}` });
await new Promise((resolve, reject) => { ros.on("connection", resolve); ros.on("error", reject); });

// topics, in each compression; what is heard is published again, one up
const up = new Topic({ ros, name: "/up", messageType: "geometry_msgs/Point" });
up.advertise();
for (const compression of ["none", "png", "cbor", "cbor-raw"]) {
  const down = new Topic({ ros, name: "/down", messageType: "geometry_msgs/Point", compression });
  tell(compression, await new Promise(resolve => down.subscribe(message => {
    down.unsubscribe();
    up.publish({ x: 2 });
    resolve(message.bytes ? [...new Uint8Array(message.bytes)].length : message);
  })));
}

// services, both ways
const add = new Service({ ros, name: "/add", serviceType: "example_interfaces/AddTwoInts" });
tell("sum", await new Promise(resolve => add.callService({ a: 1, b: 2 }, resolve)));
tell("refused", await new Promise(resolve => add.callService({ a: "one" }, resolve, resolve)));
const multiply = new Service({ ros, name: "/multiply", serviceType: "example_interfaces/AddTwoInts" });
await new Promise(resolve => multiply.advertise((request, response) => {
  response.sum = request.a * request.b;
  if (request.a < 0) resolve();
  return request.a >= 0;
}));

// goals that succeed, are canceled one by one and all at once, aborted, and rejected
const count = new Action({ ros, name: "/count", actionType: "lab_interfaces/Count" });
for (const [name, upto] of [["succeeded", 2], ["canceled", 1000], ["all canceled", 1000], ["aborted", -2], ["rejected", -1]]) {
  const heard = [];
  await new Promise(resolve => {
    const id = count.sendGoal(
      { upto },
      result => { heard.push(["result", result]); resolve(); },
      feedback => {
        heard.push(["feedback", feedback]);
        if (name === "canceled") count.cancelGoal(id);
        if (name === "all canceled") count.cancelAllGoals();
      },
      error => { heard.push(["failed", error]); resolve(); },
    );
  });
  tell(name, heard);
}

// a goal that it serves itself
const served = new Action({ ros, name: "/served", actionType: "lab_interfaces/Count" });
await new Promise(resolve => served.advertise(
  (goal, id) => {
    served.sendFeedback(id, { so_far: [goal.upto] });
    if (goal.upto > 0) served.setSucceeded(id, { counted: [goal.upto] });
  },
  id => { served.setCanceled(id, { counted: [7] }); resolve(); },
));

tell("topics", (await new Promise(resolve => ros.getTopics(resolve))).topics.sort());
ros.close();
