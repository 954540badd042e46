// The job page: lists jobs, follows those that run, submits new ones.

const list = document.querySelector("#jobs");
const template = document.querySelector("#job");
const statusLine = document.querySelector("#status");
const refusal = document.querySelector("#refusal");
const viewer = document.querySelector("#viewer");
const more = document.querySelector("#more");
const form = document.querySelector("#submit");
const FINAL = new Set(["succeeded", "failed", "cancelled"]);
const REFRESH_MS = 2000;

/** id -> {item, follow, imageKey} of each job on the page. */
const shown = new Map();
let token = sessionStorage.getItem("raykiln-token");
let nextCursor = null;

/** fetch with the token; asks for the token when the service wants one. */
async function call(path, options = {}) {
  const headers = new Headers(options.headers);
  if (token) headers.set("Authorization", `Bearer ${token}`);
  const reply = await fetch(path, { ...options, headers });
  if (reply.status === 401) {
    const given = prompt("This service needs its bearer token:");
    if (given) {
      token = given.trim();
      sessionStorage.setItem("raykiln-token", token);
      return call(path, options);
    }
  }
  if (!reply.ok) throw new Error(await refusalOf(reply));
  return reply;
}

async function refusalOf(reply) {
  const problem = await reply.json().catch(() => ({ title: `HTTP ${reply.status}` }));
  const place = [problem.file, problem.pointer].filter(Boolean).join(" ");
  const found = problem.found ? ` (found ${problem.found})` : "";
  const accepted = problem.accepted ? `; accepted: ${problem.accepted}` : "";
  return `${place ? place + ": " : ""}${problem.detail ?? problem.title}${found}${accepted}`;
}

function sceneName(job) {
  return job.scene.name ?? job.scene.entry ?? "inline scene";
}

function noteOf(job) {
  if (job.error) return job.error.detail;
  if (job.state === "queued") return `${job.queue_position ?? 0} before it`;
  if (job.state === "running") {
    const eta = job.progress.eta_s;
    const left = eta == null ? "" : `, about ${Math.ceil(eta)} s left`;
    return `${job.progress.phase}: ${job.progress.spp_done ?? 0} samples per pixel${left}`;
  }
  const seconds = job.timings.run_s == null ? "" : `${job.timings.run_s.toFixed(1)} s`;
  return [seconds, job.complete === false ? "partial image" : "", ...job.warnings].filter(Boolean).join(" · ");
}

function show(job, place = "end") {
  let entry = shown.get(job.id);
  if (!entry) {
    const item = template.content.firstElementChild.cloneNode(true);
    entry = { item, follow: null, imageKey: null };
    shown.set(job.id, entry);
    item.querySelector(".open").addEventListener("click", () => openImage(entry.job));
    if (place === "start") list.prepend(item);
    else list.append(item);
  }
  entry.job = job;
  const { item } = entry;
  const settings = job.settings;
  item.className = job.state;
  item.querySelector("strong").textContent = sceneName(job);
  item.querySelector(".state").textContent = job.state;
  item.querySelector("code").textContent = job.id;
  item.querySelector("progress").value = job.progress.fraction;
  item.querySelector("progress").hidden = FINAL.has(job.state);
  item.querySelector("progress").setAttribute("aria-label", `Progress of ${sceneName(job)}`);
  item.querySelector(".note").textContent = noteOf(job);
  item.querySelector(".open").setAttribute("aria-label", `Open the image of ${sceneName(job)}`);
  item.title = Object.entries(settings).map(([name, value]) => `${name} = ${value}`).join("\n");
  showLinks(item.querySelector(".links"), job);
  if (FINAL.has(job.state)) {
    entry.follow?.abort();
    entry.follow = null;
    if (job.links.preview) showThumbnail(entry, job.state);
  } else if (!entry.follow) {
    follow(entry);
  }
  document.querySelector("#none").hidden = shown.size > 0;
}

function showLinks(box, job) {
  const actions = [];
  if (job.links.cancel) actions.push(["Cancel", () => act(job, "POST", job.links.cancel)]);
  if (job.links.retry) actions.push(["Retry", () => act(job, "POST", job.links.retry)]);
  for (const output of job.outputs) actions.push([output.name, () => download(output)]);
  if (job.started_at) actions.push(["log.txt", () => download({ name: "log.txt", href: job.links.log })]);
  if (FINAL.has(job.state)) actions.push(["Delete", () => remove(job)]);
  const wanted = actions.map(([name]) => name).join();
  // Kept when nothing changed, so that the focus stays where it is.
  if (box.dataset.actions === wanted) return;
  box.dataset.actions = wanted;
  box.replaceChildren(...actions.map(([name, run]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.addEventListener("click", () => run().catch(complain));
    return button;
  }));
}

async function act(job, method, path) {
  show(await (await call(path, { method })).json());
}

async function remove(job) {
  await call(job.links.self, { method: "DELETE" });
  shown.get(job.id)?.item.remove();
  shown.delete(job.id);
  document.querySelector("#none").hidden = shown.size > 0;
}

