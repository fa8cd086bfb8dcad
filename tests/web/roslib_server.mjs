// An action server in JavaScript, with an unchanged roslib: Fibonacci numbers until it is killed.
// Its arguments are the address of the folder of packages and that of the bridge.
const [packages, url] = process.argv.slice(2);
const { Action, Ros } = await import(`${packages}/roslib/dist/RosLib.js`);

const ros = new Ros({ url });
const served = new Action({ ros, name: "/served", actionType: "example_interfaces/Fibonacci" });
served.advertise(
  ({ order }, id) => {
    if (order === 0) return served.setFailed(id);
    const sequence = [0, 1];
    served.sendFeedback(id, { sequence: [...sequence, 1] });
    if (order < 0) return; // until it is canceled
    for (let at = 1; at < order; at++) {
      sequence.push(sequence[at] + sequence[at - 1]);
      if (at > 1) served.sendFeedback(id, { sequence });
    }
    served.setSucceeded(id, { sequence });
  },
  id => served.setCanceled(id, { sequence: [7] }),
);
