// Large files go in pieces (tus 1.0): a broken connection costs the last piece only, and a file that
// is picked again after a reload goes on where it was.

import { Problem, Unreachable, call, send } from "./api.js";

export const LARGE_BYTES = 8 << 20;
const PIECE_BYTES = 4 << 20;
const MOST_FAILURES = 6;
const TUS = { "Tus-Resumable": "1.0.0" };
// The upload goes on elsewhere than thought, is still being written to, or the service is busy.
const GOES_ON = [408, 409, 429, 460, 502, 503, 504];

/** Upload a blob; `onProgress` gets the fraction that has arrived. */
export async function uploadInPieces(blob, filename, onProgress, signal) {
  const memory = memoryOf(blob, filename);
  let place = memory.get();
  let state = place === null ? null : await stateOf(place, signal);
  for (let failures = 0; ; ) {
    try {
      if (state === null) {
        place = await begin(blob, filename, signal);
        memory.set(place);
        state = { offset: 0, asset: null };
      }
      if (state.asset !== null) {
        memory.clear();
        return { id: state.asset };
      }
      const before = state.offset;
      const piece = blob.slice(before, before + PIECE_BYTES);
      const tell = (fraction) => onProgress((before + fraction * piece.size) / blob.size);
      const headers = {
        ...TUS, "Upload-Offset": before, "Content-Type": "application/offset+octet-stream",
      };
      const request = await send("PATCH", place, headers, piece, tell, signal);
      state = stateIn((name) => request.getResponseHeader(name));
      failures = 0;
    } catch (error) {
      const passes = error instanceof Unreachable || GOES_ON.includes(error.status);
      if (!passes || ++failures > MOST_FAILURES) throw error;
      await pause(250 * 2 ** failures, signal);
      state = await stateOf(place, signal, state);
    }
  }
}

async function begin(blob, filename, signal) {
  const bytes = new TextEncoder().encode(filename);
  const name = btoa(String.fromCharCode(...bytes));
  const headers = { ...TUS, "Upload-Length": blob.size, "Upload-Metadata": `filename ${name}` };
  const reply = await call("/v1/uploads", { method: "POST", headers, signal });
  return new URL(reply.headers.get("Location"), location.href).pathname;
}

/** How far an upload is; null if it is gone, `known` if the service does not answer. */
async function stateOf(place, signal, known = null) {
  if (place === null) return null;
  try {
    const reply = await call(place, { method: "HEAD", headers: TUS, signal });
    return stateIn((name) => reply.headers.get(name));
  } catch (error) {
    if (error.name === "AbortError") throw error;
    return error instanceof Problem && [404, 410].includes(error.status) ? null : known;
  }
}

function stateIn(header) {
  return { offset: Number(header("Upload-Offset")), asset: header("Raykiln-Asset") };
}

/** Where the upload of a file is remembered; of what is made on the page nothing is. */
function memoryOf(blob, filename) {
  const key = `raykiln-upload:${filename}:${blob.size}:${blob.lastModified}`;
  const isFile = blob instanceof File;
  return {
    get: () => (isFile ? sessionStorage.getItem(key) : null),
    set: (place) => isFile && sessionStorage.setItem(key, place),
    clear: () => sessionStorage.removeItem(key),
  };
}

function pause(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(new DOMException("Stopped", "AbortError"));
    });
  });
}
