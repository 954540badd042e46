// Files as one upload: a scene as it is, or a zip of a scene with all that lies beside it.

const SCENE_SUFFIXES = [".json", ".glb", ".gltf", ".xml", ".usda", ".usdc", ".usdz", ".usd", ".pbrt", ".obj", ".ply", ".stl"];
const LITTER = /(^|\/)(\.[^/]*|__MACOSX|Thumbs\.db|desktop\.ini)(\/|$)/i;
const MAX_ZIP_BYTES = 0xffff_ffff;
const MAX_ZIP_FILES = 0xffff;

/**
 * What was chosen, as one upload.
 * @param {{path: string, file: File}[]} files
 * @returns {{name: string, bytes: number, entries: string[], blob: () => Promise<Blob>}}
 *   entries: the scene files in it, likeliest first; empty where the service finds them itself.
 */
export function bundleOf(files) {
  const kept = files.filter(({ path }) => !LITTER.test(path));
  if (kept.length === 0) throw new Error("There are no files in it");
  const bytes = kept.reduce((sum, { file }) => sum + file.size, 0);
  if (kept.length === 1) {
    const { path, file } = kept[0];
    const name = path.split("/").pop();
    return { name, bytes, entries: [], blob: async () => file };
  }
  if (bytes > MAX_ZIP_BYTES - 16e6 || kept.length > MAX_ZIP_FILES) throw new Error("Too much for one upload from a browser; use raykiln submit");
  const entries = kept.map(({ path }) => path).filter(isScene).sort(byLikelihood);
  if (entries.length === 0) throw new Error(`None of these files is a scene (${SCENE_SUFFIXES.join(" ")})`);
  const [root] = kept[0].path.split("/");
  const name = kept.every(({ path }) => path.startsWith(`${root}/`)) ? `${root}.zip` : "scene.zip";
  return { name, bytes, entries, blob: () => zip(kept) };
}

export function isScene(path) {
  return SCENE_SUFFIXES.some((suffix) => path.toLowerCase().endsWith(suffix));
}

/** Shallow ones first; formats that hold whole scenes before those that hold parts. */
function byLikelihood(a, b) {
  const depth = (path) => path.split("/").length;
  const rank = (path) => SCENE_SUFFIXES.findIndex((suffix) => path.toLowerCase().endsWith(suffix));
  return depth(a) - depth(b) || rank(a) - rank(b) || (a < b ? -1 : 1);
}

/** The files of a drop, those of dropped folders too. */
export async function filesOfDrop(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (entries.length === 0) return filesOfInput(transfer.files);
  return (await Promise.all(entries.map((entry) => filesUnder(entry, "")))).flat();
}

export function filesOfInput(list) {
  return [...list].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
}

async function filesUnder(entry, folder) {
  const path = `${folder}${entry.name}`;
  if (entry.isFile) return [{ path, file: await new Promise((resolve, reject) => entry.file(resolve, reject)) }];
  const reader = entry.createReader();
  const found = [];
  for (;;) {
    // A folder is told in parts.
    const part = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (part.length === 0) break;
    found.push(...part);
  }
  return (await Promise.all(found.map((child) => filesUnder(child, `${path}/`)))).flat();
}

/** A zip that stores its files as they are; they are read once, for their checksums. */
async function zip(files) {
  const parts = [];
  const directory = [];
  let offset = 0;
  for (const { path, file } of files) {
    const name = new TextEncoder().encode(path);
    const fields = { crc: await crcOf(file), size: file.size, name };
    const head = record(0x04034b50, localFields(fields), name);
    directory.push(record(0x02014b50, centralFields(fields, offset), name));
    parts.push(head, file);
    offset += head.length + file.size;
  }
  const length = directory.reduce((sum, entry) => sum + entry.length, 0);
  const end = [[2, 0], [2, 0], [2, files.length], [2, files.length], [4, length], [4, offset], [2, 0]];
  return new Blob([...parts, ...directory, record(0x06054b50, end, new Uint8Array())], { type: "application/zip" });
}

const VERSION = 20, NAMES_ARE_UTF8 = 0x0800, STORED = 0, MIDNIGHT = 0, JANUARY_1980 = 0x21;

function localFields({ crc, size, name }) {
  return [[2, VERSION], [2, NAMES_ARE_UTF8], [2, STORED], [2, MIDNIGHT], [2, JANUARY_1980], [4, crc], [4, size], [4, size], [2, name.length], [2, 0]];
}

function centralFields(fields, offset) {
  return [[2, VERSION], ...localFields(fields), [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]];
}

function record(signature, fields, name) {
  const all = [[4, signature], ...fields];
  const size = all.reduce((sum, [width]) => sum + width, 0);
  const bytes = new Uint8Array(size + name.length);
  const view = new DataView(bytes.buffer);
  let at = 0;
  for (const [width, value] of all) {
    if (width === 2) view.setUint16(at, value, true);
    else view.setUint32(at, value, true);
    at += width;
  }
  bytes.set(name, size);
  return bytes;
}

const CRC = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit++) value = value & 1 ? (value >>> 1) ^ 0xedb88320 : value >>> 1;
  return value >>> 0;
});

async function crcOf(file) {
  const reader = file.stream().getReader();
  let crc = 0xffff_ffff;
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return (crc ^ 0xffff_ffff) >>> 0;
    for (const byte of value) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  }
}
