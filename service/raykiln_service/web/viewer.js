// The image of a job: live while it renders, then the film itself with exposure, view and layers.

import { call } from "./api.js";
import { h, setText } from "./dom.js";
import { FINAL_STATES, radiance } from "./format.js";
import { Inspector, layerName } from "./inspector.js";
import { Picture } from "./picture.js";
import { Stage } from "./stage.js";
import { VIEWS } from "./view.js";

const MAX_EXR_BYTES = 500e6;
const LARGE_BYTES = 8e6;
const SCALARS = new Set(["depth", "variance"]);
// Kept from job to job: whoever judges takes in one light looks at all of them so.
const look = { exposure: 0, view: "srgb", layer: "beauty", comparing: false };

export class Viewer {
  #stage = new Stage({ onPixel: (pixel) => this.#inspect(pixel), onZoom: (scale) => setText(this.#zoom, `${Math.round(scale * 100)} %`) });
  #inspector = new Inspector();
  #picture = null;
  #info = null;
  #loaded = null;
  #wanted = null;
  #drawing = false;
  #stale = false;
  #pixel = null;

  #layers = h("div.segments", { role: "radiogroup", "aria-label": "Layer" });
  #view = h("select", { name: "view", onchange: () => this.#set({ view: this.#view.value }) },
    Object.entries(VIEWS).map(([value, name]) => h("option", { value }, name)));
  #exposure = h("input", { type: "range", name: "exposure", min: -8, max: 8, step: 0.1, oninput: () => this.#set({ exposure: Number(this.#exposure.value) }) });
  #stops = h("output");
  #reset = h("button.quiet", { type: "button", onclick: () => this.#set({ exposure: 0 }) }, "Reset");
  #compare = h("input", { type: "checkbox", name: "compare", onchange: () => this.#set({ comparing: this.#compare.checked }) });
  #compareBox = h("label.toggle", { hidden: true }, this.#compare, "Before / after");
  #range = h("span.range");
  #zoom = h("output", { "aria-label": "Zoom" });
  #note = h("p.stage-note", { role: "status" });
  #light = h("div.light", {},
    h("label", {}, "View", this.#view),
    h("label.exposure", {}, "Exposure", this.#exposure), this.#stops, this.#reset);
  #bar = h("div.viewer-bar", {}, h("div.choice", {}, this.#layers, this.#compareBox, this.#range), this.#light,
    h("div.zoom", { role: "group", "aria-label": "Zoom" },
      h("button.quiet", { type: "button", "aria-label": "Zoom out", onclick: () => this.#stage.zoomBy(0.8) }, "−"),
      this.#zoom,
      h("button.quiet", { type: "button", "aria-label": "Zoom in", onclick: () => this.#stage.zoomBy(1.25) }, "+"),
      h("button.quiet", { type: "button", onclick: () => this.#stage.fit() }, "Fit"),
      h("button.quiet", { type: "button", "aria-label": "Pixel by pixel", onclick: () => this.#stage.zoomTo(1) }, "1:1")));
  element = h("section.viewer", { "aria-label": "Image" }, this.#bar, this.#stage.element, this.#inspector.element);

  constructor() {
    this.#stage.element.append(this.#note);
    this.#layers.parentElement.hidden = true;
    this.#showLook();
  }

  /** Exposure, view, layer: what the person has set. */
  get look() {
    return look;
  }

  close() {
    this.#wanted = null;
    this.#picture?.close();
    this.#stage.observer.disconnect();
  }

  /**
   * Show the best image that there is.
   * @param {object} source { exr, png, preview }: outputs of the job, and the preview's address
   * @param {string} key changes whenever the preview does
   * @param {string} state of the job
   */
  async update({ exr, png, preview, key, state }) {
    const isFinal = FINAL_STATES.has(state);
    const whole = isFinal && exr && exr.size_bytes <= MAX_EXR_BYTES ? exr : null;
    const picture = isFinal ? png?.href ?? preview : preview;
    this.#wanted = { whole, picture, key: whole ? whole.sha256 : `${key} ${picture}`, tooLarge: isFinal && exr && !whole };
    if (!whole && !picture) this.#say({ queued: "Waiting for its turn", running: "Loading the scene" }[state] ?? "There is no image");
    while (this.#wanted && this.#wanted.key !== this.#loaded && (this.#wanted.whole || this.#wanted.picture)) {
      if (this.loading) return;
      this.loading = true;
      const { whole: film, picture: small } = this.#wanted;
      // A large film takes its time: there is something to see meanwhile.
      const first = film?.size_bytes > LARGE_BYTES && small && this.#stage.isEmpty;
      await this.#load(first ? { picture: small, key: small } : this.#wanted).finally(() => (this.loading = false));
      if (first) this.#say("Reading the film…");
    }
  }

  async #load({ whole, picture, key, tooLarge }) {
    this.#loaded = key;
    const fresh = new Picture();
    try {
      if (this.#stage.isEmpty) this.#say("Loading the image");
      let trouble = tooLarge ? "too large for the browser" : null;
      let info = whole && (await this.#readExr(fresh, whole).catch((error) => ((trouble = error.message), null)));
      if (!info && picture) info = await fresh.readPng(await (await call(picture)).blob());
      if (!info) throw new Error(trouble ?? "there is no image");
      this.#use(fresh, info);
      this.#say(trouble ? `Showing the 8 bit picture: ${trouble}.` : "");
    } catch (error) {
      fresh.close();
      // Early on there is no preview yet; the next one brings another try.
      this.#say(whole || error.status !== 404 ? `The image could not be shown: ${error.message}` : "Waiting for the first samples");
    }
  }

  async #readExr(picture, { href }) {
    return picture.readExr(await (await call(href)).arrayBuffer());
  }

  #use(picture, info) {
    if (!this.#wanted) return void picture.close();
    this.#picture?.close();
    this.#picture = picture;
    this.#info = info;
    this.#showLayers();
    this.#showLook();
    this.#draw();
    this.#inspect(this.#pixel);
  }

  #layer() {
    return this.#info?.layers.includes(look.layer) ? look.layer : this.#info?.layers[0];
  }

  #isComparing() {
    return look.comparing && this.#layer() === "beauty" && this.#info.layers.includes("noisy");
  }

  #set(changed) {
    Object.assign(look, changed);
    this.#showLook();
    this.#draw();
    this.onLook?.(look);
  }

  #showLook() {
    const layer = this.#layer() ?? "beauty";
    this.#view.value = look.view;
    this.#exposure.value = look.exposure;
    setText(this.#stops, `${look.exposure > 0 ? "+" : ""}${look.exposure.toFixed(1)} EV`);
    this.#exposure.setAttribute("aria-valuetext", this.#stops.textContent);
    this.#reset.disabled = look.exposure === 0;
    this.#light.classList.toggle("off", SCALARS.has(layer) || layer === "normal");
    this.#compare.checked = look.comparing;
    this.#compareBox.hidden = !(layer === "beauty" && this.#info?.layers.includes("noisy"));
  }

  #showLayers() {
    const names = this.#info.layers;
    this.#layers.parentElement.hidden = names.length < 2;
    if (this.#layers.dataset.names === names.join()) return;
    this.#layers.dataset.names = names.join();
    this.#layers.replaceChildren(...names.map((name) => h("label", {},
      h("input", { type: "radio", name: "layer", value: name, checked: name === this.#layer(), onchange: () => this.#set({ layer: name }) }),
      layerName(name === "beauty" ? "Beauty" : name))));
  }

  async #draw() {
    if (!this.#picture) return;
    this.#stale = true;
    if (this.#drawing) return;
    this.#drawing = true;
    while (this.#stale) {
      this.#stale = false;
      try {
        await this.#drawOnce(this.#picture, this.#info);
      } catch (error) {
        if (!this.#stale) this.#say(`The image could not be shown: ${error.message}`);
      }
    }
    this.#drawing = false;
  }

  async #drawOnce(picture, info) {
    const comparing = this.#isComparing();
    const { pixels, range } = await picture.develop(this.#layer(), look);
    const before = comparing ? await picture.develop("noisy", look) : null;
    if (picture !== this.#picture) return void (this.#stale = true);
    this.#stage.paint("main", info, pixels);
    if (before) this.#stage.paint("before", info, before.pixels);
    this.#stage.comparing = comparing;
    setText(this.#range, range ? `${radiance(range[0])} to ${radiance(range[1])}` : "");
  }

  #inspect(pixel) {
    this.#pixel = pixel;
    if (pixel && this.#picture) this.#inspector.show(this.#picture, this.#info, pixel);
    else this.#inspector.clear();
  }

  #say(text) {
    setText(this.#note, text);
    this.#note.hidden = text === "";
  }
}
