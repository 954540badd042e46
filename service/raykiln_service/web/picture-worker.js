// Holds the pixels of one picture, away from the page's thread: reading, developing, looking up.

import { ExrError, readExr } from "/web/exr.js";
import { develop, linear, rangeOf } from "/web/view.js";

let picture = null;

const LINEAR = Float32Array.from({ length: 256 }, (_, value) => linear(value / 255));

const tasks = {
  async exr({ buffer }) {
    return keep(await readExr(buffer), true);
  },

  /** An 8 bit picture as if it were linear light: what was too bright or dark for it is lost. */
  async png({ blob }) {
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
    const { width, height } = bitmap;
    const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, width, height);
    const planes = [0, 1, 2].map((channel) => Float32Array.from({ length: width * height }, (_, i) => LINEAR[data[4 * i + channel]]));
    return keep({ width, height, x: 0, y: 0, layers: new Map([["beauty", { names: ["R", "G", "B"], planes }]]) }, false);
  },

  develop({ name, view, exposure }) {
    const layer = picture.layers.get(name);
    const pixels = develop(layer, { name, view, exposure });
    return { pixels, range: layer.planes.length < 3 ? rangeOf(layer.planes[0]) : null };
  },

  look({ x, y }) {
    const at = y * picture.width + x;
    return [...picture.layers].map(([name, { names, planes }]) => ({ name, names, values: planes.map((plane) => plane[at]) }));
  },
};

function keep(read, exact) {
  picture = read;
  const { width, height, x, y, layers } = read;
  return { width, height, x, y, exact, layers: [...layers.keys()] };
}

// One after the other: a look must not fall between two pictures.
let last = Promise.resolve();

addEventListener("message", ({ data: { id, task, ...options } }) => {
  last = last.then(async () => {
    try {
      const result = await tasks[task](options);
      postMessage({ id, result }, result.pixels ? [result.pixels.buffer] : []);
    } catch (error) {
      postMessage({ id, error: error.message, isLimit: error instanceof ExrError });
    }
  });
});
