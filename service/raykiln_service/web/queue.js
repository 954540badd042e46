// Whether the queue takes jobs to the renderer, and the switch for it.

import { call, getJson } from "./api.js";
import { fill, h, throttled } from "./dom.js";

export class QueuePanel {
  element = h("div.queue", { role: "status" });
  // Counts the switches: what was asked before one is no news after it.
  #switches = 0;
  #read = throttled(() => this.#load(), 2000);

  constructor() {
    this.#load();
  }

  refresh() {
    this.#read();
  }

  async #load() {
    const before = this.#switches;
    try {
      const queue = await getJson("/v1/queue");
      if (before === this.#switches) this.#show(queue);
    } catch {
      // The list goes on without it.
    }
  }

  #show(queue) {
    fill(this.element, [queue.paused, queue.queued], () => {
      const name = queue.paused ? "Resume the queue" : "Pause the queue";
      return [
        queue.paused && h("span.badge.paused", {}, "queue paused"),
        h("button.quiet", { type: "button", onclick: () => this.#set(!queue.paused) }, name),
      ];
    });
  }

  async #set(paused) {
    this.#switches++;
    try {
      this.#show(await (await call(`/v1/queue/${paused ? "pause" : "resume"}`, { method: "POST" })).json());
    } catch (error) {
      this.element.append(h("span.bad", {}, error.message));
    }
    this.element.querySelector("button")?.focus();
  }
}
