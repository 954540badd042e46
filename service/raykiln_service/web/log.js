// The end of a job's log, kept up to date while one looks at it.

import { call } from "./api.js";
import { h, throttled } from "./dom.js";

const TAIL_BYTES = 64 * 1024;

export class Log {
  #text = h("pre", { tabindex: 0, "aria-label": "Log" });
  element = h("details.panel", { ontoggle: () => this.refresh() }, h("summary", {}, "Log"), this.#text);
  #read = throttled(() => this.#load(), 2000);

  constructor(href) {
    this.href = href;
  }

  refresh() {
    if (this.element.open) this.#read();
  }

  async #load() {
    try {
      const reply = await call(this.href, { headers: { Range: `bytes=-${TAIL_BYTES}` } });
      let text = await reply.text();
      if (reply.status === 206 && text.length >= TAIL_BYTES) text = `…\n${text.slice(text.indexOf("\n") + 1)}`;
      this.#show(text);
    } catch (error) {
      this.#show(error.status === 404 ? "Nothing yet." : error.message);
    }
  }

  #show(text) {
    if (this.#text.textContent === text) return;
    const atEnd = this.#text.scrollTop + this.#text.clientHeight >= this.#text.scrollHeight - 4;
    this.#text.textContent = text;
    if (atEnd) this.#text.scrollTop = this.#text.scrollHeight;
  }
}
