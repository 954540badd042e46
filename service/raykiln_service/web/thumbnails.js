// Small pictures, fetched with the token when they come into view, a few at a time.

import { call } from "./api.js";
import { h } from "./dom.js";

const AT_ONCE = 3;
const waiting = new Set();
let running = 0;

const watcher = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) owners.get(target)?.seen(isIntersecting);
}, { rootMargin: "200px" });
const owners = new WeakMap();

export class Thumbnail {
  element = h("span.thumbnail", {}, h("img", { alt: "", hidden: true }));
  #wanted = null;
  #shown = null;
  #visible = false;

  constructor() {
    owners.set(this.element, this);
    watcher.observe(this.element);
  }

  /** Show what is at `href`; `key` changes when the picture does. */
  want(href, key) {
    this.#wanted = href && { href, key: `${href} ${key}` };
    this.#ask();
  }

  seen(visible) {
    this.#visible = visible;
    this.#ask();
  }

  close() {
    watcher.unobserve(this.element);
    waiting.delete(this);
  }

  #ask() {
    if (this.#visible && this.#wanted && this.#wanted.key !== this.#shown) {
      waiting.add(this);
      next();
    } else waiting.delete(this);
  }

  async load() {
    const { href, key } = this.#wanted;
    this.#shown = key;
    try {
      const url = URL.createObjectURL(await (await call(href)).blob());
      const image = this.element.firstElementChild;
      image.onload = image.onerror = () => URL.revokeObjectURL(url);
      image.src = url;
      image.hidden = false;
    } catch {
      // No picture yet: the next preview brings another try.
    }
  }
}

async function next() {
  if (running >= AT_ONCE) return;
  const [first] = waiting;
  if (!first) return;
  waiting.delete(first);
  running++;
  await first.load();
  running--;
  next();
}
