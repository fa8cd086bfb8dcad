// Small helpers for the page's elements. Text is only ever set as text, never as HTML.

export const $ = id => document.getElementById(id);

// make("p", {class: "dim", onclick: f}, "text", child, …)
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element[name] = value;
    else if (value !== false && value != null) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children);
  return element;
}

export function draw(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

// Sets text only if it differs: screen readers and the selection keep their place.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export const say = text => setText($("said"), text);

// Says how a promise ends.
export function report(promise, told = () => "") {
  promise.then(answer => say(told(answer)), error => say(error.message));
}

// News for screen readers.
export const announce = text => setText($("live"), text);