async function imageUrl(path) {
  return URL.createObjectURL(await (await call(path)).blob());
}

async function download(output) {
  const link = document.createElement("a");
  link.href = await imageUrl(output.href);
  link.download = output.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

async function showThumbnail(entry, key) {
  if (entry.imageKey === key) return;
  entry.imageKey = key;
  const image = entry.item.querySelector(".open img");
  try {
    const url = await imageUrl(entry.job.links.preview ?? `${entry.job.links.self}/preview.png`);
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    image.src = url;
    if (viewer.open && viewer.dataset.job === entry.job.id) await openImage(entry.job);
  } catch {
    // There is no image yet.
    entry.imageKey = null;
  }
}

async function openImage(job) {
  const whole = job.outputs.find((output) => output.name === "image.png");
  try {
    const url = await imageUrl(whole?.href ?? `${job.links.self}/preview.png`);
    const image = viewer.querySelector("img");
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    image.alt = `${sceneName(job)}, ${job.state}`;
    image.src = url;
    viewer.querySelector("p").textContent = `${sceneName(job)} · ${job.state} · ${noteOf(job)}`;
    viewer.dataset.job = job.id;
    if (!viewer.open) viewer.showModal();
  } catch (error) {
    complain(error);
  }
}

/** Follow a job's events with fetch: EventSource cannot send the token. */
async function follow(entry) {
  const stop = new AbortController();
  entry.follow = stop;
  let lastId = null;
  while (!stop.signal.aborted) {
    try {
      const headers = lastId ? { "Last-Event-ID": lastId } : {};
      const reply = await call(`${entry.job.links.self}/events`, { headers, signal: stop.signal });
      if (reply.status === 204) break;
      for await (const event of eventsOf(reply.body)) {
        lastId = event.id ?? lastId;
        await heard(entry, event);
      }
    } catch {
      if (stop.signal.aborted) return;
    }
    await new Promise((done) => setTimeout(done, 1000));
  }
}

async function heard(entry, event) {
  if (event.type === "progress") {
    show({ ...entry.job, progress: { ...entry.job.progress, ...event.data } });
  } else if (event.type === "preview") {
    await showThumbnail(entry, event.data.number);
  } else if (event.type === "state") {
    show(await (await call(entry.job.links.self)).json());
  }
}

async function* eventsOf(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const fields = Object.fromEntries(block.split("\n").filter((line) => !line.startsWith(":")).map((line) => {
        const colon = line.indexOf(":");
        return [line.slice(0, colon), line.slice(colon + 1).trimStart()];
      }));
      if (fields.data) yield { type: fields.event, id: fields.id, data: JSON.parse(fields.data) };
    }
  }
}

async function refresh() {
  try {
    const page = await (await call("/v1/jobs?limit=20")).json();
    const fresh = page.items.filter((job) => !shown.has(job.id)).reverse();
    const first = shown.size === 0;
    if (first) nextCursor = page.next_cursor;
    for (const job of fresh) show(job, "start");
    for (const job of page.items) show(job);
    more.hidden = nextCursor === null;
    document.querySelector("#none").hidden = shown.size > 0;
    statusLine.textContent = "";
  } catch (error) {
    statusLine.textContent = `The service does not answer: ${error.message}`;
  }
  setTimeout(refresh, REFRESH_MS);
}

more.addEventListener("click", async () => {
  const page = await (await call(`/v1/jobs?limit=20&cursor=${encodeURIComponent(nextCursor)}`)).json();
  for (const job of page.items) show(job);
  nextCursor = page.next_cursor;
  more.hidden = nextCursor === null;
});

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  refusal.textContent = "";
  const data = new FormData(form);
  const button = form.querySelector("button");
  button.disabled = true;
  try {
    const settings = { integrator: data.get("integrator") };
    for (const name of ["spp", "max_depth", "width", "height"]) settings[name] = Number(data.get(name));
    const body = JSON.stringify({ scene: await chosenScene(data), settings });
    const headers = { "Content-Type": "application/json", "Idempotency-Key": crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}` };
    show(await (await call("/v1/jobs", { method: "POST", headers, body })).json(), "start");
    form.elements.file.value = "";
  } catch (error) {
    complain(error);
  }
  button.disabled = false;
});

async function chosenScene(data) {
  const file = data.get("file");
  if (!file?.size) return { name: data.get("scene") };
  const path = `/v1/assets?filename=${encodeURIComponent(file.name)}`;
  const asset = await (await call(path, { method: "POST", body: file })).json();
  return { asset: asset.id };
}

function complain(error) {
  refusal.textContent = error.message;
}

async function loadScenes() {
  const scenes = await (await call("/v1/scenes")).json();
  form.elements.scene.replaceChildren(...scenes.map((scene) => {
    const option = new Option(scene.title ? `${scene.name}: ${scene.title}` : scene.name, scene.name);
    option.title = scene.description ?? "";
    return option;
  }));
}

await loadScenes().catch(complain);
await refresh();
