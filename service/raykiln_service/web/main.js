// Which page is shown, and what all of them share.

import { onTokenWanted } from "./api.js";
import { askForToken } from "./dialogs.js";
import { setText } from "./dom.js";
import { Feed } from "./feed.js";
import { JobPage } from "./job.js";
import { ListPage } from "./list.js";
import { SubmitPage } from "./submit.js";

const place = document.querySelector("#page");
const banner = document.querySelector("#banner");
const veil = document.querySelector("#veil");
const feed = new Feed();
let page = null;

onTokenWanted(askForToken);

/** "#/jobs/ID?x=1" as the page to show. */
function pageOf(hash) {
  const [path, search = ""] = hash.replace(/^#/, "").split("?");
  const query = new URLSearchParams(search);
  const [, kind, id] = path.split("/");
  if (kind === "jobs" && id) return new JobPage(decoded(id), feed);
  if (kind === "new") return new SubmitPage(query, feed);
  return new ListPage(query, feed);
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function show({ focus = true } = {}) {
  page?.close();
  document.title = "raykiln";
  page = pageOf(location.hash);
  place.replaceChildren(page.element);
  for (const link of document.querySelectorAll("header nav a")) {
    const isHere = link.hash && (page instanceof SubmitPage) === (link.hash === "#/new") && !(page instanceof JobPage);
    link.toggleAttribute("aria-current", Boolean(isHere));
  }
  if (!focus) return;
  scrollTo(0, 0);
  // So that the keyboard, and a screen reader, go on from the new page's start.
  page.element.querySelector("h1")?.focus({ preventScroll: true });
}

window.addEventListener("hashchange", () => show());

feed.listen(({ kind }) => {
  if (kind !== "offline" && kind !== "online") return;
  banner.hidden = kind === "online";
  setText(banner.firstElementChild, kind === "offline" ? "The service does not answer. Trying again…" : "");
});
document.querySelector("#retry").addEventListener("click", () => feed.retryNow());

document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  place.focus();
});

// Files may be dropped anywhere.
function carriesFiles(event) {
  return [...(event.dataTransfer?.types ?? [])].includes("Files");
}
addEventListener("dragover", (event) => {
  if (!carriesFiles(event)) return;
  event.preventDefault();
  veil.hidden = false;
});
addEventListener("dragleave", (event) => {
  if (event.relatedTarget === null) veil.hidden = true;
});
addEventListener("drop", async (event) => {
  if (!carriesFiles(event)) return;
  event.preventDefault();
  veil.hidden = true;
  // The files can be asked for only while the event lasts, so before anything is awaited.
  const transfer = snapshotOf(event.dataTransfer);
  if (!(page instanceof SubmitPage)) {
    history.pushState(null, "", "#/new");
    show();
  }
  await page.ready;
  await page.takeDrop(transfer);
});

function snapshotOf({ items, files }) {
  const entries = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  return { items: entries.map((entry) => ({ webkitGetAsEntry: () => entry })), files: [...files] };
}

show({ focus: false });
feed.start();
