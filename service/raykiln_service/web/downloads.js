// Links to a job's files, which work with a token too.

import { call, complaintOf, hasToken } from "./api.js";
import { announce, h } from "./dom.js";
import { bytes } from "./format.js";

export function fileLink(name, href, { size = null, text = name, filename = name } = {}) {
  return h("a.file", { href, download: filename, onclick: (event) => withToken(event, href, filename) },
    h("span", {}, text), size !== null && h("small", {}, bytes(size)));
}

/** A link cannot carry a token: the file is fetched, then given to the browser. */
async function withToken(event, href, filename) {
  if (!hasToken()) return;
  event.preventDefault();
  const link = event.currentTarget;
  link.setAttribute("aria-busy", "true");
  try {
    const url = URL.createObjectURL(await (await call(href)).blob());
    h("a", { href: url, download: filename }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
  } catch (error) {
    announce(complaintOf(error));
    link.title = complaintOf(error);
  }
  link.removeAttribute("aria-busy");
}
