// The page of one job.

import { call, complaintOf, getJson } from "./api.js";
import { confirmed } from "./dialogs.js";
import { announce, fill, h, setText, throttled } from "./dom.js";
import { fileLink } from "./downloads.js";
import { FINAL_STATES, ago, moment, note, percent, sceneName, summary } from "./format.js";
import { Frames } from "./frames.js";
import { Log } from "./log.js";
import { snippets } from "./snippet.js";
import { countsOf, timingChart } from "./timing.js";
import { Viewer } from "./viewer.js";

export class JobPage {
  #job = null;
  #previews = 0;
  #viewer = new Viewer();
  #frames = new Frames(() => this.#job && this.#showImage());
  #title = h("h1", { tabindex: -1 }, "Job");
  #badge = h("span.badge");
  #note = h("p.note");
  #bar = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Progress" });
  #share = h("span.share");
  #buttons = h("div.buttons");
  #trouble = h("div.trouble", { role: "alert", hidden: true });
  #files = h("section.panel", { "aria-label": "Downloads" });
  #timing = h("section.panel", { "aria-label": "Timing", hidden: true });
  #facts = h("details.panel", { open: true }, h("summary", {}, "Job"), h("div"));
  #code = h("details.panel", {}, h("summary", {}, "From a terminal or a script"), h("div"));
  #reload = throttled(() => this.#load(), 150);

