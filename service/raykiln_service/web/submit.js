// The page on which jobs are made.

import { Problem, complaintOf, freshKey, getJson, postJson } from "./api.js";
import { h, setText } from "./dom.js";
import { ChoiceField, CropField, GigabytesField, LabelsField, ManyField, NumberField, SwitchField, TextField } from "./fields.js";
import { FramesField } from "./frames-field.js";
import { ScenePicker } from "./picker.js";

const FILES = ["exr", "png"];
const FILES_OF_FRAMES = ["contact_sheet", "webp", "mp4"];

export class SubmitPage {
  #fields = [];
  #picker = new ScenePicker((scene) => this.#follow(scene));
  #trouble = h("p.bad", { role: "alert" });
  #button = h("button.primary", {}, "Render");
  #body = h("div.groups");
  #form = h("form", { novalidate: true, "aria-label": "New render", onsubmit: (event) => this.#submit(event) },
    this.#picker.element, this.#body, h("div.send", {}, this.#trouble, this.#button));
  #waiting = h("p.hint", { role: "status" }, "Loading the scenes…");
  element = h("div.submit", {}, h("h1", { tabindex: -1 }, "New render"), this.#waiting, this.#form);
  // The same for the same body, so that a reply that got lost makes no second job.
  #sent = { body: null, key: null };
  #stop = new AbortController();
  #failed = false;

  constructor(query, feed) {
    this.#form.hidden = true;
    this.ready = this.#load(query);
    // What could not be had while the service was away is asked for again.
    this.end = feed.listen(({ kind }) => {
      if (kind === "fresh" && this.#failed) this.ready = this.#load(query);
    });
  }

  close() {
    this.end();
    this.#stop.abort();
  }

  async takeDrop(transfer) {
    await this.#picker.takeDrop(transfer);
  }

  async #load(query) {
    this.#failed = false;
    try {
      const [schema] = await Promise.all([getJson("/v1/settings/schema"), this.#picker.load()]);
      this.#build(schema.properties);
      this.#waiting.hidden = true;
      this.#form.hidden = false;
    } catch (error) {
      this.#failed = true;
      return setText(this.#waiting, complaintOf(error));
    }
    await this.#begin(query).catch((error) => setText(this.#trouble, complaintOf(error)));
  }

  async #begin(query) {
    const from = query.get("from");
    if (from) await this.#startFrom(await getJson(`/v1/jobs/${encodeURIComponent(from)}`));
    else if (query.get("scene")) this.#picker.choose(query.get("scene"));
  }

  #build(schemas) {
    const number = (name, label, options) => this.#setting(new NumberField(name, label, schemas[name], options));
    const choice = (name, label) => this.#setting(new ChoiceField(name, label, schemas[name]));
    this.#body.append(
      h("fieldset.group", {}, h("legend", {}, "Image"),
        h("div.grid", {},
          number("width", "Width"), number("height", "Height"),
          number("spp", "Samples per pixel"), number("max_depth", "Path depth"),
          choice("integrator", "Integrator"),
          this.#setting(new TextField("camera", "Camera", { none: "the first", most: 256 })),
          this.#setting(new SwitchField("denoise", "Denoise"))),
        this.#setting(new ManyField("aovs", "Layers", schemas.aovs.items.enum))),
      h("fieldset.group", {}, h("legend", {}, "Job"),
        this.#add(new FramesField((kind) => this.#offerFiles(kind)), "/frames"),
        h("div.grid", {}, this.#add(new NumberField("priority", "Priority", { type: "integer", minimum: -1000, maximum: 1000, default: 0 }), "/priority")),
        this.#add(new ManyField("outputs", "Files", [...FILES, ...FILES_OF_FRAMES], { locked: ["exr"] }), "/outputs"),
        this.#add(new LabelsField(), "/labels")),
      h("details.group", {}, h("summary", {}, "More settings"),
        h("div.grid", {},
          number("seed", "Seed"), number("rr_depth", "Roulette from depth"),
          choice("sampler", "Sampler"), choice("filter", "Filter"),
          number("noise_threshold", "Stop at noise", { none: "never" }), number("time_budget_s", "Stop after seconds", { none: "never" }),
          number("threads", "Threads"),
          this.#add(new NumberField("timeout_s", "Time limit in seconds", { type: "number", exclusiveMinimum: 0 }, { none: "the service's" }), "/timeout_s"),
          this.#add(new GigabytesField("memory_bytes", "Memory limit in GB", { type: "number", exclusiveMinimum: 0 }, { none: "the service's" }), "/memory_bytes"),
          this.#setting(new CropField("crop", "Crop", { none: "left, top, right, bottom" })),
          this.#add(new SwitchField("anew", "Render anew, whatever the cache has"), "/cache"))));
    this.#field("outputs").set(["png"]);
    this.#offerFiles("");
  }

  #offerFiles(kind) {
    const outputs = this.#field("outputs");
    outputs.offer(kind ? [...FILES, ...FILES_OF_FRAMES] : FILES);
    if (kind && !outputs.value()?.includes("contact_sheet")) outputs.set([...outputs.value() ?? [], "contact_sheet"]);
  }

  #setting(field) {
    return this.#add(field, `/settings/${field.name}`);
  }

  #add(field, pointer) {
    this.#fields.push(Object.assign(field, { pointer }));
    return field.element;
  }

  #field(name) {
    return this.#fields.find((field) => field.name === name);
  }

  /** Show what applies where nothing is entered: the scene's own settings, then the defaults. */
  #follow({ settings, cameras }) {
    for (const field of this.#fields) {
      if (field.pointer.startsWith("/settings/")) field.suggest(settings[field.name] ?? field.standard);
    }
    this.#field("camera").offer(cameras);
    if (cameras.length) this.#field("camera").suggest(cameras[0]);
  }

  async #startFrom(job) {
    this.#picker.reuse(job);
    for (const field of this.#fields) {
      if (field.pointer.startsWith("/settings/")) field.set(job.settings[field.name]);
    }
    this.#field("frames").set(job.frames?.wanted);
    this.#field("outputs").set(job.outputs_wanted);
    this.#field("priority").set(job.priority || "");
    this.#field("labels").set(job.labels);
    for (const name of ["timeout_s", "memory_bytes"]) this.#field(name).set(job[name]);
  }

  async #submit(event) {
    event.preventDefault();
    if (this.#button.disabled) return;
    this.#clear();
    const bad = this.#fields.filter((field) => field.isBad);
    if (bad.length) return this.#reveal(bad[0]);
    this.#button.disabled = true;
    try {
      const job = await this.#send();
      location.hash = `#/jobs/${encodeURIComponent(job.id)}`;
    } catch (error) {
      if (error.name !== "AbortError") this.#complain(error);
    }
    this.#button.disabled = false;
    setText(this.#button, "Render");
  }

  async #send() {
    setText(this.#button, "Sending…");
    const scene = await this.#picker.scene(this.#stop.signal);
    setText(this.#button, "Checking the scene…");
    const body = JSON.stringify({ scene, ...this.#values() });
    if (this.#sent.body !== body) this.#sent = { body, key: freshKey() };
    const job = await postJson("/v1/jobs", body, { "Idempotency-Key": this.#sent.key });
    this.#sent = { body: null, key: null };
    return job;
  }

  #values() {
    const body = { settings: {} };
    for (const field of this.#fields) {
      const value = field.value();
      if (value === undefined) continue;
      if (field.pointer.startsWith("/settings/")) body.settings[field.name] = value;
      else if (field.name === "anew") body.cache = false;
      else body[field.name] = value;
    }
    return body;
  }

  #clear() {
    setText(this.#trouble, "");
    this.#picker.complain("");
    for (const field of this.#fields) field.complain("");
  }

  /** Put what the service said to where it belongs. */
  #complain(error) {
    if (!(error instanceof Problem)) {
      if (error.message === "Choose a scene first") {
        this.#picker.complain(error.message);
        return this.#picker.focus();
      }
      return setText(this.#trouble, complaintOf(error));
    }
    const { type = "", pointer = "", detail, found, accepted } = error.problem;
    if (pointer === "/scene/entry") return this.#picker.askForEntry(accepted, detail);
    if (type.endsWith("invalid-scene") || type.endsWith("invalid-asset") || pointer.startsWith("/scene")) {
      this.#picker.complain(error.text);
      return this.#picker.focus();
    }
    const field = this.#fields.find((one) => pointer === one.pointer || pointer.startsWith(`${one.pointer}/`));
    if (!field) return setText(this.#trouble, error.text);
    field.complain(`${detail}${found ? ` (found ${found})` : ""}${accepted ? `; accepted: ${accepted}` : ""}`);
    this.#reveal(field);
  }

  #reveal(field) {
    const hidden = field.element.closest("details");
    if (hidden) hidden.open = true;
    field.focus();
  }
}
