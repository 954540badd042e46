// The pictures of a job that makes several, and choosing one of them.

import { h } from "./dom.js";

export class Frames {
  element = h("section.frames", { "aria-label": "Frames", hidden: true });
  chosen = null;

  constructor(onChoose) {
    this.onChoose = onChoose;
  }

  update() {
    this.element.hidden = true;
  }
}
