// What a report does in a browser, second part: figures that zoom and say their values.

// ---- figures: the drawing is the data, in steps of 1/65535 of each axis ----
const FULL = 65535;
const CLOSEST = FULL / 100; // beyond it a step of the drawing would be seen
const FEW = 12; // points of a curve in view, below which its corners are drawing
const NEAR = 40; // px
const SVG = "http://www.w3.org/2000/svg";
const KINDS = ["curve", "mean", "rejected", "measured", "shape", "unloading"]; // as the keyboard goes through them
const LINES = KINDS.map((kind) => `path.${kind}`).join(", ");
const rank = (path) => KINDS.findIndex((kind) => path.classList.contains(kind));

function pointsOf(path) {
  const xs = [], ys = [];
  let x = 0, y = 0;
  for (const [, kind, rest] of path.getAttribute("d").matchAll(/([Ml])([^Ml]*)/g)) {
    const steps = (rest.match(/-?\d+/g) ?? []).map(Number);
    if (kind === "M") {
      if (xs.length) { xs.push(NaN); ys.push(NaN); } // a gap
      [x, y] = steps;
      xs.push(x); ys.push(y);
      steps.splice(0, 2);
    }
    for (let i = 0; i + 1 < steps.length; i += 2) {
      x += steps[i]; y += steps[i + 1];
      xs.push(x); ys.push(y);
    }
  }
  return { xs, ys };
}

function ticksBetween(low, high, most) {
  const rough = (high - low) / most;
  const ten = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * ten).find((each) => each >= rough);
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) {
    const text = (i * step).toFixed(places);
    ticks.push({ value: i * step, text: minus(Number(text) === 0 ? text.replace("-", "") : text) });
  }
  return ticks;
}

/** Buttons that are one stop of the Tab key; left and right go from one to the next. */
function oneStop(buttons) {
  buttons.forEach((button, at) => {
    button.setAttribute("tabindex", at ? "-1" : "0");
    button.addEventListener("keydown", (event) => {
      const next = buttons[at + { ArrowRight: 1, ArrowLeft: -1 }[event.key]];
      if (!next) return;
      button.setAttribute("tabindex", "-1");
      next.setAttribute("tabindex", "0");
      next.focus();
      event.preventDefault();
    });
  });
}

class Plot {
  constructor(figure, area) {
    this.figure = figure;
    this.area = area;
    this.frame = figure.querySelector("svg.frame");
    const of = (name) => Number(area.dataset[name]);
    this.x0 = of("x0"); this.x1 = of("x1"); this.y0 = of("y0"); this.y1 = of("y1");
    this.box = Object.fromEntries(["x", "y", "width", "height"].map((name) => [name, Number(area.getAttribute(name))]));
    this.view = { x: 0, y: 0, w: FULL, h: FULL };
    this.firstTicks = ["x", "y"].map((axis) => all(`.${axis}-axis .tick`, figure));
    this.tickParents = this.firstTicks.map(([first]) => first?.parentNode);
    this.tools();
    this.legend();
    this.listen();
  }

  valueX(at) { return this.x0 + (at / FULL) * (this.x1 - this.x0); }
  valueY(at) { return this.y1 - (at / FULL) * (this.y1 - this.y0); }
  unit(axis) { return this.area.dataset[`${axis}Unit`] ?? ""; }

  /** Curves that are switched on, with their points. */
  lines() {
    this.parsed ??= all(LINES, this.area).map((path) => ({ path, ...pointsOf(path) }))
      .sort((a, b) => rank(a.path) - rank(b.path));
    return this.parsed.filter(({ path }) => !path.classList.contains("is-off"));
  }

