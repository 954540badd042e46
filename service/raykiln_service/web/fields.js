// Form fields, made from the JSON Schema of the settings, each with a place for what is wrong with it.

import { h, setText } from "./dom.js";

/** A labelled control; `value()` is undefined where nothing was entered. */
class Field {
  constructor(name, label, control, { hint = null, wide = false } = {}) {
    this.name = name;
    this.control = control;
    this.trouble = h("span.bad", { id: `trouble-${name}`, role: "alert" });
    control.setAttribute("aria-describedby", this.trouble.id);
    const inLabel = control.type === "checkbox" ? [control, label] : [label, control];
    this.element = h("div.field", {}, h("label", {}, inLabel), hint && h("span.hint", {}, hint), this.trouble);
    if (wide) this.element.classList.add("wide");
    control.addEventListener("input", () => this.complain(""));
  }

  complain(text) {
    setText(this.trouble, text);
    if (text) this.control.setAttribute("aria-invalid", "true");
    else this.control.removeAttribute("aria-invalid");
  }

  /** What the browser can say of it without the service. */
  get isBad() {
    const bad = !this.control.checkValidity();
    if (bad) this.complain(this.control.validationMessage);
    return bad;
  }

  focus() {
    this.control.focus();
  }

  set(value) {
    this.control.value = value ?? "";
  }

  /** What applies when nothing is entered. */
  suggest(value) {
    this.control.placeholder = value ?? "";
  }
}

export class NumberField extends Field {
  constructor(name, label, schema, options = {}) {
    const kind = schema.anyOf?.find((one) => one.type !== "null") ?? schema;
    const isWhole = kind.type === "integer";
    super(name, label, h("input", {
      type: "number", name, inputmode: isWhole ? "numeric" : "decimal", step: isWhole ? 1 : "any",
      min: kind.minimum ?? kind.exclusiveMinimum ?? null, max: kind.maximum ?? null,
    }), options);
    this.standard = schema.default ?? options.none ?? "";
    this.suggest(this.standard);
  }

  value() {
    return this.control.value === "" ? undefined : Number(this.control.value);
  }
}

/** Bytes, entered as gigabytes. */
export class GigabytesField extends NumberField {
  value() {
    const value = super.value();
    return value === undefined ? undefined : Math.round(value * 1e9);
  }

  set(value) {
    super.set(value ? value / 1e9 : "");
  }
}

export class ChoiceField extends Field {
  constructor(name, label, schema, options = {}) {
    super(name, label, h("select", { name }, h("option", { value: "" }), schema.enum.map((value) => h("option", { value }, value))), options);
    this.standard = schema.default;
    this.suggest(this.standard);
  }

  suggest(value) {
    this.control.firstElementChild.textContent = value === undefined ? "" : `${value} (default)`;
  }

  value() {
    return this.control.value || undefined;
  }
}

export class TextField extends Field {
  constructor(name, label, options = {}) {
    super(name, label, h("input", { type: "text", name, autocomplete: "off", spellcheck: "false", maxlength: options.most ?? null }), options);
    this.standard = options.none ?? "";
    this.suggest(this.standard);
  }

  value() {
    return this.control.value.trim() || undefined;
  }

  /** Names to pick from. */
  offer(names) {
    const list = h("datalist", { id: `names-${this.name}` }, names.map((value) => h("option", { value })));
    this.element.querySelector("datalist")?.remove();
    this.element.append(list);
    this.control.setAttribute("list", list.id);
  }
}

/** Four whole numbers with commas. */
export class CropField extends TextField {
  value() {
    const text = super.value();
    return text?.split(/[\s,]+/).filter(Boolean).map(Number);
  }

  get isBad() {
    const numbers = this.value();
    const bad = numbers !== undefined && !(numbers.length === 4 && numbers.every(Number.isInteger));
    if (bad) this.complain("Four whole numbers: left, top, right, bottom");
    return bad;
  }
}

export class SwitchField extends Field {
  constructor(name, label, options = {}) {
    super(name, label, h("input", { type: "checkbox", name }), options);
    this.element.classList.add("switch");
  }

  value() {
    return this.control.checked || undefined;
  }

  set(value) {
    this.control.checked = Boolean(value);
  }

  suggest() {}
}

/** Several of a few. */
export class ManyField {
  constructor(name, legend, values, { locked = [] } = {}) {
    this.name = name;
    this.boxes = values.map((value) => h("input", { type: "checkbox", name, value, checked: locked.includes(value), disabled: locked.includes(value) }));
    this.trouble = h("span.bad", { role: "alert" });
    this.element = h("fieldset.many", {}, h("legend", {}, legend),
      this.boxes.map((box) => h("label", {}, box, box.value.replaceAll("_", " "))), this.trouble);
    this.isBad = false;
  }

  /** Show only some of the values; the others are not chosen. */
  offer(values) {
    for (const box of this.boxes) {
      box.parentElement.hidden = !values.includes(box.value);
      if (box.parentElement.hidden) box.checked = false;
    }
  }

  value() {
    const chosen = this.boxes.filter((box) => box.checked).map((box) => box.value);
    return chosen.length ? chosen : undefined;
  }

  set(values = []) {
    for (const box of this.boxes) if (!box.disabled) box.checked = values.includes(box.value);
  }

  complain(text) {
    setText(this.trouble, text);
  }

  focus() {
    this.boxes.find((box) => !box.disabled)?.focus();
  }

  suggest() {}
}

/** Names and values. */
export class LabelsField {
  #rows = h("div.rows");

  constructor() {
    this.name = "labels";
    this.trouble = h("span.bad", { role: "alert" });
    this.button = h("button.quiet", { type: "button", onclick: () => this.#add().focus() }, "Add a label");
    this.element = h("fieldset.labels", {}, h("legend", {}, "Labels"), this.#rows, this.button, this.trouble);
  }

  #add(name = "", value = "") {
    const input = h("input", { type: "text", maxlength: 200, "aria-label": "Label name", placeholder: "shot", value: name });
    const row = h("div.row", {}, input,
      h("input", { type: "text", maxlength: 200, "aria-label": "Label value", placeholder: "010", value }),
      h("button.quiet", { type: "button", "aria-label": "Remove this label", onclick: () => (row.remove(), this.button.focus()) }, "×"));
    this.#rows.append(row);
    return input;
  }

  value() {
    const rows = [...this.#rows.children].map((row) => [...row.querySelectorAll("input")].map((input) => input.value.trim()));
    const labels = Object.fromEntries(rows.filter(([name]) => name));
    return Object.keys(labels).length ? labels : undefined;
  }

  set(labels = {}) {
    this.#rows.replaceChildren();
    for (const [name, value] of Object.entries(labels)) this.#add(name, value);
  }

  get isBad() {
    const bad = [...this.#rows.children].some((row) => row.firstElementChild.value.trim() === "" && row.children[1].value.trim() !== "");
    this.complain(bad ? "A label needs a name" : "");
    return bad;
  }

  complain(text) {
    setText(this.trouble, text);
  }

  focus() {
    (this.#rows.querySelector("input") ?? this.button).focus();
  }

  suggest() {}
}
