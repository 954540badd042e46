// The page's end of a picture: what picture-worker.js does, as promises.

export class Picture {
  #worker = new Worker("/web/picture-worker.js", { type: "module" });
  #waiting = new Map();
  #number = 0;

  constructor() {
    this.#worker.addEventListener("message", ({ data: { id, result, error } }) => {
      const { resolve, reject } = this.#waiting.get(id);
      this.#waiting.delete(id);
      if (error === undefined) resolve(result);
      else reject(new Error(error));
    });
    this.#worker.addEventListener("error", (event) => this.#fail(event.message || "the picture could not be read"));
  }

  /** @returns {Promise<{width, height, x, y, exact: boolean, layers: string[]}>} */
  readExr(buffer) {
    return this.#ask("exr", { buffer }, [buffer]);
  }

  readPng(blob) {
    return this.#ask("png", { blob });
  }

  /** @returns {Promise<{pixels: Uint8ClampedArray, range: number[]|null}>} */
  develop(name, { view, exposure }) {
    return this.#ask("develop", { name, view, exposure });
  }

  /** The values of all layers at a pixel. */
  look(x, y) {
    return this.#ask("look", { x, y });
  }

  close() {
    this.#worker.terminate();
    this.#fail("the picture was closed");
  }

  #fail(message) {
    for (const { reject } of this.#waiting.values()) reject(new Error(message));
    this.#waiting.clear();
  }

  #ask(task, options, transfer = []) {
    const id = this.#number++;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.#worker.postMessage({ id, task, ...options }, transfer);
    });
  }
}
