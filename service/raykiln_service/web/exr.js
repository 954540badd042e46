// Reads OpenEXR files as raykiln writes them: one part, scan lines, ZIP or uncompressed.
// Format: "OpenEXR File Layout", https://openexr.com/en/latest/OpenEXRFileLayout.html

const MAGIC = 20000630;
const TILED_DEEP_OR_MANY_PARTS = 0x1a00;
const LINES_PER_CHUNK = { 0: 1, 2: 1, 3: 16 };
const UINT = 0, HALF = 1;
const MAX_PIXELS = 24e6;
const MAX_CHANNELS = 128;

export class ExrError extends Error {}

/**
 * The pixels of a file.
 * @param {ArrayBuffer} buffer
 * @returns {Promise<{width: number, height: number, x: number, y: number,
 *   layers: Map<string, {names: string[], planes: Float32Array[]}>}>}
 *   x, y: where the first pixel lies in the whole frame.
 */
export async function readExr(buffer) {
  try {
    const header = readHeader(new DataView(buffer));
    const planes = await readPlanes(buffer, header);
    return { ...header.window, layers: layersOf(header.channels, planes) };
  } catch (error) {
    if (error instanceof RangeError) throw new ExrError("the EXR file is damaged");
    throw error;
  }
}

function readHeader(view) {
  if (view.getUint32(0, true) !== MAGIC) throw new ExrError("this is no EXR file");
  if (view.getUint32(4, true) & TILED_DEEP_OR_MANY_PARTS) throw new ExrError("tiled, deep and multi-part EXR files are not read here");
  const { attributes, end } = readAttributes(view, 8);
  const compression = view.getUint8(attributes.get("compression"));
  if (!(compression in LINES_PER_CHUNK)) throw new ExrError(`EXR compression ${compression} is not read here`);
  const window = windowAt(view, attributes.get("dataWindow"));
  const channels = readChannels(view, attributes.get("channels"));
  return { window, channels, lines: LINES_PER_CHUNK[compression], packed: compression !== 0, end };
}

function readAttributes(view, start) {
  const attributes = new Map();
  let at = start;
  while (view.getUint8(at) !== 0) {
    const name = textAt(view, at);
    const type = textAt(view, at + name.length + 1);
    const sizeAt = at + name.length + type.length + 2;
    attributes.set(name, sizeAt + 4);
    at = sizeAt + 4 + view.getUint32(sizeAt, true);
  }
  return { attributes, end: at + 1 };
}

function textAt(view, at) {
  let text = "";
  for (let code = view.getUint8(at); code !== 0; code = view.getUint8(++at)) text += String.fromCharCode(code);
  return text;
}

function windowAt(view, at) {
  const [x, y, right, bottom] = [0, 4, 8, 12].map((offset) => view.getInt32(at + offset, true));
  const [width, height] = [right - x + 1, bottom - y + 1];
  if (!(width > 0 && height > 0)) throw new ExrError("the EXR file has no pixels");
  if (width * height > MAX_PIXELS) throw new ExrError(`${width} × ${height} pixels are too many to read here`);
  return { width, height, x, y };
}

function readChannels(view, start) {
  const channels = [];
  let at = start;
  while (view.getUint8(at) !== 0) {
    const name = textAt(view, at);
    at += name.length + 1;
    const type = view.getUint32(at, true);
    if (type > 2) throw new ExrError(`EXR channel ${name} has an unknown type`);
    channels.push({ name, type, bytes: type === HALF ? 2 : 4 });
    at += 16;
  }
  if (channels.length > MAX_CHANNELS) throw new ExrError("the EXR file has too many channels");
  return channels;
}

async function readPlanes(buffer, { window, channels, lines, packed, end }) {
  const view = new DataView(buffer);
  const { width, height, y: top } = window;
  const planes = channels.map(() => new Float32Array(width * height));
  const lineBytes = width * channels.reduce((sum, channel) => sum + channel.bytes, 0);
  for (let chunk = 0; chunk * lines < height; chunk++) {
    const at = Number(view.getBigUint64(end + 8 * chunk, true));
    const first = view.getInt32(at, true) - top;
    const count = Math.min(lines, height - first);
    if (first < 0 || count < 1) throw new ExrError("the EXR file is damaged");
    const stored = new Uint8Array(buffer, at + 8, view.getUint32(at + 4, true));
    const size = lineBytes * count;
    // A chunk that would not shrink is stored as it is.
    const data = packed && stored.length < size ? await unpacked(stored, size) : stored.slice();
    spread(data, channels, planes, width, first, count);
  }
  return planes;
}

async function unpacked(stored, size) {
  const stream = new Blob([stored]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  if (bytes.length !== size) throw new ExrError("the EXR file is damaged");
  // Differences to values, then the two halves (even and odd bytes) woven together again.
  for (let i = 1; i < size; i++) bytes[i] = bytes[i - 1] + bytes[i] - 128;
  const woven = new Uint8Array(size);
  const half = (size + 1) >> 1;
  for (let i = 0, even = 0, odd = half; i < size;) {
    woven[i++] = bytes[even++];
    if (i < size) woven[i++] = bytes[odd++];
  }
  return woven;
}

function spread(data, channels, planes, width, first, count) {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  let at = 0;
  for (let line = first; line < first + count; line++) {
    channels.forEach((channel, index) => {
      const plane = planes[index];
      const start = line * width;
      for (let x = 0; x < width; x++, at += channel.bytes) plane[start + x] = valueAt(view, at, channel.type);
    });
  }
}

function valueAt(view, at, type) {
  if (type === HALF) return HALF_VALUES[view.getUint16(at, true)];
  return type === UINT ? view.getUint32(at, true) : view.getFloat32(at, true);
}

const HALF_VALUES = Float32Array.from({ length: 65536 }, (_, bits) => {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
});

const CHANNEL_ORDER = ["R", "G", "B", "X", "Y", "Z", "U", "V", "A"];
const LAYER_ORDER = ["beauty", "noisy", "albedo", "normal", "depth", "variance"];

/** Channels by layer; R, G, B are the layer "beauty", N.X, N.Y, N.Z the layer "normal". */
function layersOf(channels, planes) {
  const found = new Map();
  channels.forEach(({ name }, index) => {
    const dot = name.lastIndexOf(".");
    const suffix = name.slice(dot + 1);
    let layer = dot > 0 ? name.slice(0, dot) : suffix;
    if (dot <= 0 && ["R", "G", "B", "A", "Y"].includes(suffix)) layer = "beauty";
    if (layer === "N") layer = "normal";
    if (!found.has(layer)) found.set(layer, []);
    found.get(layer).push({ name: layer === suffix ? "" : suffix, plane: planes[index] });
  });
  const rank = (list, name) => (list.indexOf(name) + list.length + 1) % (list.length + 1);
  const sorted = [...found].sort(([a], [b]) => rank(LAYER_ORDER, a) - rank(LAYER_ORDER, b) || (a < b ? -1 : 1));
  return new Map(sorted.map(([layer, members]) => {
    members.sort((a, b) => rank(CHANNEL_ORDER, a.name) - rank(CHANNEL_ORDER, b.name));
    return [layer, { names: members.map(({ name }) => name), planes: members.map(({ plane }) => plane) }];
  }));
}
