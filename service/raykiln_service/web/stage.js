// The place where a picture lies: zoom, pan, the divider of before and after, the chosen pixel.

import { h } from "./dom.js";

const MAX_SCALE = 64;
const CLICK_PX = 4;
const HELP = "Image. Arrow keys choose a pixel, plus and minus zoom, 0 fits the image, 1 shows it pixel by pixel.";

/** Tells `onPixel(x, y)` the pixel under the pointer or the keyboard's, and `onZoom(scale)`. */
export class Stage {
  #canvases = { main: h("canvas"), before: h("canvas.before") };
  #sheet = h("div.sheet", {}, this.#canvases.main, this.#canvases.before);
  #mark = h("div.mark", { hidden: true, "aria-hidden": "true" });
  #divider = h("div.divider", {
    role: "slider", tabindex: 0, hidden: true, "aria-label": "Before and after",
    "aria-valuemin": 0, "aria-valuemax": 100,
    onpointerdown: (event) => this.#dragDivider(event),
    onkeydown: (event) => this.#dividerKey(event),
  });
  #surface = h("div.surface", {
    tabindex: 0, role: "application", "aria-label": HELP,
    onpointerdown: (event) => this.#down(event),
    onpointermove: (event) => this.#move(event),
    onpointerup: (event) => this.#up(event),
    onpointercancel: (event) => this.#pointers.delete(event.pointerId),
    onkeydown: (event) => this.#key(event),
    ondblclick: () => (this.#fitted ? this.zoomTo(1) : this.fit()),
  }, this.#sheet, this.#mark);
  element = h("div.stage", {}, this.#surface, this.#divider);
  #size = { width: 0, height: 0 };
  #scale = 1;
  #left = 0;
  #top = 0;
  #fitted = true;
  #split = 0.5;
  #pointers = new Map();
  #moved = 0;
  #pixel = null;
  #pinned = false;

  constructor({ onPixel, onZoom }) {
    this.onPixel = onPixel;
    this.onZoom = onZoom;
    this.#surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    this.observer = new ResizeObserver(() => (this.#fitted ? this.fit() : this.#place()));
    this.observer.observe(this.element);
  }

  /** Draw a picture; `which` is "main" or "before". */
  paint(which, { width, height }, pixels) {
    const canvas = this.#canvases[which];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
    if (width === this.#size.width && height === this.#size.height) return;
    this.#size = { width, height };
    this.choose(null);
    this.fit();
  }

  get isEmpty() {
    return this.#size.width === 0;
  }

  set comparing(wanted) {
    this.#divider.hidden = !wanted;
    this.#canvases.before.hidden = !wanted;
    this.#place();
  }

  fit() {
    const { clientWidth, clientHeight } = this.element;
    const { width, height } = this.#size;
    if (!width || !clientWidth) return;
    this.#scale = Math.min(clientWidth / width, clientHeight / height, 8);
    this.#left = (clientWidth - width * this.#scale) / 2;
    this.#top = (clientHeight - height * this.#scale) / 2;
    this.#fitted = true;
    this.#place();
  }

  /** Zoom about a point of the stage; its middle, if none is given. */
  zoomTo(scale, x = this.element.clientWidth / 2, y = this.element.clientHeight / 2) {
    if (this.isEmpty) return;
    const least = Math.min(0.05, this.#scale);
    const wanted = Math.min(MAX_SCALE, Math.max(least, scale));
    this.#left = x - ((x - this.#left) * wanted) / this.#scale;
    this.#top = y - ((y - this.#top) * wanted) / this.#scale;
    this.#scale = wanted;
    this.#fitted = false;
    this.#place();
  }

  zoomBy(factor) {
    this.zoomTo(this.#scale * factor);
  }

  /** Choose a pixel, or none. */
  choose(pixel) {
    this.#pixel = pixel;
    if (pixel === null) this.#pinned = false;
    this.#placeMark();
    this.onPixel(pixel);
  }

  #place() {
    const { width, height } = this.#size;
    this.#sheet.style.width = `${width}px`;
    this.#sheet.style.height = `${height}px`;
    this.#sheet.style.transform = `translate(${this.#left}px, ${this.#top}px) scale(${this.#scale})`;
    this.#sheet.classList.toggle("pixelated", this.#scale >= 2);
    // At its fitted size a finger scrolls the page; past it, it moves the picture.
    this.#surface.style.touchAction = this.#fitted ? "pan-y" : "none";
    const percent = Math.round(this.#split * 100);
    this.#canvases.before.style.clipPath = `inset(0 ${100 - this.#split * 100}% 0 0)`;
    this.#divider.style.left = `${this.#left + this.#split * width * this.#scale}px`;
    this.#divider.setAttribute("aria-valuenow", percent);
    this.#divider.setAttribute("aria-valuetext", `${percent} % noisy, the rest denoised`);
    this.#placeMark();
    this.onZoom(this.#scale);
  }

  #placeMark() {
    this.#mark.hidden = this.#pixel === null;
    if (this.#pixel === null) return;
    const size = Math.max(this.#scale, 9);
    const offset = (this.#scale - size) / 2;
    this.#mark.style.width = this.#mark.style.height = `${size}px`;
    this.#mark.style.left = `${this.#left + this.#pixel.x * this.#scale + offset}px`;
    this.#mark.style.top = `${this.#top + this.#pixel.y * this.#scale + offset}px`;
    this.#mark.classList.toggle("pinned", this.#pinned);
  }

  #pointOf(event) {
    const box = this.element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  #pixelAt({ x, y }) {
    const pixel = { x: Math.floor((x - this.#left) / this.#scale), y: Math.floor((y - this.#top) / this.#scale) };
    const inside = pixel.x >= 0 && pixel.y >= 0 && pixel.x < this.#size.width && pixel.y < this.#size.height;
    return inside ? pixel : null;
  }

  #wheel(event) {
    event.preventDefault();
    const { x, y } = this.#pointOf(event);
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 20 : 1;
    this.zoomTo(this.#scale * Math.exp(-0.0016 * lines * event.deltaY), x, y);
  }

  #down(event) {
    if (event.button !== 0) return;
    this.#surface.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, this.#pointOf(event));
    this.#moved = this.#pointers.size > 1 ? Infinity : 0;
  }

  #move(event) {
    const now = this.#pointOf(event);
    const before = this.#pointers.get(event.pointerId);
    if (before === undefined) {
      if (!this.#pinned) this.choose(this.#pixelAt(now));
      return;
    }
    const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.#pointers.set(event.pointerId, now);
    this.#moved += Math.hypot(now.x - before.x, now.y - before.y);
    if (other) this.#pinch(before, now, other);
    else if (this.#moved > CLICK_PX && !(this.#fitted && event.pointerType === "touch")) this.#pan(now.x - before.x, now.y - before.y);
  }

  #pinch(before, now, other) {
    const length = (point) => Math.max(1, Math.hypot(point.x - other.x, point.y - other.y));
    this.zoomTo((this.#scale * length(now)) / length(before), (now.x + other.x) / 2, (now.y + other.y) / 2);
    this.#pan((now.x - before.x) / 2, (now.y - before.y) / 2);
  }

  #pan(x, y) {
    this.#left += x;
    this.#top += y;
    this.#fitted = false;
    this.#place();
  }

  #up(event) {
    if (!this.#pointers.delete(event.pointerId) || this.#moved > CLICK_PX) return;
    const pixel = this.#pixelAt(this.#pointOf(event));
    this.#pinned = pixel !== null && !(this.#pinned && pixel.x === this.#pixel?.x && pixel.y === this.#pixel?.y);
    this.choose(pixel);
  }

  #key(event) {
    const step = event.shiftKey ? 10 : 1;
    const steps = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const actions = {
      "+": () => this.zoomBy(1.25), "=": () => this.zoomBy(1.25), "-": () => this.zoomBy(0.8),
      0: () => this.fit(), 1: () => this.zoomTo(1), Escape: () => this.choose(null),
    };
    if (this.isEmpty || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in steps) this.#step(steps[event.key]);
    else if (event.key in actions) actions[event.key]();
    else return;
    event.preventDefault();
  }

  #step([dx, dy]) {
    const { width, height } = this.#size;
    const from = this.#pixel ?? { x: Math.floor(width / 2) - dx, y: Math.floor(height / 2) - dy };
    const within = (value, end) => Math.min(end - 1, Math.max(0, value));
    this.#pinned = true;
    this.choose({ x: within(from.x + dx, width), y: within(from.y + dy, height) });
    const [x, y] = [this.#left + this.#pixel.x * this.#scale, this.#top + this.#pixel.y * this.#scale];
    const { clientWidth, clientHeight } = this.element;
    if (x < 0 || y < 0 || x > clientWidth || y > clientHeight) this.#pan(clientWidth / 2 - x, clientHeight / 2 - y);
  }

  #setSplit(fraction) {
    this.#split = Math.min(1, Math.max(0, fraction));
    this.#place();
  }

  #dragDivider(event) {
    event.preventDefault();
    this.#divider.focus();
    this.#divider.setPointerCapture(event.pointerId);
    const drag = (moved) => this.#setSplit((this.#pointOf(moved).x - this.#left) / (this.#size.width * this.#scale));
    this.#divider.addEventListener("pointermove", drag);
    this.#divider.addEventListener("lostpointercapture", () => this.#divider.removeEventListener("pointermove", drag), { once: true });
  }

  #dividerKey(event) {
    const step = event.shiftKey ? 0.1 : 0.02;
    const to = { ArrowLeft: this.#split - step, ArrowRight: this.#split + step, Home: 0, End: 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this.#setSplit(to);
  }
}
