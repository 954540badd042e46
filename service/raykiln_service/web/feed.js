// News of all jobs, by one stream: browsers allow few connections to one host.

import { call } from "./api.js";

const SILENCE_MS = 40_000;
const MAX_PAUSE_MS = 8_000;

/**
 * Tells its listeners { kind, job, ... }: "state", "progress", "preview", "deleted" of a job;
 * "fresh" when what was read before may be out of date; "offline" and "online".
 * The stream is closed while nobody looks at the page.
 */
export class Feed {
  #listeners = new Set();
  #stop = null;

  start() {
    document.addEventListener("visibilitychange", () => (document.hidden ? this.#close() : this.#open()));
    window.addEventListener("online", () => this.retryNow());
    if (!document.hidden) this.#open();
  }

  /** Returns a function that ends the listening. */
  listen(listener) {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }

  retryNow() {
    if (document.hidden) return;
    this.#close();
    this.#open();
  }

  #tell(news) {
    for (const listener of [...this.#listeners]) listener(news);
  }

  #close() {
    this.#stop?.abort();
    this.#stop = null;
  }

  #open() {
    if (this.#stop) return;
    this.#stop = new AbortController();
    this.#run(this.#stop.signal);
  }

  async #run(signal) {
    let pause = 500;
    while (!signal.aborted) {
      try {
        await this.#follow(signal, () => (pause = 500));
      } catch {
        // The pause below, and another try.
      }
      if (signal.aborted) return;
      this.#tell({ kind: "offline" });
      await new Promise((resolve) => setTimeout(resolve, pause));
      pause = Math.min(MAX_PAUSE_MS, pause * 1.6);
    }
  }

  async #follow(signal, connected) {
    const silent = new AbortController();
    const reply = await call("/v1/events", { signal: AbortSignal.any([signal, silent.signal]) });
    connected();
    this.#tell({ kind: "online" });
    this.#tell({ kind: "fresh" });
    let timer = null;
    const heard = () => {
      clearTimeout(timer);
      timer = setTimeout(() => silent.abort(), SILENCE_MS);
    };
    try {
      heard();
      for await (const { type, data } of eventsOf(reply.body, heard)) {
        this.#tell(type === "reload" ? { kind: "fresh" } : { ...data, kind: type });
      }
    } finally {
      clearTimeout(timer);
    }
  }
}

/** The Server-Sent Events of a stream. */
export async function* eventsOf(body, heard = () => {}) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    heard();
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const fields = {};
      for (const line of block.split("\n")) {
        const colon = line.indexOf(":");
        if (colon > 0) fields[line.slice(0, colon)] = line.slice(colon + 1).trimStart();
      }
      if (fields.data) yield { type: fields.event, data: JSON.parse(fields.data) };
    }
  }
}
