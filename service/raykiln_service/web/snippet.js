// The same job from a terminal or a script.

import { hasToken } from "./api.js";
import { h } from "./dom.js";

/** The body that would submit this job again. */
export function bodyOf(job) {
  const scene = job.scene.inline ? { inline: {} } : job.scene;
  const body = { scene, settings: job.settings, outputs: job.outputs_wanted };
  if (job.frames) body.frames = job.frames.wanted;
  for (const name of ["timeout_s", "memory_bytes"]) if (job[name]) body[name] = job[name];
  if (job.priority) body.priority = job.priority;
  if (Object.keys(job.labels).length) body.labels = job.labels;
  return body;
}

export function asCurl(job, origin) {
  // Inside single quotes a shell leaves all alone but the quote itself.
  const data = JSON.stringify(bodyOf(job)).replaceAll("'", "'\\''");
  const token = hasToken() ? ' \\\n  -H "Authorization: Bearer $RAYKILN_TOKEN"' : "";
  return `curl ${origin}/v1/jobs${token} \\\n  --json '${data}'`;
}

export function asPython(job, origin) {
  const { scene, settings, ...rest } = bodyOf(job);
  const extra = Object.entries(rest).map(([name, value]) => `\n        ${name}=${python(value)},`).join("");
  return `from raykiln_service.client import Client

with Client(${python(origin)}) as client:
    job = client.submit(
        ${python(scene)},
        settings=${python(settings)},${extra}
    )
    client.wait(job.id)
    client.download(job.id, "image.exr", "image.exr")`;
}

function python(value) {
  if (value === null) return "None";
  if (value === true) return "True";
  if (value === false) return "False";
  if (Array.isArray(value)) return `[${value.map(python).join(", ")}]`;
  if (typeof value === "object") return `{${Object.entries(value).map(([name, item]) => `${JSON.stringify(name)}: ${python(item)}`).join(", ")}}`;
  return JSON.stringify(value);
}

/** Both, with buttons to copy them. */
export function snippets(job) {
  const origin = location.origin;
  const kinds = [["curl", asCurl(job, origin)], ["Python", asPython(job, origin)]];
  const hint = job.scene.inline && h("p.hint", {}, "The inline scene is not part of what the service tells: put it where the braces are empty.");
  return [hint, kinds.map(([name, text]) => {
    const code = h("pre", { tabindex: 0, "aria-label": name }, text);
    const button = h("button.quiet", { type: "button", onclick: () => copy(text, code, button, name) }, `Copy as ${name}`);
    return h("div.snippet", {}, code, button);
  })];
}

async function copy(text, code, button, name) {
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
  } catch {
    // Without TLS a browser gives no clipboard: the text is selected instead.
    getSelection().selectAllChildren(code);
    button.textContent = "Selected: press Ctrl+C";
  }
  setTimeout(() => (button.textContent = `Copy as ${name}`), 2500);
}