  tools() {
    const button = (words, sign, act) =>
      make("button", { type: "button", tabindex: "-1", "aria-label": words, title: words, onclick: act }, sign);
    this.readout = make("output", { class: "readout" });
    this.note = make("p", { class: "zoom-note", hidden: true });
    const tools = make("div", { class: "plot-tools" },
      button("Zoom in", "+", () => this.zoom(0.5)),
      button("Zoom out", "\u2212", () => this.zoom(2)),
      button("Whole curves", "all", () => this.show({ x: 0, y: 0, w: FULL, h: FULL })),
      this.readout);
    this.frame.after(tools, this.note);
    this.tip = make("div", { class: "tip", hidden: true });
    this.figure.append(this.tip);
    this.frame.setAttribute("tabindex", "0");
    this.frame.setAttribute("aria-keyshortcuts", "ArrowLeft ArrowRight ArrowUp ArrowDown + - 0");
  }

  legend() {
    const items = all(".legend li[data-t], .legend li[data-class], .legend li[data-group]", this.figure);
    const toggles = items.map((item) => {
      const button = make("button", { type: "button", "aria-pressed": "true" }, ...item.childNodes);
      item.append(button);
      button.addEventListener("click", (event) => {
        if (event.shiftKey) for (const each of toggles) this.turn(each, each.item === item);
        else this.turn({ item, button }, button.getAttribute("aria-pressed") !== "true");
      });
      return { item, button };
    });
    for (const [words, isOn] of toggles.length < 3 ? [] : [["all", true], ["none", false]]) {
      const button = make("button", { type: "button" }, words);
      button.addEventListener("click", () => { for (const each of toggles) this.turn(each, isOn); });
      items[0].parentElement.append(make("li", { class: "legend-all" }, button));
    }
    oneStop(all(".legend button", this.figure));
  }

  turn({ item, button }, isOn) {
    button.setAttribute("aria-pressed", String(isOn));
    const { t, class: kind, group } = item.dataset;
    for (const path of all("path", this.area)) {
      const own = t !== undefined ? path.dataset.t === t
        : kind !== undefined ? path.classList.contains(kind) : path.dataset.group === group;
      if (own) path.classList.toggle("is-off", !isOn);
    }
  }

  /** Where the pointer is: px on the screen to steps of the drawing. */
  at(event) {
    const box = this.frame.getBoundingClientRect();
    const scale = box.width / this.frame.viewBox.baseVal.width;
    const left = box.left + this.box.x * scale, top = box.top + this.box.y * scale;
    const width = this.box.width * scale, height = this.box.height * scale;
    const { x, y, w, h } = this.view;
    const across = (event.clientX - left) / width, up = (event.clientY - top) / height;
    return { x: x + across * w, y: y + up * h, px: w / width, py: h / height,
      isInside: across >= 0 && across <= 1 && up >= 0 && up <= 1 };
  }

  /** The point of any curve that is nearest to a place, on the line between two points. */
  nearest({ x, y, px, py }) {
    let best = { distance: NEAR };
    for (const line of this.lines()) {
      const { xs, ys } = line;
      for (let i = 1; i < xs.length; i += 1) {
        const ux = (xs[i] - xs[i - 1]) / px, uy = (ys[i] - ys[i - 1]) / py;
        const vx = (x - xs[i - 1]) / px, vy = (y - ys[i - 1]) / py;
        const length = ux * ux + uy * uy;
        const share = length ? Math.min(1, Math.max(0, (ux * vx + uy * vy) / length)) : 0;
        const distance = Math.hypot(vx - share * ux, vy - share * uy);
        if (distance < best.distance) {
          best = { distance, line, i, x: xs[i - 1] + share * ux * px, y: ys[i - 1] + share * uy * py };
        }
      }
    }
    return best.line ? best : null;
  }

