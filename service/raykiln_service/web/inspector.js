// What the film holds at one pixel, in numbers.

import { h } from "./dom.js";
import { radiance } from "./format.js";

const NAMES = { beauty: "Radiance", noisy: "Noisy", albedo: "Albedo", normal: "Normal", depth: "Depth", variance: "Variance" };

export function layerName(name) {
  return NAMES[name] ?? name;
}

/** Shows the values of the pixel that it is told of; keeps to the latest when it is told many. */
export class Inspector {
  element = h("div.inspector", { role: "status", "aria-label": "Pixel" });
  #wanted = null;
  #busy = false;

  constructor() {
    this.clear();
  }

  clear(text = "Point at the image, or click it to hold a pixel.") {
    this.#wanted = null;
    this.element.replaceChildren(h("p.hint", {}, text));
  }

  async show(picture, info, pixel) {
    this.#wanted = { picture, info, pixel };
    if (this.#busy) return;
    this.#busy = true;
    while (this.#wanted) {
      const now = this.#wanted;
      this.#wanted = null;
      try {
        this.#fill(now, await now.picture.look(now.pixel.x, now.pixel.y));
      } catch {
        // The picture was replaced meanwhile.
      }
    }
    this.#busy = false;
  }

  #fill({ info, pixel }, layers) {
    const place = `${info.x + pixel.x}, ${info.y + pixel.y}`;
    const title = info.exact ? "" : " · from the 8 bit picture";
    this.element.replaceChildren(
      h("p.place", {}, h("b", {}, place), title),
      h("dl", {}, layers.map((layer) => [h("dt", {}, layerName(layer.name)), h("dd", {}, valuesOf(layer))])));
  }
}

function valuesOf({ name, names, values }) {
  const shown = values.map((value, index) => h("span", {}, names[index] && h("i", {}, names[index]), radiance(value)));
  if (name !== "beauty" || values.length < 3) return shown;
  const luminance = 0.212671 * values[0] + 0.71516 * values[1] + 0.072169 * values[2];
  // In stops from mid grey, as a light meter would have it.
  const stops = luminance > 0 ? `${Math.log2(luminance / 0.18).toFixed(1)} EV` : "−∞ EV";
  return [...shown, h("span", {}, h("i", {}, "Lum"), radiance(luminance)), h("span", {}, stops)];
}
