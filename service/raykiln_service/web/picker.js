// Which scene to render: files of one's own, a bundled scene, or that of an earlier job.

import { getJson, upload } from "./api.js";
import { LARGE_BYTES, uploadInPieces } from "./uploads.js";
import { bundleOf, filesOfDrop, filesOfInput } from "./bundle.js";
import { h, setText } from "./dom.js";
import { bytes, percent, sceneName } from "./format.js";

export class ScenePicker {
  #scenes = [];
  #own = null;
  #chosen = h("div.chosen", { hidden: true });
  #gallery = h("ul.gallery", { "aria-label": "Bundled scenes" });
  #trouble = h("p.bad", { role: "alert" });
  #sending = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Upload" });
  #entry = h("select", { name: "entry", onchange: () => this.complain("") });
  #entryBox = h("label.entry", { hidden: true }, "Scene file", this.#entry);
  #file = h("input.unseen", { type: "file", name: "file", multiple: true, onchange: (event) => this.#take(event.target) });
  #folder = h("input.unseen", { type: "file", name: "folder", webkitdirectory: true, onchange: (event) => this.#take(event.target) });
  element = h("fieldset.picker", {}, h("legend", {}, "Scene"),
    h("div.drop", {},
      h("p", {}, "Drop a scene here: a file, a folder with its textures, or a zip."),
      h("div.buttons", {},
        h("label.button", {}, "Choose files", this.#file),
        h("label.button", {}, "Choose a folder", this.#folder)),
      this.#chosen, this.#entryBox, this.#sending),
    this.#trouble, this.#gallery);

  /** `onChange` gets what is known of the scene: { settings, cameras }. */
  constructor(onChange) {
    this.onChange = onChange;
  }

  async load() {
    this.#scenes = await getJson("/v1/scenes");
    this.#gallery.replaceChildren(...this.#scenes.map((scene) => this.#cardOf(scene)));
  }

  #cardOf(scene) {
    const radio = h("input.unseen", { type: "radio", name: "scene", value: scene.name, onchange: () => this.choose(scene.name) });
    const { width, height } = scene.settings;
    return h("li", {}, h("label", { title: scene.description }, radio,
      scene.thumbnail ? h("img", { src: scene.thumbnail, alt: "", loading: "lazy" }) : h("span.no-image"),
      h("span.name", {}, scene.title ?? scene.name),
      h("small", {}, width && height ? `${width} × ${height}` : scene.name)));
  }

  /** Choose a bundled scene. */
  choose(name) {
    const scene = this.#scenes.find((one) => one.name === name);
    if (!scene) return this.complain(`There is no bundled scene ${name}`);
    for (const radio of this.element.querySelectorAll("[name=scene]")) radio.checked = radio.value === name;
    this.#setOwn(null);
    this.onChange(scene);
  }

  /** Take the scene of an earlier job. */
  reuse(job) {
    if (job.scene.inline) return this.complain("That job's scene was inline and is not kept for new jobs");
    if (job.scene.name) return this.choose(job.scene.name);
    this.#setOwn({ name: sceneName(job), bytes: null, entries: [], scene: job.scene });
    this.onChange({ settings: {}, cameras: [] });
  }

  async takeDrop(transfer) {
    this.takeFiles(await filesOfDrop(transfer));
  }

  takeFiles(files) {
    try {
      this.#setOwn(bundleOf(files));
      for (const radio of this.element.querySelectorAll("[name=scene]")) radio.checked = false;
      this.onChange({ settings: {}, cameras: [] });
    } catch (error) {
      this.complain(error.message);
    }
  }

  #take(input) {
    if (input.files.length) this.takeFiles(filesOfInput(input.files));
    input.value = "";
  }

  #setOwn(own) {
    this.#own = own;
    this.complain("");
    this.#chosen.hidden = own === null;
    this.#offerEntries(own?.entries ?? []);
    if (own === null) return;
    const drop = h("button.quiet", { type: "button", "aria-label": `Remove ${own.name}`, onclick: () => this.#setOwn(null) }, "×");
    this.#chosen.replaceChildren(h("b", {}, own.name), own.bytes !== null && h("small", {}, bytes(own.bytes)), drop);
  }

  #offerEntries(names) {
    this.#entry.replaceChildren(...names.map((value) => h("option", { value }, value)));
    this.#entryBox.hidden = names.length < 2;
  }

  /** The bundle's scene file was not clear: the service names those that there are. */
  askForEntry(accepted, text) {
    this.complain(text);
    const names = (accepted ?? "").split(", ").filter((name) => name && !name.startsWith("a "));
    this.#offerEntries(names);
    if (names.length > 1) this.#entry.focus();
  }

  /** The scene as a job wants it; uploads first what the service does not have. */
  async scene(signal) {
    const bundled = this.element.querySelector("[name=scene]:checked");
    if (bundled) return { name: bundled.value };
    const own = this.#own;
    if (own === null) throw new Error("Choose a scene first");
    if (own.scene) return own.scene;
    own.asset ??= (await this.#send(own, signal)).id;
    const entry = this.#entry.value || (/\.zip$/i.test(own.name) ? null : own.name);
    return entry ? { asset: own.asset, entry } : { asset: own.asset };
  }

  async #send(own, signal) {
    this.#sending.hidden = false;
    try {
      const blob = await own.blob();
      const way = blob.size > LARGE_BYTES ? uploadInPieces : upload;
      return await way(blob, own.name, (fraction) => {
        this.#sending.value = fraction;
        this.#sending.setAttribute("aria-valuetext", percent(fraction));
      }, signal);
    } finally {
      this.#sending.hidden = true;
    }
  }

  complain(text) {
    setText(this.#trouble, text);
  }

  focus() {
    (this.element.querySelector("[name=scene]:checked") ?? this.#file).focus();
  }
}
