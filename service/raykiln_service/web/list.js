// All jobs, newest first.

import { complaintOf, getJson } from "./api.js";
import { announce, h, setText, throttled } from "./dom.js";
import { FINAL_STATES, STATES, ago, moment, note, percent, sceneName, summary } from "./format.js";
import { QueuePanel } from "./queue.js";
import { Thumbnail } from "./thumbnails.js";

const PAGE = 24;
const MOST_AT_ONCE = 200;

export class ListPage {
  #cards = new Map();
  #cursor = null;
  #count = PAGE;
  #loading = null;
  #queue;
  #list = h("ol.cards", { "aria-label": "Jobs, newest first" });
  #more = h("button", { type: "button", hidden: true, onclick: () => this.#older() }, "Older jobs");
  #empty = h("div.empty", { hidden: true });
  #trouble = h("p.bad", { role: "alert" });
  #reload = throttled(() => this.#load(), 1000);

  constructor(query, feed) {
    this.state = query.get("state");
    this.label = query.get("label");
    this.#queue = new QueuePanel();
    this.element = h("div.jobs", {}, h("h1.unseen", { tabindex: -1 }, "Jobs"),
      h("div.filters", {}, this.#stateFilter(), this.#labelFilter(), this.#queue.element),
      this.#trouble, this.#list, this.#empty, this.#more);
    this.end = feed.listen((news) => this.#heard(news));
    this.clock = setInterval(() => this.#cards.forEach((card) => card.showTime()), 30_000);
    this.#load();
  }

  close() {
    this.end();
    clearInterval(this.clock);
    this.#cards.forEach((card) => card.close());
  }

  #stateFilter() {
    const link = (state, name) => h("a", {
      href: hrefOf({ state, label: this.label }), "aria-current": (state ?? null) === this.state ? "true" : null,
    }, name);
    return h("nav.segments", { "aria-label": "State" }, link(null, "all"), STATES.map((state) => link(state, state)));
  }

  #labelFilter() {
    const input = h("input", { type: "search", name: "label", value: this.label ?? "", placeholder: "label, or label=value", "aria-label": "Label" });
    const show = (event) => {
      event.preventDefault();
      location.hash = hrefOf({ state: this.state, label: input.value.trim() || null });
    };
    return h("form.label-filter", { role: "search", onsubmit: show }, input, h("button.quiet", {}, "Filter"));
  }

  #heard(news) {
    const card = this.#cards.get(news.job);
    if (news.kind === "progress") card?.progress(news);
    else if (news.kind === "preview") card?.preview(news.number);
    else if (["state", "deleted", "fresh"].includes(news.kind)) {
      this.#reload();
      this.#queue.refresh();
    }
  }

  #path(limit, cursor = null) {
    const query = new URLSearchParams({ limit });
    if (this.state) query.set("state", this.state);
    if (this.label) query.set("label", this.label);
    if (cursor) query.set("cursor", cursor);
    return `/v1/jobs?${query}`;
  }

