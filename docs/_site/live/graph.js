// The graph of a log to be moved by hand: poses, landmarks, edges coloured by their Mahalanobis distance, and J.
//
// Dragging a pose changes the estimate. Dragging a landmark changes the measurements: its sightings are measured anew from the
// poses of the minimum, with the errors that they had.
import { Controls, Stage, draggable, element, fill, html, place } from "./stage.js";

/** Colours of edges are as many steps up to this distance. */
const COLOURS = 8, REDDEST = 4;
/** What a wrong sighting is off by: range [m], bearing [rad], psi. */
const WRONG = [1.5, 0.8, 0];
/** How far an arrow key moves [m] and turns [rad]; length of the arrow of a pose [pixels]. */
const NUDGE = 0.05, TURN = 0.05, ARROW = 24;

export function make(figure, engine, log, words) {
  const given = figure.dataset, on = (name, otherwise) => (given[name] === undefined ? otherwise : given[name] === "yes");
  const state = {
    sightings: log.sightings.map((row) => [...row]), poses: [],
    oriented: on("psi", true), motions: on("motions", true), wrong: on("wrong", false), kernel: on("kernel", false),
    ellipses: on("ellipses", false), anchor: on("anchor", true), world: on("world", false), marginal: on("marginal", false),
    certificate: on("certificate", false),
  };
  const pairs = pairsOf(log.sightings), mistaken = Number(given.mistaken ?? log.sightings.length - 1);
  const stage = new Stage(figure, words.graphLabel, draw);
  ["rays", "edges", "ellipses", "places", "handles"].forEach((name) => stage.layer(name));
  let graph = null, message = "";

  function measured() {
    return state.sightings.map((row, k) =>
      state.wrong && k === mistaken ? row.map((number, c) => number + (c < 2 ? 0 : WRONG[c - 2])) : row);
  }
  function build() {
    graph?.free();
    const kernel = state.kernel ? { kernel: "cauchy", width: log.widths[state.oriented ? 1 : 0] } : {};
    graph = engine.graph({ ...log, sightings: measured(), pairs, oriented: state.oriented, motions: state.motions, ...kernel,
                           frame: state.world ? "world" : "body", weight: state.marginal ? "marginal" : "pairs" });
  }

  // the minimum with everything measured is where the landmarks stand
  const whole = engine.graph({ ...log, pairs });
  const solved = whole.solve(whole.deadReckoning()).poses, names = whole.landmarks;
  const landmarks = whole.map(solved);
  whole.free();
  build();
  state.poses = graph.deadReckoning();

  function moveLandmark(k, x, y) {
    const before = [...landmarks[k]];
    landmarks[k][0] = x, landmarks[k][1] = y;
    for (const row of state.sightings) {
      if (row[1] !== names[k]) continue;
      const [old, fresh] = [before, landmarks[k]].map((m) => engine.sight(solved[row[0]], m));
      for (let c = 0; c < 3; ++c) row[2 + c] += fresh[c] - old[c];
      row[2] = Math.max(row[2], 0.05);
    }
    build();
    draw();
  }
  /** The poses; without the anchor all of them moved together, so that the first one is where the anchor would hold it. */
  function inAnchor() {
    return state.anchor ? state.poses : state.poses.map((pose) => carried(pose, state.poses[0], log.start));
  }
  function solve(most) {
    // without the anchor nothing changes if all poses move together: the first one is held where it is
    const held = state.poses[0], end = graph.solve(inAnchor(), most);
    if (end.poses.every((pose) => pose.every(Number.isFinite)))
      state.poses = state.anchor ? end.poses : end.poses.map((pose) => carried(pose, log.start, held));
    message = !end.determined ? words.free
      : `${most === 1 ? "" : words.steps(end.steps) + words.comma}${words.norm}: ${end.norm.toPrecision(2)}`
        + (most > 1 && !end.converged ? words.comma + words.notConverged : "") + (state.anchor ? "" : words.stop + words.noAnchor);
    draw();
    // not while something is dragged: it would move away from under the finger
    stage.keep(state.poses);
  }
  function change(name, value) {
    state[name] = value;
    message = "";
    build();
    draw();
  }

  const controls = new Controls(figure, given.controls?.split(" ") ?? null);
  controls.button("step", words.step, () => solve(1));
  controls.button("all", words.all, () => solve(100));
  controls.button("reset", words.reset, () => { state.poses = graph.deadReckoning(); message = ""; draw(); stage.keep(state.poses); });
  for (const [name, key] of [["psi", "oriented"], ["motions", "motions"], ["wrong", "wrong"], ["kernel", "kernel"], ["anchor", "anchor"],
    ["marginal", "marginal"], ["world", "world"], ["ellipses", "ellipses"], ["certificate", "certificate"]])
    controls.toggle(name, words[name], state[key], (value) => change(key, value));
  const status = html("p", { class: "live-status", role: "status" }, figure);
  const legend = html("p", { class: "live-legend" }, figure);
  legend.innerHTML = `${words.distance} ${[0, 1, 2, 3, 4].map((d) => `<span class="edge" style="--part:${100 * d / REDDEST}%">${d}</span>`).join(" ")} ${words.more} ${words.legend} ${words.drag}`;

  // handles are made once, so that a drag and the focus survive a redraw
  const handles = {
    landmarks: landmarks.map((_, k) => {
      const star = element("g", { role: "img" }, stage.layer("handles"));
      element("circle", { r: 16, class: "touch" }, star);
      element("path", { d: starPath(9), class: "landmark" }, star);
      draggable(star, stage, ([x, y]) => moveLandmark(k, x, y),
                (dx, dy) => moveLandmark(k, landmarks[k][0] + NUDGE * dx, landmarks[k][1] + NUDGE * dy));
      return star;
    }),
    poses: state.poses.map((_, t) => {
      const node = element("g", { role: "img" }, stage.layer("handles"));
      const tip = element("circle", { r: 11, class: "touch" }, node);
      element("circle", { r: 13, class: "touch" }, node);
      element("path", { class: "heading", d: `M0 0H${ARROW}m-6 -4l6 4l-6 4` }, node);
      element("circle", { r: 6, class: "pose" }, node);
      draggable(node, stage, (point) => { state.poses[t] = [...point, state.poses[t][2]]; draw(); }, (dx, dy, turn) => {
        const [x, y, heading] = state.poses[t];
        state.poses[t] = [x + NUDGE * dx, y + NUDGE * dy, heading + TURN * turn];
        draw();
      });
      tip.setAttribute("cx", ARROW);
      tip.addEventListener("pointerdown", (event) => { event.preventDefault(); event.stopPropagation(); tip.setPointerCapture(event.pointerId); });
      tip.addEventListener("pointermove", (event) => {
        if (!tip.hasPointerCapture(event.pointerId)) return;
        event.stopPropagation();
        const [x, y] = stage.point(event), pose = state.poses[t];
        pose[2] = Math.atan2(y - pose[1], x - pose[0]);
        draw();
      });
      return node;
    }),
  };

  function draw() {
    if (!graph || !stage.size || !handles) return;
    const { J: whole, squares } = graph.costs(state.poses), sightings = measured();
    const J = state.anchor ? whole : whole - squares[0];
    const places = sightings.map((row) => engine.place(state.poses[row[0]], row.slice(2)).landmark);
    const motions = state.motions ? log.controls.map((_, t) => stage.path([state.poses[t], state.poses[t + 1]])) : [];
    const means = state.marginal ? graph.map(state.poses) : [], meanOf = (row) => means[names.indexOf(row[1])];
    const rayOf = (row, at) => stage.path([state.poses[row[0]], at]);
    const edges = state.marginal ? [...motions, ...names.map((name, k) =>
      sightings.filter((row) => row[1] === name).map((row) => rayOf(row, means[k])).join(""))] : [...motions, ...pairs.map(([a, b]) => {
      const [p, q] = [a, b].map((k) => state.poses[sightings[k][0]]), at = places[a];
      // bent towards the landmark, so that the edges of different landmarks differ
      return stage.curve(p, [0, 1].map((c) => 0.65 * (p[c] + q[c]) / 2 + 0.35 * at[c]), q);
    })];
    const buckets = Array.from({ length: COLOURS + 1 }, () => "");
    edges.forEach((path, e) => {
      const distance = Math.sqrt(squares[e + 1]);  // the first one is the anchor
      buckets[Math.round(COLOURS * Math.min(distance / REDDEST, 1))] += path;
    });
    fill(stage, "edges", buckets, (path, k) => ({ d: path, class: "edge", style: `--part:${100 * k / COLOURS}%` }));
    const residuals = state.marginal ? sightings.map((row, k) => stage.path([places[k], meanOf(row)])).join("")
      : pairs.map(([a, b]) => stage.path([places[a], places[b]])).join("");
    const rays = sightings.map((row, k) => rayOf(row, places[k])).join("");
    fill(stage, "rays", [rays, residuals], (path, k) => ({ d: path, class: k ? "residual" : "ray" }));
    fill(stage, "places", places.map((at) => stage.at(at)), ([x, y]) => ({ d: `M${x} ${y}h.01`, class: "place" }));
    const blocks = state.ellipses && state.anchor ? graph.covariances(state.poses) : null;
    fill(stage, "ellipses", blocks ?? [], (C, t) => ({ d: stage.ellipse(state.poses[t], [C[0], C[1], C[4]]), class: "ellipse" }));

    landmarks.forEach((m, k) => place(stage, handles.landmarks[k], m, 0, `${words.landmark} ${names[k]}`, words.moveLandmark));
    state.poses.forEach((x, t) => place(stage, handles.poses[t], x, x[2], `${words.pose} ${t}`, words.move));
    status.innerHTML = `<strong>J = ${J < 1e4 ? J.toFixed(3) : J.toExponential(3)}</strong> <span></span>`;
    const proof = state.certificate ? graph.proof(inAnchor()) : null;
    status.lastChild.textContent = [message, state.ellipses && !blocks ? words.ellipsesFree : "", proof ? words.proofs[proof.status](proof.gap) : ""]
      .filter((sentence) => sentence).join(" ");
    if (proof) figure.dataset.proof = proof.status;
    figure.dataset.cost = J;
  }
  const drawn = log.sightings.map((row) => engine.place(state.poses[row[0]], row.slice(2)).landmark);
  stage.show([...state.poses, ...solved, ...landmarks, ...drawn], 0.4);
  return { state, landmarks, solve, change, draw, costs: () => graph.costs(state.poses), log: () => ({ ...log, sightings: measured() }) };
}

/** A pose that has been carried along as `from` is carried to `to`. */
function carried([x, y, heading], from, to) {
  const turn = to[2] - from[2], c = Math.cos(turn), s = Math.sin(turn), dx = x - from[0], dy = y - from[1];
  return [to[0] + c * dx - s * dy, to[1] + s * dx + c * dy, heading + turn];
}

/** All pairs of sightings of one landmark, by their numbers. */
function pairsOf(sightings) {
  const pairs = [];
  sightings.forEach((b, k) => sightings.slice(0, k).forEach((a, i) => {
    if (a[1] === b[1] && a[0] !== b[0]) pairs.push(a[0] < b[0] ? [i, k] : [k, i]);
  }));
  return pairs;
}

const starPath = (r) => Array.from({ length: 10 }, (_, k) => {
  const angle = k * Math.PI / 5 - Math.PI / 2, length = k % 2 ? r * 0.45 : r;
  return `${k ? "L" : "M"}${(length * Math.cos(angle)).toFixed(1)} ${(length * Math.sin(angle)).toFixed(1)}`;
}).join("") + "Z";
