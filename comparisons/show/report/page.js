"use strict";
// Draws the figures of the page, shows and hides by the check boxes, and moves the robot with the slider.
(async () => {
  const element = (id) => document.getElementById(id);
  const figures = JSON.parse(element("figures").textContent);
  const facts = JSON.parse(element("facts").textContent);
  const column = Object.fromEntries(facts.columns.map((name, k) => [name, k]));
  const CORNERS = 24;
  // a sentence in the language of the page: values in the places {} of its English template
  const say = (template, ...values) => {
    let next = 0;
    return (facts.words[template] ?? template).replace(/\{(\d*)\}/g, (_, k) => values[k === "" ? next++ : Number(k)]);
  };
  const settings = { responsive: true, displaylogo: false, scrollZoom: false,
    modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };

  const chosen = (kind) => new Set(
    [...document.querySelectorAll(`input[data-${kind}]`)].filter((box) => box.checked).map((box) => box.dataset[kind]));
  const layersOfMap = new Set([...document.querySelectorAll("input[data-layer]")].map((box) => box.dataset.layer));

  function isVisible(meta, estimators, layers) {
    if (meta.layer === "matches" && !meta.estimator) return false; // nothing was clicked yet
    return (!meta.estimator || estimators.has(meta.estimator)) && (!layersOfMap.has(meta.layer) || layers.has(meta.layer));
  }

  // the figures in sight are drawn at once, the others when they come near: the page opens sooner
  const drawn = new Set();
  async function draw(id) {
    if (drawn.has(id)) return;
    drawn.add(id);
    await Plotly.newPlot(id, figures[id].data, figures[id].layout, settings);
    element(id).dataset.drawn = "yes";
  }

  function applyToggles() {
    const estimators = chosen("estimator"), layers = chosen("layer");
    for (const [id, { data }] of Object.entries(figures)) {
      const visible = data.map((trace) => isVisible(trace.meta, estimators, layers));
      const changed = data.map((_, k) => k).filter((k) => (data[k].visible !== false) !== visible[k]);
      changed.forEach((k) => { data[k].visible = visible[k]; });
      if (changed.length && drawn.has(id)) Plotly.restyle(id, { visible: changed.map((k) => visible[k]) }, changed);
    }
    for (const row of element("now").tBodies[0].rows) row.hidden = !estimators.has(row.dataset.estimator);
  }

  const paths = {};
  for (const trace of figures.map.data) if (trace.meta.layer === "path" && trace.meta.part !== "line") paths[trace.meta.estimator] = trace;

  // three standard deviations of [[sx², r sx sy], [r sx sy, sy²]], by its Cholesky factor
  function ellipse(x, y, sx, sy, r) {
    const across = Math.sqrt(Math.max(0, 1 - r * r)), points = { x: [], y: [] };
    for (let k = 0; k <= CORNERS; k++) {
      const c = 3 * Math.cos(2 * Math.PI * k / CORNERS), s = 3 * Math.sin(2 * Math.PI * k / CORNERS);
      points.x.push(x + sx * c);
      points.y.push(y + sy * (r * c + across * s));
    }
    return points;
  }

  function robotAt(k) {
    const moved = [], x = [], y = [], angle = [];
    figures.map.data.forEach((trace, index) => {
      if (trace.meta.layer !== "now") return;
      const path = paths[trace.meta.estimator], row = path.customdata[k];
      const px = path.x[k], py = path.y[k], theta = row[column.theta];
      moved.push(index);
      if (trace.meta.part === "pose") {
        x.push([px]); y.push([py]);
        angle.push(theta === null ? 0 : 90 - theta * 180 / Math.PI); // clockwise from upwards
        return;
      }
      const lines = { x: [], y: [] };
      if (px !== null && theta !== null) {
        const c = Math.cos(theta), s = Math.sin(theta);
        for (const [a, b] of facts.sightings[k]) {
          lines.x.push(px, px + c * a - s * b, null);
          lines.y.push(py, py + s * a + c * b, null);
        }
        if (row[column.sigma_x] !== null) {
          const around = ellipse(px, py, row[column.sigma_x], row[column.sigma_y], row[column.rho_xy] ?? 0);
          lines.x.push(...around.x, null); lines.y.push(...around.y, null);
        }
      }
      x.push(lines.x); y.push(lines.y); angle.push(0);
    });
    return { moved, change: { x, y, "marker.angle": angle } };
  }

  // a dash for what is not known, and never a negative zero
  const figure = (value, digits) => value === null ? "–" : value.toFixed(digits).replace(/^-(0\.0*)$/, "$1");

  // the text of hovering over a pose
  function hoverText(name, path, k) {
    const known = path.customdata[k], at = (what) => known[column[what]];
    const lines = [`<b>${name}</b>, ${say("step")} ${at("step")}`];
    if (at("time") !== null) lines.push(`${say("time")} ${figure(at("time"), 2)} s`);
    lines.push(`x ${figure(path.x[k], 3)} m, y ${figure(path.y[k], 3)} m, θ ${figure(at("theta"), 3)} rad`);
    const error = facts.measured_from === "truth" ? say("error") : say("distance from {}", facts.measured_from);
    if (facts.measured_from !== null) lines.push(at("error") === null ? say("{} not known", error) : `${error} ${figure(at("error"), 3)} m`);
    if (at("sigma_x") === null) lines.push(say("covariance not known"));
    else {
      lines.push(`${say("covariance")}: σx ${figure(at("sigma_x"), 4)} m, σy ${figure(at("sigma_y"), 4)} m,`);
      lines.push(`  ρxy ${figure(at("rho_xy"), 2)}, σθ ${figure(at("sigma_theta"), 4)} rad`);
    }
    return lines.join("<br>");
  }
  for (const [name, path] of Object.entries(paths)) path.text = path.x.map((_, k) => hoverText(name, path, k));

  function describe(k) {
    const seen = facts.sightings[k].map(([, , id]) => Number.isSafeInteger(id) ? id : "?");
    const time = facts.times === null ? "" : say(", {} s", facts.times[k].toFixed(2));
    const ids = seen.some((id) => id !== "?") ? `: ${seen.join(", ")}` : "";
    const sightings = seen.length ? say("{} sightings{}", seen.length, ids) : say("no sightings");
    const text = say("step {} of {}{}, {}", facts.steps[k], facts.last, time, sightings);
    element("moment").textContent = text;
    element("moment").title = text;
    element("step").setAttribute("aria-valuetext", text);
    for (const row of element("now").tBodies[0].rows) {
      const path = paths[row.dataset.estimator], known = path.customdata[k];
      const values = [figure(path.x[k], 3), figure(path.y[k], 3), figure(known[column.theta], 3), figure(known[column.error], 3),
        figure(known[column.sigma_x], 4), figure(known[column.sigma_y], 4), figure(known[column.sigma_theta], 4)];
      values.forEach((value, c) => { row.cells[c + 1].textContent = value; });
    }
  }

  function makeRows() {
    for (const name of facts.estimators) {
      const row = element("now").tBodies[0].insertRow();
      row.dataset.estimator = name;
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = name;
      row.append(head);
      for (let c = 0; c < 7; c++) row.insertCell();
    }
  }

  let waiting = null;
  function moveTo(k) {
    element("step").value = k;
    describe(k);
    if (waiting !== null) { waiting = k; return; }
    waiting = k;
    requestAnimationFrame(async () => {
      const at = waiting, { moved, change } = robotAt(at);
      await Plotly.restyle("map", change, moved);
      if (figures.errors) {
        const where = facts.times === null ? facts.steps[at] : facts.times[at];
        await Plotly.relayout("errors", { "shapes[0].x0": where, "shapes[0].x1": where });
      }
      const latest = waiting;
      waiting = null;
      if (latest !== at) moveTo(latest);
    });
  }

  // 3, 4, 5, 9 as "3-5, 9"
  function ranges(steps) {
    const parts = [];
    for (const step of [...new Set(steps)].sort((a, b) => a - b)) {
      const last = parts[parts.length - 1];
      if (last && step === last[1] + 1) last[1] = step; else parts.push([step, step]);
    }
    return parts.map(([a, b]) => a === b ? `${a}` : `${a}–${b}`).join(", ");
  }

  // the sightings of a landmark of an estimator: in words, and as lines from the poses that are shown
  function showMatches(name, id, x, y) {
    const known = facts.matches.associations[facts.matches.of[name]]?.[id];
    if (!known) return;
    const words = [say("{}, landmark {}: {} sightings in steps {}", name, id, known.steps.length, ranges(known.steps))];
    if (known.doubtful.length) words.push(say("uncertain in steps {}", ranges(known.doubtful)));
    if (known.class !== null) words.push(say("class {}", known.class));
    if (known.true !== undefined) {
      words.push(known.true === null ? say("matches no true landmark")
        : say("{} % of them are of the true landmark {}", (100 * known.share).toFixed(1), known.true));
    }
    element("match").textContent = `${words.join("; ")}.`;
    element("match").hidden = false;
    const lines = { x: [], y: [] }, path = paths[name];
    for (const step of known.steps) {
      const k = places.get(step);
      if (k !== undefined && path.x[k] !== null) { lines.x.push(path.x[k], x, null); lines.y.push(path.y[k], y, null); }
    }
    const index = figures.map.data.findIndex((trace) => trace.meta.layer === "matches");
    const trace = figures.map.data[index];
    trace.meta.estimator = name;
    trace.visible = true;
    Plotly.restyle("map", { x: [lines.x], y: [lines.y], visible: true }, [index]);
  }
  const places = new Map(facts.steps.map((step, k) => [step, k]));

  function onClick(event) {
    const point = event.points[0], known = point.customdata;
    const step = Array.isArray(known) ? known[0] : known;
    const kind = point.data.meta.layer;
    if (kind === "landmarks") { showMatches(point.data.meta.estimator, known[0], point.x, point.y); return; }
    const k = facts.steps.indexOf(step);
    if (["path", "error", "truth"].includes(kind) && k >= 0) moveTo(k);
  }

  makeRows();
  applyToggles();
  const start = robotAt(0);
  start.moved.forEach((index, n) => {
    const trace = figures.map.data[index];
    trace.x = start.change.x[n];
    trace.y = start.change.y[n];
    if (trace.meta.part === "pose") trace.marker.angle = start.change["marker.angle"][n];
  });
  describe(0);
  for (const id of ["map", "errors"]) {
    if (!figures[id]) continue;
    await draw(id);
    element(id).on("plotly_click", onClick);
  }
  const nearby = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target.id)),
    { rootMargin: "300px" });
  for (const id of Object.keys(figures)) nearby.observe(element(id));
  window.addEventListener("beforeprint", () => Object.keys(figures).forEach(draw));
  for (const box of document.querySelectorAll("input[type=checkbox]")) box.addEventListener("change", applyToggles);
  const last = facts.steps.length - 1;
  element("step").addEventListener("input", (event) => moveTo(Number(event.target.value)));
  element("back").addEventListener("click", () => moveTo(Math.max(0, Number(element("step").value) - 1)));
  element("forward").addEventListener("click", () => moveTo(Math.min(last, Number(element("step").value) + 1)));
  document.documentElement.dataset.ready = Math.round(performance.now()); // [ms] since the page was asked for
})();