  async #load() {
    if (this.#loading) return this.#reload();
    this.#loading = getJson(this.#path(Math.min(this.#count, MOST_AT_ONCE)));
    try {
      const page = await this.#loading;
      this.#show(page.items, page.next_cursor);
      setText(this.#trouble, "");
    } catch (error) {
      if (error.status) setText(this.#trouble, complaintOf(error));
    } finally {
      this.#loading = null;
    }
  }

  /** Put the first jobs as they are now; what older pages brought stays below. */
  #show(jobs, cursor) {
    const last = jobs.at(-1);
    const older = [...this.#cards.values()].filter(({ job }) => cursor && last && job.created_at < last.created_at);
    const wanted = new Set([...jobs, ...older.map(({ job }) => job)].map(({ id }) => id));
    for (const [id, card] of this.#cards) if (!wanted.has(id)) this.#remove(id, card);
    jobs.forEach((job, index) => {
      const card = this.#cardOf(job);
      if (this.#list.children[index] !== card.element) this.#list.insertBefore(card.element, this.#list.children[index] ?? null);
    });
    if (older.length === 0) this.#cursor = cursor;
    this.#showEnds();
  }

  #cardOf(job) {
    let card = this.#cards.get(job.id);
    if (!card) this.#cards.set(job.id, (card = new Card()));
    card.show(job);
    return card;
  }

  #remove(id, card) {
    // Whoever stood on it goes to its neighbour, not to the top of the page.
    if (card.element.contains(document.activeElement)) {
      (card.element.nextElementSibling ?? card.element.previousElementSibling)?.querySelector("a")?.focus();
    }
    card.close();
    card.element.remove();
    this.#cards.delete(id);
  }

  async #older() {
    this.#more.disabled = true;
    try {
      const page = await getJson(this.#path(PAGE, this.#cursor));
      const first = page.items.map((job) => this.#cardOf(job).element);
      this.#list.append(...first);
      this.#cursor = page.next_cursor;
      this.#count = this.#cards.size;
      first[0]?.querySelector("a").focus();
    } catch (error) {
      setText(this.#trouble, complaintOf(error));
    }
    this.#more.disabled = false;
    this.#showEnds();
  }

  #showEnds() {
    this.#more.hidden = this.#cursor === null;
    this.#empty.hidden = this.#cards.size > 0;
    if (this.#empty.hidden || this.#empty.childElementCount) return;
    const filtered = this.state || this.label;
    this.#empty.append(
      h("h2", {}, filtered ? "No such jobs" : "Nothing rendered yet"),
      h("p", {}, filtered ? "No job has this state and label." : "Drop a scene anywhere on this page, or begin with one of the bundled scenes."),
      filtered ? h("a.button", { href: "#/" }, "All jobs") : h("a.button.primary", { href: "#/new" }, "New render"));
  }
}

function hrefOf({ state, label }) {
  const query = new URLSearchParams();
  if (state) query.set("state", state);
  if (label) query.set("label", label);
  return query.size ? `#/?${query}` : "#/";
}

class Card {
  #thumbnail = new Thumbnail();
  #name = h("strong");
  #badge = h("span.badge");
  #summary = h("span.summary");
  #note = h("span.note");
  #time = h("time");
  #bar = h("progress", { max: 1 });
  #link = h("a", {}, this.#thumbnail.element,
    h("span.words", {}, h("span.line", {}, this.#name, this.#badge), this.#summary, this.#bar, h("span.line", {}, this.#note, this.#time)));
  element = h("li", {}, this.#link);
  job = null;

  show(job) {
    if (this.job && this.job.state !== job.state) announce(`${sceneName(job)} is ${job.state}`);
    this.job = job;
    this.#link.href = `#/jobs/${encodeURIComponent(job.id)}`;
    this.element.className = `card ${job.state}`;
    setText(this.#name, sceneName(job));
    setText(this.#badge, job.state);
    this.#badge.className = `badge ${job.state}`;
    setText(this.#summary, [summary(job), ...Object.entries(job.labels).map(([name, value]) => `${name}: ${value}`)].filter(Boolean).join(" · "));
    this.#showProgress();
    this.showTime();
    const sheet = job.outputs.find(({ name }) => name === "contact_sheet.png");
    const picture = sheet?.href ?? job.links.preview;
    if (picture) this.#thumbnail.want(picture, FINAL_STATES.has(job.state) ? job.finished_at : "live");
  }

  progress({ kind, job, ...progress }) {
    this.job = { ...this.job, progress: { ...this.job.progress, ...progress } };
    this.#showProgress();
  }

  preview(number) {
    if (this.job.state === "running") this.#thumbnail.want(`${this.job.links.self}/preview.png`, number);
  }

  close() {
    this.#thumbnail.close();
  }

  showTime() {
    setText(this.#time, ago(this.job.created_at));
    this.#time.dateTime = this.job.created_at;
    this.#time.title = moment(this.job.created_at);
  }

  #showProgress() {
    const { state, progress } = this.job;
    this.#bar.hidden = state !== "running";
    this.#bar.value = progress.fraction;
    this.#bar.setAttribute("aria-label", `Progress, ${percent(progress.fraction)}`);
    setText(this.#note, note(this.job));
  }
}
