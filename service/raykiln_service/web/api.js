// Calls to the service: the token, problems as errors, and uploads that tell how far they are.

const TOKEN_KEY = "raykiln-token";
let token = sessionStorage.getItem(TOKEN_KEY);
let askForToken = null;
let asking = null;

/** The service said no. `problem` is its document (RFC 9457). */
export class Problem extends Error {
  constructor(problem) {
    super(problem.detail ?? problem.title ?? `HTTP ${problem.status}`);
    this.problem = problem;
    this.status = problem.status;
  }

  /** "scene.json /shapes/0/radius: … (found -1); accepted: …" */
  get text() {
    const { file, pointer, found, accepted } = this.problem;
    const place = [file, pointer].filter(Boolean).join(" ");
    return `${place ? `${place}: ` : ""}${this.message}`
      + `${found ? ` (found ${found})` : ""}${accepted ? `; accepted: ${accepted}` : ""}`;
  }
}

/** The service did not answer. */
export class Unreachable extends Error {
  constructor() {
    super("The service does not answer");
  }
}

/** Who asks the person for a token: an async function of whether an earlier one was refused. */
export function onTokenWanted(ask) {
  askForToken = ask;
}

export function hasToken() {
  return token !== null;
}

export function forgetToken() {
  token = null;
  sessionStorage.removeItem(TOKEN_KEY);
}

/** fetch with the token; asks for it when the service wants one. */
export async function call(path, options = {}) {
  for (;;) {
    const used = token;
    const reply = await reach(path, options, used);
    if (reply.status !== 401) {
      if (!reply.ok) throw await problemOf(reply);
      return reply;
    }
    // Several calls may be refused at once: one of them asks, all wait.
    if (used === token) await (asking ??= newToken(used !== null).finally(() => (asking = null)));
  }
}

async function newToken(refused) {
  token = await askForToken(refused);
  sessionStorage.setItem(TOKEN_KEY, token);
}

async function reach(path, options, used) {
  const headers = new Headers(options.headers);
  if (used) headers.set("Authorization", `Bearer ${used}`);
  try {
    return await fetch(path, { ...options, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Unreachable();
  }
}

async function problemOf(reply) {
  const document = await reply.json().catch(() => ({ title: `HTTP ${reply.status}` }));
  return new Problem({ status: reply.status, ...document });
}

export async function getJson(path, options) {
  return (await call(path, options)).json();
}

export async function postJson(path, body, headers = {}) {
  const text = typeof body === "string" ? body : JSON.stringify(body);
  const options = { method: "POST", body: text, headers: { "Content-Type": "application/json", ...headers } };
  return (await call(path, options)).json();
}

/** Upload a small file or blob in one call; `onProgress` gets the fraction that is sent. */
export async function upload(blob, filename, onProgress, signal) {
  const path = `/v1/assets?filename=${encodeURIComponent(filename)}`;
  // Makes sure of the token before much is sent.
  if (!hasToken()) await call("/v1/version", { signal });
  const headers = { "Content-Type": "application/octet-stream" };
  return parsed((await send("POST", path, headers, blob, onProgress, signal)).responseText);
}

/** Send a body, with the token, and tell how much of it is sent; the answered request. */
export function send(method, path, headers, body, onProgress, signal) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open(method, path);
    if (token) request.setRequestHeader("Authorization", `Bearer ${token}`);
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.addEventListener("progress", (event) => {
      if (event.lengthComputable) onProgress(event.loaded / event.total);
    });
    request.addEventListener("load", () => {
      if (request.status < 300) return resolve(request);
      const title = `HTTP ${request.status}`;
      return reject(new Problem({ title, status: request.status, ...parsed(request.responseText) }));
    });
    request.addEventListener("error", () => reject(new Unreachable()));
    request.addEventListener("abort", () => reject(new DOMException("Stopped", "AbortError")));
    signal?.addEventListener("abort", () => request.abort());
    request.send(body);
  });
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return {};
  }
}

/** A key for a request that may be sent twice. */
export function freshKey() {
  const words = crypto.getRandomValues(new Uint32Array(4));
  return [...words].map((word) => word.toString(16).padStart(8, "0")).join("");
}

/** A complaint as a sentence. */
export function complaintOf(error) {
  return error instanceof Problem ? error.text : error.message;
}
