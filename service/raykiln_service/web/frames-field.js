// Whether a job makes one picture or several, and which.

import { h, setText } from "./dom.js";

const KINDS = { "": "One image", turntable: "Turntable", cameras: "All cameras", time: "Animation" };

export class FramesField {
  #kind = h("select", { name: "frames", onchange: () => (this.#show(), this.onKind(this.#kind.value)) }, Object.entries(KINDS).map(([value, text]) => h("option", { value }, text)));
  #inputs = {
    turntable: {
      count: number("Frames", { min: 1, max: 100000, value: 24 }),
      degrees: number("Degrees", { placeholder: 360 }),
      start_degrees: number("Start at", { placeholder: 0 }),
      elevation_degrees: number("Elevation", { placeholder: "as it is", min: -89.9, max: 89.9 }),
    },
    cameras: {},
    time: {
      start: number("From second", { placeholder: "the start" }),
      end: number("To second", { placeholder: "the end" }),
      fps: number("Frames a second", { placeholder: 24, min: 0.001, max: 1000 }),
    },
  };
  #groups = Object.fromEntries(Object.entries(this.#inputs).map(([kind, inputs]) =>
    [kind, h("div.grid", { hidden: true }, Object.values(inputs).map(({ element }) => element))]));

  /** `onKind` is told of every choice, "" for one image. */
  constructor(onKind) {
    this.onKind = onKind;
    this.name = "frames";
    this.pointer = "/frames";
    this.trouble = h("span.bad", { role: "alert" });
    this.element = h("div.frames-field", {},
      h("div.field", {}, h("label", {}, "Pictures", this.#kind)), Object.values(this.#groups), this.trouble);
  }

  #show() {
    for (const [kind, group] of Object.entries(this.#groups)) {
      group.hidden = kind !== this.#kind.value || group.childElementCount === 0;
    }
    this.complain("");
  }

  value() {
    const kind = this.#kind.value;
    if (kind === "") return undefined;
    if (kind === "cameras") return { cameras: "all" };
    const entered = Object.entries(this.#inputs[kind]).filter(([, { input }]) => input.value !== "");
    return { [kind]: Object.fromEntries(entered.map(([name, { input }]) => [name, Number(input.value)])) };
  }

  set(frames) {
    const kind = Object.keys(KINDS).find((name) => name && frames?.[name]) ?? "";
    this.#kind.value = kind;
    for (const [name, { input }] of Object.entries(this.#inputs[kind] ?? {})) input.value = frames[kind][name] ?? "";
    this.#show();
    this.onKind(kind);
  }

  get isBad() {
    const inputs = Object.values(this.#inputs[this.#kind.value] ?? {});
    const bad = inputs.find(({ input }) => !input.checkValidity());
    if (bad) this.complain(bad.input.validationMessage);
    return Boolean(bad);
  }

  complain(text) {
    setText(this.trouble, text);
  }

  focus() {
    this.#kind.focus();
  }

  suggest() {}
}

function number(label, attributes) {
  const input = h("input", { type: "number", step: "any", ...attributes });
  return { input, element: h("div.field", {}, h("label", {}, label, input)) };
}