  constructor(id, feed) {
    this.path = `/v1/jobs/${encodeURIComponent(id)}`;
    this.id = id;
    this.log = new Log(`${this.path}/outputs/log.txt`);
    this.element = h("div.job", {},
      h("header.job-head", {},
        h("div.titles", {}, h("a.back", { href: "#/" }, "Jobs"), this.#title, this.#badge),
        this.#buttons,
        h("div.how", {}, this.#bar, this.#share, this.#note), this.#trouble),
      h("div.main", {}, this.#viewer.element, this.#frames.element),
      h("aside", { "aria-label": "Details" }, this.#files, this.#timing, this.#facts, this.log.element, this.#code));
    this.#viewer.onLook = () => this.#job && this.#showFiles();
    this.end = feed.listen((news) => this.#heard(news));
    this.#load();
  }

  close() {
    this.end();
    this.#viewer.close();
    this.#frames.close();
  }

  #heard(news) {
    if (news.kind === "fresh") return this.#reload();
    if (news.job !== this.id) return;
    if (news.kind === "deleted") this.#gone("This job was deleted.");
    else if (news.kind === "state") this.#reload();
    else if (this.#job && news.kind === "progress") {
      const { kind, job, ...progress } = news;
      this.#job = { ...this.#job, progress: { ...this.#job.progress, ...progress } };
      this.#showProgress();
      this.#frames.progress(progress);
      this.log.refresh();
    } else if (news.kind === "preview") {
      this.#previews = news.number;
      if (this.#job) this.#showImage();
    }
  }

  async #load() {
    try {
      this.#show(await getJson(this.path));
    } catch (error) {
      if (error.status === 404) this.#gone(error.message);
      else if (this.#job === null) this.#complain(error);
    }
  }

  #show(job) {
    if (this.#job && this.#job.state !== job.state) announce(`${sceneName(job)} is ${job.state}`);
    this.#job = job;
    setText(this.#title, sceneName(job));
    document.title = `${sceneName(job)} · raykiln`;
    setText(this.#badge, job.state);
    this.#badge.className = `badge ${job.state}`;
    this.#showProgress();
    this.#showButtons();
    this.#showTrouble();
    this.#frames.update(job);
    this.#showImage();
    this.#showFiles();
    this.#showTiming();
    this.#showFacts();
    this.log.refresh();
  }

  #showProgress() {
    const job = this.#job;
    this.#bar.hidden = this.#share.hidden = FINAL_STATES.has(job.state);
    this.#bar.value = job.progress.fraction;
    setText(this.#share, job.state === "running" ? percent(job.progress.fraction) : "");
    const parts = [job.state === "failed" ? "" : note(job), summary(job)];
    setText(this.#note, parts.filter(Boolean).join(" · "));
  }

  #showImage() {
    const job = this.#job;
    const named = (name) => job.outputs.find((output) => output.name === name);
    this.#viewer.update(this.#frames.chosen ?? {
      exr: named("image.exr"),
      png: named("image.png"),
      preview: job.links.preview,
      key: `${this.#previews} ${job.attempts}`,
      state: job.state,
    });
  }

  #showButtons() {
    const { links, state, cancel_requested: stopping } = this.#job;
    fill(this.#buttons, [Object.keys(links), state, stopping], () => {
      const button = (name, run, kind = "button") => h(kind, { type: "button", onclick: run }, name);
      return [
        links.cancel && !stopping && button("Cancel", () => this.#cancel()),
        links.retry && button("Retry", () => this.#post(links.retry), "button.primary"),
        h("a.button", { href: `#/new?from=${encodeURIComponent(this.id)}` }, "Change and render again"),
        FINAL_STATES.has(state) && button("Delete", () => this.#delete(), "button.danger"),
      ];
    });
  }

  async #cancel() {
    const text = "The render stops; the image so far is kept, and the job can be retried later.";
    if (await confirmed("Cancel this job?", text, "Cancel the job")) await this.#post(this.#job.links.cancel);
  }

  async #post(path) {
    try {
      this.#show(await (await call(path, { method: "POST" })).json());
    } catch (error) {
      this.#complain(error);
      this.#reload();
    }
  }

  async #delete() {
    const text = "Its images and its log are removed for good.";
    if (!(await confirmed("Delete this job?", text, "Delete the job"))) return;
    try {
      await call(this.path, { method: "DELETE" });
      announce("The job was deleted");
      location.hash = "#/";
    } catch (error) {
      this.#complain(error);
    }
  }

  #showTrouble() {
    const { error, warnings, state } = this.#job;
    const failed = state === "failed" ? error : null;
    this.#trouble.hidden = !failed && warnings.length === 0;
    fill(this.#trouble, [failed, warnings], () => [
      failed && h("p.bad", {}, h("b", {}, failed.title ?? failed.reason), ` ${placeOf(failed)}${failed.detail}`,
        failed.found && ` (found ${failed.found})`, failed.accepted && `; accepted: ${failed.accepted}`),
      warnings.length > 0 && h("ul.warnings", {}, warnings.map((text) => h("li", {}, text))),
    ]);
  }

  #showFiles() {
    const { outputs, scene, links, started_at: started } = this.#job;
    const { exposure, view } = this.#viewer.look;
    fill(this.#files, [outputs, started, exposure, view], () => {
      const changed = exposure !== 0 || view !== "srgb";
      const exr = outputs.find((output) => output.name === "image.exr");
      const query = new URLSearchParams({ exposure: exposure.toFixed(1), view });
      return [
        h("h2", {}, "Downloads"),
        h("div.files", {},
          imagesFirst(outputs).map((output) => fileLink(output.name, output.href, { size: output.size_bytes, filename: `${stemOf(scene)}-${output.name}` })),
          changed && exr && fileLink("image.png", `${this.path}/outputs/image.png?${query}`, {
            text: `image.png as shown (${view}, ${query.get("exposure")} EV)`,
            filename: `${stemOf(scene)}-${view}.png`,
          }),
          links.archive && outputs.length > 1 && fileLink("outputs.zip", links.archive, { text: "All as zip", filename: `${stemOf(scene)}.zip` }),
          started && fileLink("log.txt", links.log, { filename: `${stemOf(scene)}-log.txt` })),
        outputs.length === 0 && h("p.hint", {}, "The files come when the job ends."),
      ];
    });
  }

  #showTiming() {
    const { stats } = this.#job;
    this.#timing.hidden = stats === null;
    if (stats === null) return;
    fill(this.#timing, stats, () => [h("h2", {}, "Timing"), timingChart(stats), pairs(countsOf(stats))]);
  }

  #showFacts() {
    const job = this.#job;
    const settings = Object.entries(job.settings).map(([name, value]) => [name, Array.isArray(value) ? value.join(", ") : String(value)]);
    const facts = [
      ["Id", h("code", {}, job.id)],
      ["Submitted", h("time", { datetime: job.created_at, title: moment(job.created_at) }, ago(job.created_at))],
      job.priority !== 0 && ["Priority", job.priority],
      job.attempts > 1 && ["Attempts", `${job.attempts} of ${job.max_attempts}`],
      job.interruptions > 0 && ["Interruptions", job.interruptions],
      job.cached && ["Answered from", "the result cache"],
      Object.keys(job.labels).length > 0 && ["Labels", Object.entries(job.labels).map(([name, value]) => labelLink(name, value))],
      ...settings,
    ].filter(Boolean);
    fill(this.#facts.lastElementChild, [job.id, job.settings, job.labels, job.priority, job.attempts, job.interruptions, job.cached], () => pairs(facts));
    fill(this.#code.lastElementChild, [job.id], () => snippets(job));
  }

  #gone(text) {
    this.element.replaceChildren(h("div.empty", {}, h("h1", { tabindex: -1 }, "No such job"), h("p", {}, text), h("a.button", { href: "#/" }, "All jobs")));
    this.close();
  }

  #complain(error) {
    this.#trouble.hidden = false;
    delete this.#trouble.dataset.filled;
    this.#trouble.replaceChildren(h("p.bad", {}, complaintOf(error)));
  }
}

function pairs(list) {
  return h("dl.pairs", {}, list.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
}

export function labelLink(name, value) {
  return h("a.label", { href: `#/?label=${encodeURIComponent(`${name}=${value}`)}` }, `${name}: ${value}`);
}

function placeOf({ file, pointer }) {
  const place = [file, pointer].filter(Boolean).join(" ");
  return place && `${place}: `;
}

/** The image is what most come for. */
function imagesFirst(outputs) {
  const rank = ({ name }) => (/^image\./.test(name) ? 0 : name.endsWith(".json") ? 2 : 1);
  return [...outputs].sort((a, b) => rank(a) - rank(b));
}

function stemOf(scene) {
  const name = scene.name ?? scene.entry ?? "scene";
  return name.split("/").pop().replace(/\.\w+$/, "");
}
