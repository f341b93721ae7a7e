// Script of a report page, second of three parts: plots that zoom and show the values of their curves.

// ---- plots: coordinates of a path are integers from 0 to 65535 along each axis ----
const FULL_RANGE = 65535;
const MIN_VIEW_SIZE = FULL_RANGE / 100; // in a smaller view, the rounding of the coordinates would be visible
const MIN_DETAILED_POINTS = 12; // with fewer points of every curve in view, their straight connections are visible
const MAX_POINTER_DISTANCE = 40; // px
const MIN_DRAG = 5; // px
const SVG_NAMESPACE = "http://www.w3.org/2000/svg";
const CURVE_KINDS = ["curve", "mean", "rejected", "measured", "shape", "unloading"]; // in the order of the arrow keys
const CURVE_SELECTOR = CURVE_KINDS.map((kind) => `path.${kind}`).join(", ");
const getKindRank = (path) => CURVE_KINDS.findIndex((kind) => path.classList.contains(kind));
const isBetween = (value, low, size) => value >= low && value <= low + size;

/** Parse the points of a path of absolute moves and relative lines; NaN between two segments. */
function parsePoints(path) {
  const xs = [], ys = [];
  let x = 0, y = 0;
  for (const [, command, coordinates] of path.getAttribute("d").matchAll(/([Ml])([^Ml]*)/g)) {
    const steps = (coordinates.match(/-?\d+/g) ?? []).map(Number);
    if (command === "M") {
      if (xs.length) { xs.push(NaN); ys.push(NaN); }
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

/** Choose ticks at round values, at most `maxSteps` + 1. */
function chooseTicks(low, high, maxSteps) {
  const minStep = (high - low) / maxSteps;
  const decade = 10 ** Math.floor(Math.log10(minStep));
  const step = [1, 2, 5, 10].map((factor) => factor * decade).find((value) => value >= minStep);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) {
    const text = (i * step).toFixed(decimals);
    ticks.push({ value: i * step, text: typesetMinus(Number(text) === 0 ? text.replace("-", "") : text) });
  }
  return ticks;
}

/** Make buttons a single stop of the Tab key; the left and right arrow keys move between them. */
function shareTabStop(buttons) {
  buttons.forEach((button, index) => {
    button.setAttribute("tabindex", index ? "-1" : "0");
    button.addEventListener("keydown", (event) => {
      const next = buttons[index + { ArrowRight: 1, ArrowLeft: -1 }[event.key]];
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
    const getLimit = (name) => Number(area.dataset[name]);
    this.x0 = getLimit("x0"); this.x1 = getLimit("x1"); this.y0 = getLimit("y0"); this.y1 = getLimit("y1");
    this.box = Object.fromEntries(["x", "y", "width", "height"].map((name) => [name, Number(area.getAttribute(name))]));
    this.view = { x: 0, y: 0, w: FULL_RANGE, h: FULL_RANGE };
    this.initialTicks = ["x", "y"].map((axis) => selectAll(`.${axis}-axis .tick`, figure));
    this.tickParents = this.initialTicks.map(([first]) => first?.parentNode);
    this.addTools();
    this.addLegendButtons();
    this.addListeners();
  }

  toValueX(x) { return this.x0 + (x / FULL_RANGE) * (this.x1 - this.x0); }
  toValueY(y) { return this.y1 - (y / FULL_RANGE) * (this.y1 - this.y0); }

  /** Return the curves that are shown, with their points. */
  getCurves() {
    this.allCurves ??= selectAll(CURVE_SELECTOR, this.area).map((path) => ({ path, ...parsePoints(path) }))
      .sort((a, b) => getKindRank(a.path) - getKindRank(b.path));
    return this.allCurves.filter(({ path }) => !path.classList.contains("is-off"));
  }

  addTools() {
    const makeButton = (label, symbol, onclick) =>
      makeElement("button", { type: "button", tabindex: "-1", "aria-label": label, title: label, onclick }, symbol);
    this.readout = makeElement("output", { class: "readout" });
    this.note = makeElement("p", { class: "zoom-note", hidden: true });
    const tools = makeElement("div", { class: "plot-tools" },
      makeButton("Zoom in", "+", () => this.zoom(0.5)),
      makeButton("Zoom out", "\u2212", () => this.zoom(2)),
      makeButton("Whole curves", "all", () => this.showAll()),
      this.readout);
    this.frame.after(tools, this.note);
    this.tip = makeElement("div", { class: "tip", hidden: true });
    this.figure.append(this.tip);
    this.frame.setAttribute("tabindex", "0");
    this.frame.setAttribute("aria-keyshortcuts", "ArrowLeft ArrowRight ArrowUp ArrowDown + - 0");
  }

  /** Make the legend entries buttons that show and hide their curves. */
  addLegendButtons() {
    const items = selectAll(".legend li[data-t], .legend li[data-class], .legend li[data-group]", this.figure);
    const entries = items.map((item) => {
      const button = makeElement("button", { type: "button", "aria-pressed": "true" }, ...item.childNodes);
      item.append(button);
      button.addEventListener("click", (event) => {
        if (event.shiftKey) for (const entry of entries) this.toggleCurves(entry, entry.item === item);
        else this.toggleCurves({ item, button }, button.getAttribute("aria-pressed") !== "true");
      });
      return { item, button };
    });
    for (const [label, isShown] of entries.length < 3 ? [] : [["all", true], ["none", false]]) {
      const button = makeElement("button", { type: "button" }, label);
      button.addEventListener("click", () => { for (const entry of entries) this.toggleCurves(entry, isShown); });
      items[0].parentElement.append(makeElement("li", { class: "legend-all" }, button));
    }
    shareTabStop(selectAll(".legend button", this.figure));
  }

  /** Show or hide the curves of a legend entry. */
  toggleCurves({ item, button }, isShown) {
    button.setAttribute("aria-pressed", String(isShown));
    const { t, class: className, group } = item.dataset;
    for (const path of selectAll("path", this.area)) {
      const isOfEntry = t !== undefined ? path.dataset.t === t
        : className !== undefined ? path.classList.contains(className) : path.dataset.group === group;
      if (isOfEntry) path.classList.toggle("is-off", !isShown);
    }
  }

  /** Return the box of the axes on the screen, and the scale of the drawing; px. */
  getScreenBox() {
    const frame = this.frame.getBoundingClientRect();
    const scale = frame.width / this.frame.viewBox.baseVal.width;
    return { left: frame.left + this.box.x * scale, top: frame.top + this.box.y * scale,
      width: this.box.width * scale, height: this.box.height * scale };
  }

  /** Convert the position of the pointer to coordinates; `px` and `py` are coordinates per pixel. */
  toCoordinates(event) {
    const { left, top, width, height } = this.getScreenBox();
    const { x, y, w, h } = this.view;
    const shareX = (event.clientX - left) / width, shareY = (event.clientY - top) / height;
    return { x: x + shareX * w, y: y + shareY * h, px: w / width, py: h / height,
      isInside: isBetween(shareX, 0, 1) && isBetween(shareY, 0, 1) };
  }

  /** Find the point on a curve that is nearest to a position; null if none is near. */
  findNearestPoint({ x, y, px, py }) {
    let nearest = { distance: MAX_POINTER_DISTANCE };
    for (const curve of this.getCurves()) {
      const { xs, ys } = curve;
      for (let i = 1; i < xs.length; i += 1) {
        const segmentX = (xs[i] - xs[i - 1]) / px, segmentY = (ys[i] - ys[i - 1]) / py;
        const offsetX = (x - xs[i - 1]) / px, offsetY = (y - ys[i - 1]) / py;
        const squaredLength = segmentX * segmentX + segmentY * segmentY;
        const projection = (segmentX * offsetX + segmentY * offsetY) / squaredLength;
        const share = squaredLength ? Math.min(1, Math.max(0, projection)) : 0;
        const distance = Math.hypot(offsetX - share * segmentX, offsetY - share * segmentY);
        if (distance < nearest.distance) {
          nearest = { distance, curve, x: xs[i - 1] + share * segmentX * px, y: ys[i - 1] + share * segmentY * py };
        }
      }
    }
    return nearest.curve ? nearest : null;
  }

  /** Describe a point by the name of its curve and its values. */
  describePoint({ curve: { path }, x, y }) {
    const kindLabels = { mean: "mean", unloading: "unloading", measured: "as measured" };
    const kind = Object.keys(kindLabels).find((className) => path.classList.contains(className));
    const groupItem = path.dataset.group && this.figure.querySelector(`.legend li[data-group="${CSS.escape(path.dataset.group)}"]`);
    const owner = tests.get(path.dataset.t)?.name ?? groupItem?.textContent.trim();
    const name = [owner, kindLabels[kind]].filter(Boolean).join(", ");
    const isRejected = path.classList.contains("rejected") || path.classList.contains("is-rejected");
    const formatValue = (value, low, high, unit = "") => {
      const decimals = Math.min(6, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(high - low) || 1))));
      return `${typesetMinus(value.toFixed(decimals))} ${unit}`.trim();
    };
    return [name + (isRejected ? " (rejected)" : ""),
      formatValue(this.toValueX(x), this.x0, this.x1, this.area.dataset.xUnit),
      formatValue(this.toValueY(y), this.y0, this.y1, this.area.dataset.yUnit)].filter(Boolean).join(" \u00b7 ");
  }

  /** Show the values of a point and highlight its curve; null removes them. */
  showPoint(point) {
    for (const path of selectAll(".is-near", this.area)) path.classList.remove("is-near");
    this.tip.hidden = !point;
    this.readout.textContent = point ? this.describePoint(point) : "";
    if (!point) return;
    point.curve.path.classList.add("is-near");
    this.tip.textContent = this.readout.textContent;
    const figure = this.figure.getBoundingClientRect(), box = this.getScreenBox();
    const left = box.left - figure.left + ((point.x - this.view.x) / this.view.w) * box.width;
    const top = box.top - figure.top + ((point.y - this.view.y) / this.view.h) * box.height;
    this.tip.classList.toggle("is-left", left > figure.width / 2);
    this.tip.style.left = `${left}px`;
    this.tip.style.top = `${top}px`;
  }

  /** Multiply the size of the view by a factor; the centre stays where it is on the screen. */
  zoom(factor, centre = null) {
    const { x, y, w, h } = this.view;
    const { x: centreX, y: centreY } = centre ?? { x: x + w / 2, y: y + h / 2 };
    const allowedFactor = Math.max(factor, MIN_VIEW_SIZE / Math.min(w, h));
    this.showView({ x: centreX - (centreX - x) * allowedFactor, y: centreY - (centreY - y) * allowedFactor,
      w: w * allowedFactor, h: h * allowedFactor });
  }

  showAll() { this.showView({ x: 0, y: 0, w: FULL_RANGE, h: FULL_RANGE }); }

  /** Show a part of the plot, moved and resized so that it is inside the plot. */
  showView(view) {
    const limitSize = (size) => Math.min(FULL_RANGE, Math.max(MIN_VIEW_SIZE, size));
    const w = limitSize(view.w), h = limitSize(view.h);
    const x = Math.min(FULL_RANGE - w, Math.max(0, view.x)), y = Math.min(FULL_RANGE - h, Math.max(0, view.y));
    this.view = { x, y, w, h };
    this.area.setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
    this.showPoint(null);
    this.drawTicks();
    this.showPointsOfCurves();
  }

  drawTicks() {
    const { x, y, w, h } = this.view;
    const isWhole = w === FULL_RANGE && h === FULL_RANGE;
    const limits = [[this.toValueX(x), this.toValueX(x + w)], [this.toValueY(y + h), this.toValueY(y)]];
    ["x", "y"].forEach((axis, index) => {
      const initialTicks = this.initialTicks[index], parent = this.tickParents[index];
      if (!initialTicks.length) return;
      for (const tick of selectAll(".tick", parent)) tick.remove();
      if (isWhole) { parent.append(...initialTicks); return; }
      const [low, high] = limits[index];
      for (const { value, text } of chooseTicks(low, high, 6)) {
        const share = (value - low) / (high - low);
        const tick = initialTicks[0].cloneNode(true);
        const [left, top] = initialTicks[0].getAttribute("transform").match(/-?[\d.]+/g);
        tick.setAttribute("transform", axis === "x"
          ? `translate(${this.box.x + share * this.box.width} ${top})`
          : `translate(${left} ${this.box.y + (1 - share) * this.box.height})`);
        tick.querySelector("text").textContent = text;
        parent.append(tick);
      }
    });
  }

  /** If a view has only few points of each curve, draw them as dots and show a note. */
  showPointsOfCurves() {
    const { x, y, w, h } = this.view;
    const pointsByCurve = this.getCurves().map(({ xs, ys }) => xs.map((pointX, i) => [pointX, ys[i]])
      .filter(([pointX, pointY]) => isBetween(pointX, x, w) && isBetween(pointY, y, h)));
    this.note.hidden = w > FULL_RANGE / 2 || pointsByCurve.some((points) => points.length >= MIN_DETAILED_POINTS);
    this.dots ??= this.area.appendChild(document.createElementNS(SVG_NAMESPACE, "path"));
    this.dots.setAttribute("class", "dots");
    const dots = this.note.hidden ? [] : pointsByCurve.flat().map(([pointX, pointY]) => `M${pointX} ${pointY}h0`);
    this.dots.setAttribute("d", dots.join(""));
    this.note.textContent = "The page has at most 150 points per curve, to 1/65535 of its axes. "
      + "At this zoom only few points are visible, joined by straight lines: all samples are in the result.h5 of the test.";
  }

  addListeners() {
    const { frame } = this;
    let start = null; // position at which a drag began
    const box = document.createElementNS(SVG_NAMESPACE, "rect");
    box.setAttribute("class", "zoom-box");
    const getDraggedBox = (end) => ({ x: Math.min(start.x, end.x), y: Math.min(start.y, end.y),
      width: Math.abs(end.x - start.x), height: Math.abs(end.y - start.y) });
    const showNearestPoint = (position) => this.showPoint(position.isInside ? this.findNearestPoint(position) : null);
    frame.addEventListener("pointerdown", (event) => {
      const position = this.toCoordinates(event);
      if (event.button || event.pointerType === "touch" || !position.isInside) return;
      start = position;
      frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      const position = this.toCoordinates(event);
      if (!start) { showNearestPoint(position); return; }
      this.showPoint(null);
      if (!box.isConnected) this.area.append(box);
      for (const [name, value] of Object.entries(getDraggedBox(position))) box.setAttribute(name, value);
    });
    frame.addEventListener("pointerup", (event) => {
      box.remove();
      const position = this.toCoordinates(event);
      if (event.pointerType === "touch") showNearestPoint(position);
      if (!start) return;
      const { x, y, width, height } = getDraggedBox(position);
      start = null;
      if (width >= MIN_DRAG * position.px && height >= MIN_DRAG * position.py) this.showView({ x, y, w: width, h: height });
    });
    frame.addEventListener("pointercancel", () => { start = null; box.remove(); });
    frame.addEventListener("pointerleave", () => { if (!start) this.showPoint(null); });
    frame.addEventListener("dblclick", () => this.showAll());
    frame.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // without a key, the page scrolls
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? 0.8 : 1.25, this.toCoordinates(event));
    }, { passive: false });
    frame.addEventListener("keydown", (event) => this.handleKey(event));
    frame.addEventListener("blur", () => { this.showPoint(null); this.cursor = null; });
  }

  handleKey(event) {
    const directions = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const { x, y, w, h } = this.view;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key in directions && event.shiftKey) {
      const [stepX, stepY] = directions[event.key];
      this.showView({ x: x + 0.2 * w * stepX, y: y + 0.2 * h * stepY, w, h });
    } else if (event.key in directions) this.moveCursor(...directions[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.5, this.getCursorPosition());
    else if (event.key === "-") this.zoom(2, this.getCursorPosition());
    else if (event.key === "0" || event.key === "Escape") this.showAll();
    else return;
    event.preventDefault();
  }

  /** Move the cursor along its curve by points, or to another curve; start at the first point. */
  moveCursor(pointStep, curveStep) {
    const curves = this.getCurves();
    if (!curves.length) return;
    const cursor = this.cursor ?? { curve: 0, point: 0 }; // indices
    if (this.cursor && curveStep) {
      const x = curves[cursor.curve % curves.length].xs[cursor.point];
      cursor.curve = (cursor.curve + curveStep + curves.length) % curves.length;
      const { xs } = curves[cursor.curve];
      cursor.point = xs.reduce((nearest, pointX, i) => Math.abs(pointX - x) < Math.abs(xs[nearest] - x) ? i : nearest, 0);
    }
    cursor.curve %= curves.length;
    const curve = curves[cursor.curve];
    if (this.cursor) cursor.point += pointStep;
    if (Number.isNaN(curve.xs[cursor.point])) cursor.point += pointStep; // a gap between two segments
    cursor.point = Math.min(curve.xs.length - 1, Math.max(0, cursor.point));
    this.cursor = cursor;
    const position = { x: curve.xs[cursor.point], y: curve.ys[cursor.point] };
    this.moveViewTo(position);
    this.showPoint({ curve, ...position });
  }

  /** Centre the view at a position that is outside the view. */
  moveViewTo(position) {
    const { x, y, w, h } = this.view;
    if (isBetween(position.x, x, w) && isBetween(position.y, y, h)) return;
    this.showView({ x: position.x - w / 2, y: position.y - h / 2, w, h });
  }

  getCursorPosition() {
    if (!this.cursor) return null;
    const curve = this.getCurves()[this.cursor.curve];
    return curve ? { x: curve.xs[this.cursor.point], y: curve.ys[this.cursor.point] } : null;
  }
}
