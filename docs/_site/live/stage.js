// A drawing in metres: SVG in the pixels of the page, handles to drag by mouse, touch and keyboard, buttons and switches.
const SVG = "http://www.w3.org/2000/svg";

/** An element with attributes; names of SVG with a namespace. */
export function element(name, attributes = {}, parent = null, space = SVG) {
  const made = document.createElementNS(space, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}
export const html = (name, attributes = {}, parent = null) => element(name, attributes, parent, "http://www.w3.org/1999/xhtml");

/** A part of the plane, shown as large as the figure allows. */
export class Stage {
  constructor(figure, label, draw) {
    this.svg = element("svg", { class: "live-stage", role: "group", "aria-label": label }, figure);
    this.draw = draw;
    this.layers = {};
    new ResizeObserver(() => this.fit()).observe(figure);
  }
  /** A group of its own for each kind of thing, the first one below. */
  layer(name) { return (this.layers[name] ??= element("g", { class: name }, this.svg)); }

  /** Show these points, with a margin [m]. */
  show(points, margin = 0.5) {
    const [x, y] = [0, 1].map((k) => points.map((p) => p[k]).filter(Number.isFinite));
    this.box = [Math.min(...x) - margin, Math.min(...y) - margin, Math.max(...x) + margin, Math.max(...y) + margin];
    [this.margin, this.first] = [margin, null];
    this.fit();
  }
  /** Show more of the plane, up to three times as much as at first, where some of these points would be outside. */
  keep(points) {
    if (!this.box) return;
    const [x0, y0, x1, y1] = (this.first ??= this.box), most = Math.max(x1 - x0, y1 - y0), before = [...this.box];
    for (const [x, y] of points) {
      if (!(x > x0 - most && x < x1 + most && y > y0 - most && y < y1 + most)) continue;
      this.box = [Math.min(this.box[0], x - this.margin), Math.min(this.box[1], y - this.margin),
                  Math.max(this.box[2], x + this.margin), Math.max(this.box[3], y + this.margin)];
    }
    if (this.box.some((value, k) => value !== before[k])) this.fit();
  }
  fit() {
    const { width } = this.svg.getBoundingClientRect();
    if (!width || !this.box) return;
    const [x0, y0, x1, y1] = this.box, height = Math.min(Math.max(width * (y1 - y0) / (x1 - x0), 200), 460);
    this.scale = Math.min(width / (x1 - x0), height / (y1 - y0));
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.size = [width, height];
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.setAttribute("height", height);
    this.draw();
  }
  /** Pixels of a point, y downwards. */
  at([x, y]) {
    return [this.size[0] / 2 + this.scale * (x - this.centre[0]), this.size[1] / 2 - this.scale * (y - this.centre[1])];
  }
  /** The point of a pointer. */
  point(event) {
    const box = this.svg.getBoundingClientRect();
    return [this.centre[0] + (event.clientX - box.x - this.size[0] / 2) / this.scale,
            this.centre[1] - (event.clientY - box.y - this.size[1] / 2) / this.scale];
  }
  /** A point as a path has it, to a tenth of a pixel. */
  text(point) { const [x, y] = this.at(point); return `${Math.round(10 * x) / 10} ${Math.round(10 * y) / 10}`; }
  path(points) { return points.map((p, k) => `${k ? "L" : "M"}${this.text(p)}`).join(""); }
  /** A curve that bends towards the second point. */
  curve(p, to, q) { return `M${this.text(p)}Q${this.text(to)} ${this.text(q)}`; }
  /** The ellipse of so many standard deviations as two arcs: its half axes are the roots of the eigenvalues of the covariance. */
  ellipse([x, y], [xx, xy, yy], factor = 2) {
    const middle = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy), angle = Math.atan2(2 * xy, xx - yy) / 2;
    const [a, b] = [middle + apart, Math.max(middle - apart, 0)].map((value) => factor * Math.sqrt(value));
    const dx = a * Math.cos(angle), dy = a * Math.sin(angle), round = (length) => Math.round(100 * this.scale * length) / 100;
    const axes = `A${round(a)} ${round(b)} ${Math.round(-10 * angle * 180 / Math.PI) / 10} 1 0 `;
    const [from, to] = [[x + dx, y + dy], [x - dx, y - dy]].map((p) => this.text(p));
    return `M${from}${axes}${to}${axes}${from}Z`;
  }
}

/** Let a handle be dragged, and moved by the arrow keys. `move(point)`; `nudge(dx, dy, turn)` with -1, 0 or 1. */
export function draggable(handle, stage, move, nudge = null) {
  handle.classList.add("handle");
  handle.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    handle.setPointerCapture(event.pointerId);
    handle.focus?.({ preventScroll: true });
  });
  handle.addEventListener("pointermove", (event) => { if (handle.hasPointerCapture(event.pointerId)) move(stage.point(event)); });
  if (!nudge) return;
  handle.setAttribute("tabindex", "0");
  handle.addEventListener("keydown", (event) => {
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!dx && !dy) return;
    event.preventDefault();
    event.shiftKey ? nudge(0, 0, -dx) : nudge(dx, dy, 0);
  });
}

/** Let a layer have one path for each row, with these attributes. */
export function fill(stage, name, rows, attributes) {
  const layer = stage.layer(name);
  while (layer.childElementCount < rows.length) element("path", {}, layer);
  while (layer.childElementCount > rows.length) layer.lastChild.remove();
  let path = layer.firstElementChild;
  rows.forEach((row, k) => {
    for (const [key, value] of Object.entries(attributes(row, k))) path.setAttribute(key, value);
    path = path.nextElementSibling;
  });
}

/** Put a handle at a point, and say what it is and how it is moved. */
export function place(stage, handle, [x, y], heading, name, how) {
  const [px, py] = stage.at([x, y]);
  const turned = `translate(${px.toFixed(1)} ${py.toFixed(1)}) rotate(${(-heading * 180 / Math.PI).toFixed(1)})`;
  // most handles stay where they are while one is dragged
  if (handle.getAttribute("transform") === turned) return;
  handle.setAttribute("transform", turned);
  handle.setAttribute("aria-label", `${name}: ${x.toFixed(2)}, ${y.toFixed(2)}; ${how}`);
}

/** A bar with buttons, switches and sliders, of which only those that `names` has are made; null makes all. */
export class Controls {
  constructor(figure, names = null) {
    this.bar = html("div", { class: "live-controls" }, figure);
    this.names = names;
  }
  wants(name) { return !this.names || this.names.includes(name); }
  button(name, text, act) {
    if (!this.wants(name)) return null;
    const made = html("button", { type: "button", class: "md-button", "data-name": name }, this.bar);
    made.textContent = text;
    made.addEventListener("click", act);
    return made;
  }
  toggle(name, text, on, act) {
    if (!this.wants(name)) return;
    const label = html("label", {}, this.bar), input = html("input", { type: "checkbox", "data-name": name }, label);
    label.append(text);
    input.checked = on;
    input.addEventListener("change", () => act(input.checked));
  }
  /** `values` are the choices, of which the slider has the number. */
  slider(name, text, values, chosen, act) {
    if (!this.wants(name)) return;
    const label = html("label", {}, this.bar), shown = html("span", {}, label);
    const input = html("input", { type: "range", min: 0, max: values.length - 1, step: 1, "data-name": name }, label);
    const show = () => {
      shown.textContent = `${text} ${values[input.value]}`;
      input.setAttribute("aria-valuetext", values[input.value]);
    };
    input.value = values.indexOf(chosen);
    input.addEventListener("input", () => { show(); act(values[input.value]); });
    show();
  }
}
