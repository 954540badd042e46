// Making and changing elements. Text is always text here: nothing on these pages is parsed as HTML.

const AS_PROPERTY = new Set(["value", "checked", "disabled", "hidden", "open", "selected", "indeterminate"]);

/**
 * An element: h("button.primary", { type: "button", onclick: run }, "Render").
 * Children that are null or false are left out.
 */
export function h(kind, properties = {}, ...children) {
  const [tag, ...classes] = kind.split(".");
  const element = document.createElement(tag);
  if (classes.length) element.className = classes.join(" ");
  assign(element, properties);
  add(element, children);
  return element;
}

/** The same for SVG. */
export function svg(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  add(element, children);
  return element;
}

function assign(element, properties) {
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "dataset") Object.assign(element.dataset, value);
    else if (AS_PROPERTY.has(name)) element[name] = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false) element.setAttribute(name, value);
  }
}

function add(element, children) {
  const present = children.flat(3).filter((child) => child !== null && child !== undefined && child !== false);
  element.append(...present);
}

/** Replace an element's children, if the key says that they would differ. */
export function fill(element, key, make) {
  const wanted = JSON.stringify(key);
  if (element.dataset.filled === wanted) return;
  element.dataset.filled = wanted;
  element.replaceChildren(...[make()].flat(3).filter(Boolean));
}

/** Set a text only where it differs, so that screen readers and selections are left alone. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Say something to a screen reader, without showing it. */
export function announce(text) {
  document.querySelector("#announcements").textContent = text;
}

/** At most one call in `wait_ms`; the last wish is always carried out. */
export function throttled(run, wait_ms) {
  let timer = null;
  let last = -Infinity;
  return () => {
    if (timer !== null) return;
    timer = setTimeout(() => {
      timer = null;
      last = performance.now();
      run();
    }, Math.max(0, last + wait_ms - performance.now()));
  };
}