  words({ line, x, y }) {
    const { path } = line;
    const kind = { mean: "mean", unloading: "unloading", measured: "as measured" };
    const own = Object.keys(kind).find((each) => path.classList.contains(each));
    const item = path.dataset.group && this.figure.querySelector(`.legend li[data-group="${CSS.escape(path.dataset.group)}"]`);
    const who = [nameOf(path.dataset.t) || item?.textContent.trim(), kind[own]].filter(Boolean).join(", ");
    const isRejected = path.classList.contains("rejected") || path.classList.contains("is-rejected");
    const write = (value, low, high, unit) => {
      const places = Math.min(6, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(high - low) || 1))));
      return `${minus(value.toFixed(places))} ${unit}`.trim();
    };
    return [who + (isRejected ? " (rejected)" : ""),
      write(this.valueX(x), this.x0, this.x1, this.unit("x")),
      write(this.valueY(y), this.y0, this.y1, this.unit("y"))].filter(Boolean).join(" \u00b7 ");
  }

  point(found) {
    for (const path of all(".is-near", this.area)) path.classList.remove("is-near");
    this.tip.hidden = !found;
    this.readout.textContent = found ? this.words(found) : "";
    if (!found) return;
    found.line.path.classList.add("is-near");
    const own = this.figure.getBoundingClientRect(), box = this.frame.getBoundingClientRect();
    const scale = box.width / this.frame.viewBox.baseVal.width;
    const across = ((found.x - this.view.x) / this.view.w) * this.box.width + this.box.x;
    const up = ((found.y - this.view.y) / this.view.h) * this.box.height + this.box.y;
    this.tip.textContent = this.readout.textContent;
    const left = box.left - own.left + across * scale;
    this.tip.classList.toggle("is-left", left > own.width / 2);
    this.tip.style.left = `${left}px`;
    this.tip.style.top = `${box.top - own.top + up * scale}px`;
  }

  zoom(factor, centre = null) {
    const { x, y, w, h } = this.view;
    const c = centre ?? { x: x + w / 2, y: y + h / 2 };
    const f = Math.max(factor, CLOSEST / Math.min(w, h));
    this.show({ x: c.x - (c.x - x) * f, y: c.y - (c.y - y) * f, w: w * f, h: h * f });
  }

  /** Show a part of the drawing, as much of it as there is. */
  show(wanted) {
    const w = Math.min(FULL, Math.max(CLOSEST, wanted.w)), h = Math.min(FULL, Math.max(CLOSEST, wanted.h));
    const x = Math.min(FULL - w, Math.max(0, wanted.x)), y = Math.min(FULL - h, Math.max(0, wanted.y));
    this.view = { x, y, w, h };
    this.area.setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
    this.point(null);
    this.drawTicks();
    this.sayLimits();
  }

  drawTicks() {
    const { x, y, w, h } = this.view;
    const isWhole = w === FULL && h === FULL;
    const ends = [[this.valueX(x), this.valueX(x + w)], [this.valueY(y + h), this.valueY(y)]];
    ["x", "y"].forEach((axis, number) => {
      const first = this.firstTicks[number];
      if (!first.length) return;
      const parent = this.tickParents[number];
      for (const tick of all(".tick", parent)) tick.remove();
      if (isWhole) { parent.append(...first); return; }
      const [low, high] = ends[number];
      for (const { value, text } of ticksBetween(low, high, 6)) {
        const share = (value - low) / (high - low);
        const tick = first[0].cloneNode(true);
        const [left, top] = first[0].getAttribute("transform").match(/-?[\d.]+/g);
        tick.setAttribute("transform", axis === "x"
          ? `translate(${this.box.x + share * this.box.width} ${top})`
          : `translate(${left} ${this.box.y + (1 - share) * this.box.height})`);
        tick.querySelector("text").textContent = text;
        parent.append(tick);
      }
    });
  }

  /** Say what a zoom cannot show: between its points a curve is a drawing. */
  sayLimits() {
    const { x, y, w, h } = this.view;
    const inView = this.lines().map(({ xs, ys }) => xs.map((each, i) => [each, ys[i]]).filter(([across, up]) =>
      across >= x && across <= x + w && up >= y && up <= y + h));
    this.note.hidden = w > FULL / 2 || inView.some((points) => points.length >= FEW);
    this.dots ??= this.area.appendChild(document.createElementNS(SVG, "path"));
    this.dots.setAttribute("class", "dots");
    const places = this.note.hidden ? [] : inView.flat().map(([across, up]) => `M${across} ${up}h0`);
    this.dots.setAttribute("d", places.join(""));
    this.note.textContent = "The page has at most 150 points per curve, to 1/65535 of its axes. "
      + "At this zoom only few points are visible, joined by straight lines: all samples are in the result.h5 of the test.";
  }

  listen() {
    const { frame } = this;
    let start = null;
    const box = document.createElementNS(SVG, "rect");
    box.setAttribute("class", "zoom-box");
    frame.addEventListener("pointerdown", (event) => {
      const at = this.at(event);
      if (event.button || event.pointerType === "touch" || !at.isInside) return;
      start = at;
      frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      const at = this.at(event);
      if (!start) { this.point(at.isInside ? this.nearest(at) : null); return; }
      this.point(null);
      if (!box.isConnected) this.area.append(box);
      for (const [name, value] of Object.entries({ x: Math.min(start.x, at.x), y: Math.min(start.y, at.y),
        width: Math.abs(at.x - start.x), height: Math.abs(at.y - start.y) })) box.setAttribute(name, value);
    });
    frame.addEventListener("pointerup", (event) => {
      box.remove();
      const at = this.at(event), from = start;
      start = null;
      if (event.pointerType === "touch") this.point(at.isInside ? this.nearest(at) : null);
      if (!from || Math.abs(at.x - from.x) < 5 * at.px || Math.abs(at.y - from.y) < 5 * at.py) return;
      this.show({ x: Math.min(from.x, at.x), y: Math.min(from.y, at.y),
        w: Math.abs(at.x - from.x), h: Math.abs(at.y - from.y) });
    });
    frame.addEventListener("pointercancel", () => { start = null; box.remove(); });
    frame.addEventListener("pointerleave", () => { if (!start) this.point(null); });
    frame.addEventListener("dblclick", () => this.show({ x: 0, y: 0, w: FULL, h: FULL }));
    frame.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // else the page would not scroll
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 0.8 : 1.25, this.at(event));
    }, { passive: false });
    frame.addEventListener("keydown", (event) => this.key(event));
    frame.addEventListener("blur", () => { this.point(null); this.cursor = null; });
  }

  key(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const { x, y, w, h } = this.view;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key in steps && event.shiftKey) {
      const [across, up] = steps[event.key];
      this.show({ x: x + 0.2 * w * across, y: y + 0.2 * h * up, w, h });
    } else if (event.key in steps) this.walk(...steps[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.5, this.cursorPlace());
    else if (event.key === "-") this.zoom(2, this.cursorPlace());
    else if (event.key === "0" || event.key === "Escape") this.show({ x: 0, y: 0, w: FULL, h: FULL });
    else return;
    event.preventDefault();
  }

  /** Move the keyboard's cursor along a curve, or to the next one. */
  walk(along, across) {
    const lines = this.lines();
    if (!lines.length) return;
    const cursor = this.cursor ?? { line: 0, i: 0 };
    if (this.cursor && across) {
      const before = lines[cursor.line % lines.length].xs[cursor.i];
      cursor.line = (cursor.line + across + lines.length) % lines.length;
      const { xs } = lines[cursor.line];
      cursor.i = xs.reduce((best, each, i) => Math.abs(each - before) < Math.abs(xs[best] - before) ? i : best, 0);
    }
    cursor.line %= lines.length;
    const line = lines[cursor.line];
    if (this.cursor) cursor.i += along;
    if (Number.isNaN(line.xs[cursor.i])) cursor.i += along;
    cursor.i = Math.min(line.xs.length - 1, Math.max(0, cursor.i));
    this.cursor = cursor;
    this.keepInView(line.xs[cursor.i], line.ys[cursor.i]);
    this.point({ line, i: cursor.i, x: line.xs[cursor.i], y: line.ys[cursor.i] });
  }

  keepInView(across, up) {
    const { x, y, w, h } = this.view;
    if (across >= x && across <= x + w && up >= y && up <= y + h) return;
    this.show({ x: across - w / 2, y: up - h / 2, w, h });
  }

  cursorPlace() {
    if (!this.cursor) return null;
    const line = this.lines()[this.cursor.line];
    return line ? { x: line.xs[this.cursor.i], y: line.ys[this.cursor.i] } : null;
  }
}
