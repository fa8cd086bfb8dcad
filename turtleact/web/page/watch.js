// What the server watches for all pages: goals, trails, the graph, and the time.

const MOST_POINTS = 2000;

export class Watch extends EventTarget {
  goals = new Map();
  trails = new Map();
  graph = {nodes: [], topics: {}, services: {}, actions: {}, poses: {}};
  now = 0;
  rate = 1;
  #session = "";
  #revision = 0;
  #measured = [0, 0];
  #run = 0;

  constructor(connection) {
    super();
    this.connection = connection;
    connection.addEventListener("down", () => {
      this.#stopped ??= this.time();
      this.#tell("time");
    });
  }

  // Events: "graph", "goal" (detail: {goal, before}), "dropped" (id), "trails" (detail:
  // whether lines were replaced), "poses" (of turtles with new trails), and "time".
  async follow() {
    const run = ++this.#run;
    this.#measured = [0, 0];
    while (run === this.#run && this.connection.isUp) {
      const args = {session: this.#session, since: this.#revision};
      let news;
      try {
        news = await this.connection.call("/turtleact/web/watch", args);
      } catch (error) {
        if (!this.connection.isUp) return;
        this.#tell("problem", error.message);
        await new Promise(later => setTimeout(later, 2000));
        continue;
      }
      this.#take(news);
    }
  }

  // The graph's time now (s), between two answers. Without a connection, it stands still.
  time() {
    return this.#stopped ?? this.now + this.rate * Math.min(2, (performance.now() - this.#heardAt) / 1000);
  }
  #heardAt = 0;
  #stopped = null;

  has(service) {
    return service in this.graph.services;
  }

  #take(news) {
    this.#stopped = null;
    this.#session = news.session;
    this.#revision = news.revision;
    this.#setTime(news.now);
    if (news.is_whole) {
      const kept = new Set(news.goals.map(goal => goal.id));
      for (const id of this.goals.keys()) if (!kept.has(id)) this.#drop(id);
      for (const name of this.trails.keys()) if (!(name in news.trails)) this.trails.delete(name);
    }
    if (news.graph) {
      this.graph = news.graph;
      this.#tell("graph");
    }
    for (const goal of news.goals.reverse()) {
      const before = this.goals.get(goal.id);
      this.goals.set(goal.id, goal);
      this.#tell("goal", {goal, before, isNews: !news.is_whole});
    }
    for (const id of news.dropped) this.#drop(id);
    this.#takeTrails(news.trails, news.is_whole);
    this.#tell("poses", news.poses);
    this.#tell("time");
  }

  #takeTrails(tails, isWhole) {
    let isReplaced = isWhole;
    for (const [name, tail] of Object.entries(tails)) {
      isReplaced ||= tail.is_whole;
      const points = tail.is_whole ? tail.points : [...(this.trails.get(name) ?? []), ...tail.points];
      this.trails.set(name, points.slice(-MOST_POINTS));
    }
    if (isReplaced || Object.keys(tails).length) this.#tell("trails", isReplaced);
  }

  expect(rate) {
    this.rate = rate;
    this.#measured = [0, 0];
  }

  // The clock's rate is measured over a second, as answers come irregularly.
  #setTime(now) {
    const here = performance.now(), [then, at] = this.#measured;
    if (!at || now < then) this.#measured = [now, here];
    else if (here - at > 900) {
      this.rate = (now - then) * 1000 / (here - at);
      this.#measured = [now, here];
    }
    this.now = now;
    this.#heardAt = here;
  }

  #drop(id) {
    if (this.goals.delete(id)) this.#tell("dropped", id);
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, {detail}));
  }
}
