// The pictures of a job that makes several, and choosing one of them.

import { getJson } from "./api.js";
import { fill, h, setText, throttled } from "./dom.js";
import { fileLink } from "./downloads.js";
import { FINAL_STATES } from "./format.js";
import { Thumbnail } from "./thumbnails.js";

const PAGE = 200;

export class Frames {
  #strip = h("div.strip", { role: "radiogroup", "aria-label": "Frame" });
  #count = h("span.hint");
  #files = h("div.files");
  element = h("section.panel.frames", { "aria-label": "Frames", hidden: true },
    h("div.line", {}, h("h2", {}, "Frames"), this.#count), this.#strip, this.#files);
  #tiles = new Map();
  #job = null;
  #chosen = null;
  #read = throttled(() => this.#load(), 1000);

  /** `onChange` is called when another frame is to be shown, or the chosen one has changed. */
  constructor(onChange) {
    this.onChange = onChange;
  }

  /** What the viewer is to show, if a frame is chosen. */
  get chosen() {
    const frame = this.#tiles.get(this.#chosen)?.frame;
    return frame ? sourceOf(frame) : null;
  }

  update(job) {
    this.#job = job;
    this.element.hidden = !job.frames;
    if (!job.frames) return;
    this.#read();
  }

  /** The job has come further: maybe by a frame. */
  progress({ frames_done: done, frame }) {
    if (this.element.hidden || (done === this.done && frame === this.frame)) return;
    this.done = done;
    this.frame = frame;
    this.#read();
  }

  async #load() {
    const frames = [];
    let cursor = null;
    try {
      do {
        const query = new URLSearchParams({ limit: PAGE, ...(cursor && { cursor }) });
        const page = await getJson(`${this.#job.links.frames}?${query}`);
        frames.push(...page.items);
        cursor = page.next_cursor;
      } while (cursor);
    } catch {
      return;
    }
    for (const frame of frames) this.#show(frame);
    const having = (state) => frames.filter((frame) => frame.state === state).length;
    setText(this.#count, `${having("succeeded")} of ${frames.length} done${having("failed") ? `, ${having("failed")} failed` : ""}`);
    // Until someone chooses, a job that has ended shows its first picture.
    const first = frames.find(({ outputs }) => outputs.length > 0);
    if (this.#chosen === null && first && FINAL_STATES.has(this.#job.state)) this.#choose(first.number);
    else this.onChange();
  }

  #show(frame) {
    let tile = this.#tiles.get(frame.number);
    if (!tile) {
      tile = tileOf(frame, () => this.#choose(frame.number));
      this.#tiles.set(frame.number, tile);
      this.#strip.append(tile.element);
    }
    tile.frame = frame;
    tile.element.className = `tile ${frame.state}`;
    tile.element.title = frame.error ? `${frame.name}: ${frame.error.detail}` : `${frame.name}: ${frame.state}`;
    tile.radio.disabled = frame.outputs.length === 0;
    setText(tile.state, frame.state === "succeeded" ? "" : frame.state);
    const picture = frame.outputs.find(({ name }) => name.endsWith(".png"));
    if (picture) tile.thumbnail.want(picture.href, picture.sha256);
  }

  #choose(number) {
    this.#chosen = number;
    const { frame, radio } = this.#tiles.get(number);
    radio.checked = true;
    fill(this.#files, [frame.number, frame.outputs], () =>
      frame.outputs.map(({ name, href, size_bytes: size }) => fileLink(name, href, { size, text: `${frame.name} ${name}`, filename: `${frame.name}-${name}` })));
    this.onChange();
  }

  close() {
    for (const { thumbnail } of this.#tiles.values()) thumbnail.close();
  }
}

function tileOf(frame, choose) {
  const thumbnail = new Thumbnail();
  const radio = h("input.unseen", { type: "radio", name: "frame", value: frame.number, onchange: choose });
  const state = h("small");
  const element = h("label", {}, radio, thumbnail.element, h("span.line", {}, frame.name, state));
  return { element, radio, state, thumbnail };
}

function sourceOf({ outputs, state, number }) {
  const find = (suffix) => outputs.find(({ name }) => name === `image.${suffix}`);
  return { exr: find("exr"), png: find("png"), preview: null, key: `frame ${number}`, state };
}
