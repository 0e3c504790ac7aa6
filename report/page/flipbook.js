// A flip-book: one canvas for all methods; place and exposure stay when the method changes.

const LARGEST_ZOOM = 64;

class FlipBook {
  constructor(root, book, errors) {
    Object.assign(this, { root, book, errors });
    root.flipBook = this;
    this.find = (selector) => root.querySelector(selector);
    this.canvas = this.find("canvas");
    this.sheet = document.createElement("canvas"); // the picture at its own size
    this.decoded = new Map(); // id -> promise of codes
    this.state = { method: book.start, view: 0, stops: 0, error: false, held: false };
    this.place = { zoom: 1, x: 0.5, y: 0.5 }; // zoom 1 shows all; (x, y): centre of the shown part, from 0 to 1
    this.pointer = null; // where the mouse is, in CSS pixels of the canvas
    this.fingers = new Map();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.seen = new IntersectionObserver((entries) => entries.some((e) => e.isIntersecting) && this.open());
    this.seen.observe(root);
  }

  // ---- the shown picture

  get view() { return this.book.views[this.state.view]; }
  get method() { return this.state.held ? "reference" : this.state.method; }
  get names() { return this.book.methods.map((m) => m.name).filter((m) => m in this.view.pictures); }
  titleOf(name) { return this.book.methods.find((m) => m.name === name).title; }

  /** When the book comes into sight: show a picture, then decode the others. */
  async open() {
    this.seen.disconnect();
    await this.show();
    this.prepare();
  }

  async prepare() {
    const view = this.view;
    for (const name of this.names) {
      if (view !== this.view) return;
      await this.codes(name).catch(() => null); // show() reports the error
    }
  }

  codes(name) {
    const { id, width, height } = this.view.pictures[name];
    if (!this.decoded.has(id)) {
      this.decoded.set(id, unpack(document.getElementById(id).textContent, width, height));
    }
    return this.decoded.get(id);
  }

  set(change) {
    Object.assign(this.state, change);
    if (!(this.state.method in this.view.pictures)) this.state.method = this.names[0];
    if ("view" in change) this.prepare();
    return this.show();
  }

  async show() {
    const asked = (this.asked = {});
    this.label();
    try {
      const [codes, wanted] = await Promise.all([this.codes(this.method), this.codes("reference")]);
      if (asked !== this.asked) return; // another picture was asked for in the meantime
      this.current = { codes, wanted, ...this.view.pictures[this.method] };
      this.paint();
      this.draw();
      this.root.dataset.shows = `${this.view.name}/${this.method}`;
    } catch (error) {
      this.find(".waiting").textContent = `This picture cannot be shown here (${error.message}).`;
      this.find(".waiting").hidden = false;
    }
  }

  /** Update radio buttons, numbers and names around the picture. */
  label() {
    const { method, stops, error } = this.state;
    for (const row of this.root.querySelectorAll(".methods label")) {
      const name = row.firstElementChild.value;
      row.hidden = !(name in this.view.pictures);
      row.firstElementChild.checked = name === method;
      row.querySelector(".psnr").textContent = decibels(this.view.numbers[name]);
      row.style.setProperty("--share", share(this.view.numbers[name]));
    }
    for (const [k, button] of this.root.querySelectorAll(".views input").entries()) {
      button.checked = k === this.state.view;
    }
    this.find(".exposure input").value = stops;
    this.find(".exposure output").textContent = `${stops < 0 ? "−" : "+"}${Math.abs(stops).toFixed(2)}`;
    this.find(".error").setAttribute("aria-pressed", error);
    this.find(".scale").hidden = !error;
    const title = this.titleOf(this.method);
    const numbers = describe(this.view.numbers[this.method]);
    this.find(".shown b").textContent = title;
    this.find(".shown span").textContent = numbers;
    const what = error ? "error map of " : "";
    this.canvas.setAttribute("aria-label", `${this.book.title}, view ${this.view.name}: ${what}${title}. ${numbers}`);
    this.find(".spoken").textContent = `${what}${title}. ${numbers}`;
  }

  /** Draw the picture or its error map on the sheet. */
  paint() {
    const { codes, wanted, width, height } = this.current;
    const { colours, largest } = this.errors;
    const steps = colours.length / 3 - 1;
    const shown = shownAt(this.book.exposure * 2 ** this.state.stops);
    Object.assign(this.sheet, { width, height });
    const image = new ImageData(width, height);
    const out = image.data;
    for (let i = 0, j = 0; i < codes.length; i += 3, j += 4) {
      if (this.state.error) {
        let difference = 0;
        for (let c = 0; c < 3; c++) difference += Math.abs(shown[codes[i + c]] - shown[wanted[i + c]]);
        const k = 3 * Math.round(steps * Math.min(1, difference / 3 / largest));
        for (let c = 0; c < 3; c++) out[j + c] = colours[k + c];
      } else {
        for (let c = 0; c < 3; c++) out[j + c] = Math.round(255 * shown[codes[i + c]]);
      }
      out[j + 3] = 255;
    }
    this.sheet.getContext("2d").putImageData(image, 0, 0);
    this.find(".waiting").hidden = true;
  }

