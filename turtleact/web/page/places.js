// Which turtle a goal moves, and where to: as its fields say.

// All pairs of x and y in plain values, in order; what was cut off counts as unknown.
export function placesIn(value) {
  if (Array.isArray(value)) return value.flatMap(placesIn);
  if (value === null || typeof value !== "object") return [];
  if (typeof value.x === "number" && typeof value.y === "number") return [{x: value.x, y: value.y}];
  return Object.values(value).flatMap(placesIn);
}

// "/turtle1/rotate_absolute" moves turtle1, and so does a goal with places that names no turtle.
export function turtleOf(goal, names) {
  const named = goal.request?.turtle;
  if (typeof named === "string" && named) return named.replace(/^\//, "");
  const owner = goal.action.slice(1).split("/").slice(0, -1).join("/");
  if (names.includes(owner)) return owner;
  return placesIn(goal.request).length && names.includes("turtle1") ? "turtle1" : "";
}

// How far a goal is: {done, of, share} as far as its fields tell, else null.
export function progressOf({request, feedback, series, status}) {
  if (status === "SUCCEEDED") return {share: 1};
  if (!feedback) return null;
  const places = placesIn(request?.targets ?? []).length;
  const of = places * (1 + Math.max(0, request?.loops ?? 0));
  const left = Object.entries(series).find(([path]) => /(^|_)(remaining|left)$/.test(path));
  const share = left && left[1][0][1] ? 1 - Math.abs(left[1].at(-1)[1] / left[1][0][1]) : null;
  if (of && typeof feedback.reached === "number") {
    return {done: feedback.reached, of, share: Math.max(share ?? 0, feedback.reached / of)};
  }
  return share === null ? null : {share: Math.min(1, Math.max(0, share))};
}
