// From linear radiance to what a display shows: the same transforms as raykiln.image.view, whose
// sources are named there.

export const VIEWS = { srgb: "sRGB", agx: "AgX", aces: "ACES", raw: "Raw" };

const BRIGHTEST = 1e6;
const ACES_IN = [[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]];
const ACES_OUT = [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]];
const AGX_IN = [
  [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
  [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
  [0.0423756549057051, 0.0784336, 0.879142973793104],
];
const AGX_OUT = inverse(AGX_IN);
const [AGX_LEAST, AGX_MOST] = [-12.47393, 4.026069];
const AGX_SIGMOID = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];

// The sRGB curve over the square root of the light, where it is close to a line.
const STEPS = 16384;
const SRGB = Float32Array.from({ length: STEPS + 1 }, (_, i) => 255 * srgb((i / STEPS) ** 2));

export function srgb(linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055;
}

export function linear(encoded) {
  return encoded <= 0.04045 ? encoded / 12.92 : ((encoded + 0.055) / 1.055) ** 2.4;
}

/**
 * RGBA bytes of a layer.
 * @param {{names: string[], planes: Float32Array[]}} layer
 * @param {{name: string, view: string, exposure: number}} how
 */
export function develop(layer, { name, view, exposure }) {
  const { planes } = layer;
  const pixels = new Uint8ClampedArray(planes[0].length * 4);
  if (name === "normal" && planes.length === 3) mapped(pixels, planes, (value) => 127.5 + 127.5 * value);
  else if (planes.length < 3) mapped(pixels, [planes[0]], stretch(rangeOf(planes[0])));
  else if (view === "agx" || view === "aces") filmic(pixels, planes, gainOf(exposure), view === "agx" ? agx : aces);
  else curved(pixels, planes, gainOf(exposure), view === "raw");
  return pixels;
}

/** Least and largest value where something was met (depth is 0 elsewhere). */
export function rangeOf(plane) {
  let [least, most] = [Infinity, -Infinity];
  for (const value of plane) {
    if (!Number.isFinite(value) || value === 0) continue;
    if (value < least) least = value;
    if (value > most) most = value;
  }
  return least <= most ? [least, most] : [0, 0];
}

function gainOf(exposure) {
  return 2 ** Math.min(Math.max(exposure, -120), 120);
}

function stretch([least, most]) {
  const scale = most > least ? 235 / (most - least) : 0;
  return (value) => (value === 0 || !Number.isFinite(value) ? 0 : 20 + (value - least) * scale);
}

function mapped(pixels, planes, shown) {
  const [first, second = first, third = first] = planes;
  for (let i = 0, o = 0; i < first.length; i++, o += 4) {
    pixels[o] = shown(first[i]);
    pixels[o + 1] = shown(second[i]);
    pixels[o + 2] = shown(third[i]);
    pixels[o + 3] = 255;
  }
}

function curved(pixels, planes, gain, raw) {
  planes.slice(0, 3).forEach((plane, channel) => {
    for (let i = 0, o = channel; i < plane.length; i++, o += 4) {
      const value = plane[i] * gain;
      if (!(value > 0)) pixels[o] = 0;
      else if (value >= 1) pixels[o] = 255;
      else pixels[o] = raw ? 255 * value : SRGB[Math.round(Math.sqrt(value) * STEPS)];
    }
  });
  for (let o = 3; o < pixels.length; o += 4) pixels[o] = 255;
}

function filmic(pixels, [red, green, blue], gain, transform) {
  const colour = new Float64Array(3);
  for (let i = 0, o = 0; i < red.length; i++, o += 4) {
    colour[0] = exposed(red[i] * gain);
    colour[1] = exposed(green[i] * gain);
    colour[2] = exposed(blue[i] * gain);
    transform(colour);
    pixels[o] = colour[0];
    pixels[o + 1] = colour[1];
    pixels[o + 2] = colour[2];
    pixels[o + 3] = 255;
  }
}

function exposed(value) {
  return value > 0 ? Math.min(value, BRIGHTEST) : 0;
}

function multiply(matrix, colour) {
  const [r, g, b] = colour;
  for (let row = 0; row < 3; row++) {
    const m = matrix[row];
    colour[row] = m[0] * r + m[1] * g + m[2] * b;
  }
}

function aces(colour) {
  multiply(ACES_IN, colour);
  for (let c = 0; c < 3; c++) {
    const v = colour[c];
    colour[c] = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081);
  }
  multiply(ACES_OUT, colour);
  for (let c = 0; c < 3; c++) colour[c] = SRGB[Math.round(Math.sqrt(Math.min(1, Math.max(0, colour[c]))) * STEPS)];
}

function agx(colour) {
  multiply(AGX_IN, colour);
  for (let c = 0; c < 3; c++) {
    const stops = Math.log2(Math.max(colour[c], 2 ** AGX_LEAST));
    const x = Math.min(1, (stops - AGX_LEAST) / (AGX_MOST - AGX_LEAST));
    colour[c] = AGX_SIGMOID.reduce((sum, coefficient) => sum * x + coefficient, 0);
  }
  multiply(AGX_OUT, colour);
  for (let c = 0; c < 3; c++) colour[c] *= 255;
}

function inverse([[a, b, c], [d, e, f], [g, h, i]]) {
  const cofactors = [
    [e * i - f * h, c * h - b * i, b * f - c * e],
    [f * g - d * i, a * i - c * g, c * d - a * f],
    [d * h - e * g, b * g - a * h, a * e - b * d],
  ];
  const determinant = a * cofactors[0][0] + b * cofactors[1][0] + c * cofactors[2][0];
  return cofactors.map((row) => row.map((value) => value / determinant));
}