  /** Draw the sheet on the canvas, with pan and zoom. */
  draw() {
    const { clientWidth, clientHeight } = this.canvas;
    const density = window.devicePixelRatio || 1;
    const width = Math.round(clientWidth * density);
    const height = Math.round(clientHeight * density);
    if (!this.current || !width || !height) return;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const { scale, left, top } = this.layout();
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = scale * density < 1;
    context.drawImage(
      this.sheet, left * density, top * density,
      this.sheet.width * scale * density, this.sheet.height * scale * density,
    );
    this.find(".zoom output").textContent = `${scale < 9.95 ? scale.toFixed(1) : Math.round(scale)}×`;
    // Without zoom, a finger on the picture scrolls the page.
    this.canvas.style.touchAction = this.place.zoom > 1 ? "none" : "pan-y";
    this.canvas.classList.toggle("zoomed", this.place.zoom > 1);
    this.read();
  }

  // ---- pan and zoom

  /** CSS pixels per picture pixel, and the place of the picture's upper left corner. */
  layout() {
    const { clientWidth, clientHeight } = this.canvas;
    const { width, height } = this.sheet;
    const scale = Math.min(clientWidth / width, clientHeight / height) * this.place.zoom;
    const along = (room, size, middle) =>
      size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, room / 2 - middle * size));
    return {
      scale,
      left: along(clientWidth, width * scale, this.place.x),
      top: along(clientHeight, height * scale, this.place.y),
    };
  }

  /** Zoom by a factor around the point (x, y) of the canvas. */
  zoomBy(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const before = this.layout();
    const zoom = Math.min(LARGEST_ZOOM, Math.max(1, this.place.zoom * factor));
    const ratio = zoom / this.place.zoom;
    this.place.zoom = zoom;
    this.put(x - (x - before.left) * ratio, y - (y - before.top) * ratio);
  }

  panBy(dx, dy) {
    const { left, top } = this.layout();
    this.put(left + dx, top + dy);
  }

  /** Move the picture's upper left corner, but keep the canvas covered. */
  put(left, top) {
    const { clientWidth, clientHeight } = this.canvas;
    const { scale } = this.layout();
    this.place.x = (clientWidth / 2 - left) / (this.sheet.width * scale);
    this.place.y = (clientHeight / 2 - top) / (this.sheet.height * scale);
    const kept = this.layout(); // clamped
    this.place.x = (clientWidth / 2 - kept.left) / (this.sheet.width * scale);
    this.place.y = (clientHeight / 2 - kept.top) / (this.sheet.height * scale);
    this.draw();
  }

  fit() {
    this.place = { zoom: 1, x: 0.5, y: 0.5 };
    this.draw();
  }

  // ---- the pixel under the pointer, or in the middle

  read() {
    const { codes, wanted, width, height } = this.current;
    const { scale, left, top } = this.layout();
    const { x, y } = this.pointer ?? { x: this.canvas.clientWidth / 2, y: this.canvas.clientHeight / 2 };
    const column = Math.floor((x - left) / scale);
    const row = Math.floor((y - top) / scale);
    const inside = column >= 0 && row >= 0 && column < width && row < height;
    const at = 3 * (row * width + column);
    const values = (from) => [0, 1, 2].map((c) => figure(radianceOf[from[at + c]])).join("  ");
    this.find(".place").textContent = inside ? `x ${column}, y ${row}${this.pointer ? "" : " (middle)"}` : "";
    this.find(".value").textContent = inside ? values(codes) : "";
    this.find(".wanted").textContent = inside ? values(wanted) : "";
  }

  // ---- input

  step(by) {
    const names = this.names;
    this.set({ method: names[(names.indexOf(this.state.method) + by + names.length) % names.length] });
  }

  leaf(by) {
    const count = this.book.views.length;
    this.set({ view: (this.state.view + by + count) % count });
  }

  expose(stops) {
    this.set({ stops: Math.min(8, Math.max(-8, stops)) });
  }

  listen() {
    const on = (selector, event, act) => {
      for (const element of this.root.querySelectorAll(selector)) element.addEventListener(event, act);
    };
    on(".methods input", "change", (e) => this.set({ method: e.target.value }));
    on(".views input", "change", (e) => this.set({ view: Number(e.target.value) }));
    on(".exposure input", "input", (e) => this.expose(Number(e.target.value)));
    on(".exposure button", "click", () => this.expose(0));
    on(".error", "click", () => this.set({ error: !this.state.error }));
    on(".before", "click", () => this.step(-1));
    on(".after", "click", () => this.step(1));
    on(".closer", "click", () => this.zoomBy(2));
    on(".further", "click", () => this.zoomBy(0.5));
    on(".fit", "click", () => this.fit());
    const hold = (held) => held !== this.state.held && this.set({ held });
    on(".hold", "pointerdown", () => hold(true));
    for (const event of ["pointerup", "pointerleave", "pointercancel", "blur"]) on(".hold", event, () => hold(false));
    on(".hold", "contextmenu", (e) => e.preventDefault());
    on(".hold", "keydown", (e) => [" ", "Enter"].includes(e.key) && hold(true));
    this.root.addEventListener("keyup", (e) => [" ", "Enter"].includes(e.key) && hold(false));
    this.listenToCanvas();
  }

  listenToCanvas() {
    const { canvas, fingers } = this;
    const at = (e) => {
      const box = canvas.getBoundingClientRect();
      return { x: e.clientX - box.left, y: e.clientY - box.top };
    };
    canvas.addEventListener("pointerdown", (e) => {
      fingers.set(e.pointerId, at(e));
      if (this.place.zoom > 1 || fingers.size > 1) canvas.setPointerCapture(e.pointerId);
      this.point(at(e));
    });
    canvas.addEventListener("pointermove", (e) => {
      const now = at(e);
      const before = fingers.get(e.pointerId);
      if (before && fingers.size === 1 && this.place.zoom > 1) this.panBy(now.x - before.x, now.y - before.y);
      if (before && fingers.size === 2) this.pinch(e.pointerId, now);
      if (before) fingers.set(e.pointerId, now);
      this.point(now);
    });
    for (const event of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(event, (e) => fingers.delete(e.pointerId));
    }
    canvas.addEventListener("pointerleave", (e) => {
      fingers.delete(e.pointerId);
      if (e.pointerType === "mouse") this.point(null);
    });
    canvas.addEventListener("dblclick", (e) => (this.place.zoom > 1 ? this.fit() : this.zoomBy(4, at(e).x, at(e).y)));
    // The wheel scrolls the page, and zooms after a click on the picture.
    canvas.addEventListener("wheel", (e) => {
      if (!e.ctrlKey && document.activeElement !== canvas) return;
      e.preventDefault();
      this.zoomBy(2 ** (-e.deltaY / (e.ctrlKey ? 100 : 300)), at(e).x, at(e).y);
    }, { passive: false });
  }

  /** Pan and zoom with two fingers. */
  pinch(id, now) {
    const [other] = [...this.fingers].filter(([key]) => key !== id).map(([, place]) => place);
    const before = this.fingers.get(id);
    const gap = (a) => Math.hypot(a.x - other.x, a.y - other.y);
    this.panBy((now.x - before.x) / 2, (now.y - before.y) / 2);
    this.zoomBy(gap(now) / Math.max(1, gap(before)), (now.x + other.x) / 2, (now.y + other.y) / 2);
  }

  point(place) {
    this.pointer = place;
    if (this.current) this.read();
  }

  /** Returns whether the key was used. */
  key(e) {
    if (e.altKey || e.ctrlKey || e.metaKey) return false;
    const inList = e.target.type === "radio" || e.target.type === "range"; // they use the arrow keys
    const onCanvas = e.target === this.canvas;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (arrow && inList) return false;
    if (arrow && e.shiftKey && onCanvas) return this.panBy(-40 * arrow[0], -40 * arrow[1]), true;
    if (arrow && (arrow[0] || onCanvas)) return this.step(arrow[0] + arrow[1]), true;
    if (/^[0-9]$/.test(e.key)) {
      const name = this.names[(Number(e.key) + 9) % 10];
      return name ? (this.set({ method: name }), true) : false;
    }
    const acts = {
      e: () => this.set({ error: !this.state.error }),
      r: () => this.state.held || this.set({ held: true }),
      f: () => this.fit(),
      v: () => this.leaf(1),
      "+": () => this.zoomBy(2),
      "=": () => this.zoomBy(2),
      "-": () => this.zoomBy(0.5),
      ",": () => this.expose(this.state.stops - 0.5),
      ".": () => this.expose(this.state.stops + 0.5),
    };
    const act = acts[e.key.toLowerCase()];
    return act ? (act(), true) : false;
  }
}

function decibels(numbers) {
  return numbers?.psnr === undefined ? "" : `${numbers.psnr.toFixed(1)} dB`;
}

/** PSNR from 10 to 50 dB as 0 to 1, for the bars below the names. */
function share(numbers) {
  return numbers?.psnr === undefined ? 0 : Math.min(1, Math.max(0, (numbers.psnr - 10) / 40));
}

function describe(numbers = {}) {
  const parts = [["PSNR", "psnr", 1, " dB"], ["SSIM", "ssim", 3, ""], ["LPIPS", "lpips", 3, ""], ["FLIP", "flip", 3, ""]];
  const known = parts.filter(([, key]) => numbers[key] !== undefined);
  return known.map(([name, key, digits, unit]) => `${name} ${numbers[key].toFixed(digits)}${unit}`).join(" · ");
}

/** Radiance as text, with the precision of a code. */
function figure(value) {
  if (value === 0) return "0";
  return value < 1e-3 || value >= 1e4 ? value.toExponential(1) : value.toPrecision(3);
}
