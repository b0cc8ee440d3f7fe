// FastSLAM on a simulated drive: the particles, the ancestors of each, and the map of the one that is chosen.
import { Controls, Stage, element, fill, html } from "./stage.js";

const NUMBERS = [1, 5, 10, 20, 50, 100, 200, 500, 1000], FACTORS = [0.25, 0.5, 1, 2, 4];
/** Groups of weights that are drawn in sizes of their own; trajectories shown at most; time of a step in a run [ms]. */
const SIZES = 5, SHOWN = 100, PERIOD = 150;
/** What the book's camera sees: ranges [m], bearings to both sides [rad]. A kidnapped robot is turned about the landmarks by so much. */
const NEAR = 0.5, FAR = 6, ASIDE = Math.PI / 3, CARRIED = 2 * Math.PI / 3;

const deviation = ([xx, xy, yy]) => Math.sqrt((xx + yy) / 2 + Math.hypot((xx - yy) / 2, xy));

export function make(figure, engine, log, words, book) {
  const given = figure.dataset, wanted = given.controls?.split(" ") ?? null;
  const state = {
    particles: Number(given.particles ?? 100), version: Number(given.version ?? 1), noise: Number(given.noise ?? 1),
    resampling: given.resampling !== "no", weighted: given.weights !== "no", chosen: null, t: -1, ess: null, moved: false,
  };
  // a test replaces these
  const random = {
    key: () => BigInt(Math.floor(Math.random() * 2 ** 53)) << 11n, offset: Math.random,
    normal: () => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random()),
  };
  const recorded = [...log.controls, 0].map(() => []);
  for (const [step, ...sighting] of log.sightings) recorded[step].push(sighting);
  let seen = recorded, truth = log.truth;
  const names = [...new Set(log.sightings.map((row) => row[1]))];
  const stage = new Stage(figure, words.fastslamLabel, draw);
  ["truth", "paths", "ellipses", "particles", "chosen"].forEach((name) => stage.layer(name));
  let slam = null, history = [], timer = null;

  function restart() {
    slam?.free();
    const motion = ["nn", "no", "on", "oo"].map((name) => [name, book[name] * state.noise]);
    slam = engine.fastslam({ start: log.start, particles: state.particles, version: state.version, noise: Object.fromEntries(motion) });
    [history, seen, truth] = [[], recorded, log.truth];
    Object.assign(state, { t: -1, ess: null, chosen: null, resampled: false, resamplings: 0, kidnapped: false, moved: false });
    step();
  }
  /** Move all particles. Returns false at the end of the drive. */
  function move() {
    if (state.t + 1 >= seen.length) return false;
    ++state.t;
    if (state.resampled) state.ess = state.particles; // all weights are equal since
    if (state.t > 0) slam.move(log.controls[state.t - 1], random.key());
    history.push({ ...slam.particles(), ancestors: null });
    Object.assign(state, { moved: true, resampled: false });
    return true;
  }
  /** Weigh and, if the effective sample size is at most half of N, resample. */
  function observe() {
    const ess = seen[state.t].length ? slam.weigh(seen[state.t]) : -1;
    if (ess >= 0) state.ess = ess;
    state.resampled = state.resampling && state.weighted && ess >= 0 && ess <= state.particles / 2;
    const ancestors = state.resampled ? slam.resample(random.offset()) : null;
    history[state.t] = { ...slam.particles(), ancestors };
    state.moved = false;
    if (ancestors) [state.chosen, state.resamplings] = [null, state.resamplings + 1];
  }
  /** The step to the next pose, or what is left of it. Returns false at the end of the drive. */
  function step() {
    if (!state.moved && !move()) return false;
    observe();
    draw();
    keep();
    return true;
  }
  /** The motion of a step, and its sightings when it is called again. */
  function half() {
    if (state.moved) observe();
    else move();
    draw();
    keep();
  }
  /** The robot and the particle that is drawn stay in view. */
  function keep() { stage.keep([truth[state.t], history.at(-1).poses[chosen()]]); }
  /** Carry the robot to another place: from now on it drives there by the same controls, and the sightings are measured anew. */
  function kidnap() {
    if (state.kidnapped || state.t + 1 >= seen.length) return;
    state.kidnapped = true;
    const [u, v] = [0, 1].map((c) => log.landmarks.reduce((sum, m) => sum + m[c], 0) / log.landmarks.length);
    const cosine = Math.cos(CARRIED), sine = Math.sin(CARRIED);
    truth = truth.map(([x, y, heading], t) => (t <= state.t ? [x, y, heading]
      : [u + cosine * (x - u) - sine * (y - v), v + sine * (x - u) + cosine * (y - v), heading + CARRIED]));
    seen = recorded.map((rows, t) => (t <= state.t ? rows : log.landmarks.flatMap(([x, y, heading, name]) => {
      const [range, bearing, psi] = engine.sight(truth[t], [x, y, heading]);
      if (range < NEAR || range > FAR || Math.abs(bearing) > ASIDE) return [];
      return [[name, range * (1 + book.range_rate * random.normal()), bearing + book.bearing_std * random.normal(),
               psi + book.orientation_std * random.normal()]];
    })));
    draw();
  }
  /** The poses of a particle from now back to the start. */
  function trajectory(i) {
    const poses = [];
    for (let t = history.length - 1; t >= 0; --t) {
      poses.push(history[t].poses[i]);
      if (history[t].ancestors) i = history[t].ancestors[i];
    }
    return poses;
  }
  function run() {
    if (timer) return stop();
    if (state.t + 1 >= seen.length) restart();
    timer = setInterval(() => { if (!step() || !figure.isConnected) stop(); }, PERIOD);
    if (button) button.textContent = words.pause;
  }
  function stop() {
    clearInterval(timer);
    timer = null;
    if (button) button.textContent = words.run;
  }
  const change = (name) => (value) => { state[name] = value; restart(); };
  const controls = new Controls(figure, wanted);
  const next = controls.button("half", "", () => { stop(); half(); });
  controls.button("step", words.oneStep, () => { stop(); step(); });
  const button = controls.button("run", words.run, run);
  controls.button("restart", words.restart, () => { stop(); restart(); });
  controls.button("other", words.other, () => choose((chosen() + 1) % state.particles));
  controls.button("kidnap", words.kidnap, kidnap);
  controls.toggle("version", "FastSLAM 2.0", state.version === 2, (on) => change("version")(on ? 2 : 1));
  controls.toggle("weights", words.weights, state.weighted, change("weighted"));
  controls.toggle("resampling", words.resampling, state.resampling, change("resampling"));
  controls.slider("particles", "N =", NUMBERS, state.particles, change("particles"));
  controls.slider("noise", words.motionNoise, FACTORS, state.noise, change("noise"));
  const status = html("p", { class: "live-status", role: "status" }, figure);
  html("p", { class: "live-legend" }, figure).textContent = words.fastslamLegend(state.weighted);

  // without weights the first particle is as good as any other
  const chosen = () => state.chosen ?? (state.weighted ? slam.best : 0);
  function choose(i) { state.chosen = i; draw(); }
  stage.svg.addEventListener("click", (event) => {
    const [x, y] = stage.point(event), squares = history.at(-1).poses.map((p) => (p[0] - x) ** 2 + (p[1] - y) ** 2);
    choose(squares.indexOf(Math.min(...squares)));
  });

  function draw() {
    if (!stage.size || !history.length) return;
    const { poses, logWeights } = history.at(-1), most = Math.max(...logWeights), i = chosen();
    const stars = log.landmarks.map((m) => stage.at(m));
    const until = state.kidnapped ? truth.findIndex((pose, t) => pose !== log.truth[t] && pose[2] !== log.truth[t][2]) : truth.length;
    fill(stage, "truth", [stage.path(truth.slice(0, until)) + (until < truth.length ? stage.path(truth.slice(until)) : ""), ...stars.map(([x, y]) => `M${x - 5} ${y}h10m-5 -5v10`)], (d, k) =>
      ({ d, class: k ? "true-landmark" : "true-path" }));
    // common ancestors are drawn once
    const every = Math.ceil(state.particles / SHOWN), segments = new Set();
    for (let p = 0; p < state.particles; p += every) {
      for (let t = history.length - 1, at = p; t > 0; --t) {
        const before = history[t].ancestors ? history[t].ancestors[at] : at;
        const key = t * 1024 + at;
        if (segments.has(key)) break;
        segments.add(key);
        at = before;
      }
    }
    const lines = [...segments].map((key) => {
      const t = Math.floor(key / 1024), at = key % 1024, { ancestors } = history[t];
      return stage.path([history[t].poses[at], history[t - 1].poses[ancestors ? ancestors[at] : at]]);
    });
    fill(stage, "paths", [lines.join("")], (d) => ({ d, class: "path" }));
    const sizes = Array.from({ length: SIZES }, () => "");
    poses.forEach((pose, p) => {
      const [x, y] = stage.at(pose), size = Math.ceil((SIZES - 1) * (state.weighted ? Math.exp(logWeights[p] - most) : 0.5));
      sizes[size] += `M${x.toFixed(1)} ${y.toFixed(1)}h.01`;
    });
    fill(stage, "particles", sizes, (d, size) => ({ d, class: "particle", "stroke-width": 2 + 1.5 * size }));
    const map = names.map((name) => slam.landmark(name, i)).filter((m) => m);
    fill(stage, "ellipses", map, (m) => ({ d: stage.ellipse(m, m.slice(2)), class: "ellipse" }));
    const [x, y] = stage.at(poses[i]);
    fill(stage, "chosen", [stage.path(trajectory(i)), `M${x} ${y}h.01`], (d, k) => ({ d, class: k ? "chosen-pose" : "chosen-path" }));
    if (next) next.textContent = state.moved ? words.halfSightings : words.halfMotion;
    status.innerHTML = `<strong>t = ${state.t}</strong>${words.comma}<span></span>`;
    status.lastChild.textContent = (state.weighted || state.particles === 1 ? words.ess(state.ess, state.particles, state.resampled, state.resamplings) : words.unweighted)
      + (state.kidnapped ? words.kidnapped : "") + (given.sizes === "yes" ? words.sizes(sizesNow(i)) : "");
  }
  /** The landmarks that are seen now: name, and the largest standard deviation in the map of a particle, null if it has none yet. */
  function sizesNow(i) {
    return seen[state.t].map(([name]) => {
      const found = slam.landmark(name, i);
      return [name, found && deviation(found.slice(2))];
    });
  }
  restart();
  stage.show([...log.truth, ...log.landmarks], 0.8);
  return { state, random, step, half, restart, change, choose, kidnap, names, particles: () => slam.particles(), sizes: () => sizesNow(chosen()),
           map: (particle) => names.map((name) => slam.landmark(name, particle)), truth: () => truth[state.t], trajectory,
           landmarks: log.landmarks };
}
