// The engine in a web page or in Node: graph SLAM of a log, step by step, and FastSLAM.
//
//   const engine = await load(await (await fetch("vmslam.wasm")).arrayBuffer());
//   const { poses } = engine.solve({ start: [0, 0, 0], controls: [[1, 0, 1]], sightings: [[0, 7, 2.5, 0.1], [1, 7, 1.5, 0.2]] });
//
// controls: [nu, omega, dt]; sightings: [landmark, range, bearing, orientation], in logs with the step in front. Without
// orientations, give `oriented: false` and leave the last number out.

/** The noise models of the book; see `Log` in include/vmslam/log.hpp. */
export const BOOK = { nn: 0.19, no: 0.001, on: 0.13, oo: 0.2, epsilon: 1e-4, range_rate: 0.14, bearing_std: 0.05, orientation_std: 0.05 };

/** Instantiate the module. A reactor of WASI asks for an output, which has no place here. */
export async function load(bytes) {
  const module = await WebAssembly.compile(bytes);
  const imports = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module)) {
    (imports[from] ??= {})[name] = name === "proc_exit" ? () => { throw new Error("the engine has ended"); } : () => 0;
  }
  const { exports } = await WebAssembly.instantiate(module, imports);
  exports._initialize();
  return new Engine(exports);
}

class Engine {
  constructor(exports) { this.exports = exports; }

  /** Call work with places of arrays of numbers in the memory of the module, which are freed afterwards. */
  with(arrays, work) {
    const places = arrays.map((numbers) => this.exports.vm_allocate(Math.max(1, numbers.length)));
    try {
      if (places.includes(0)) throw new RangeError("there is no memory left for these numbers");
      arrays.forEach((numbers, k) => this.view(places[k], numbers.length).set(numbers));
      return work(...places);
    } finally {
      places.forEach((place) => this.exports.vm_free(place));
    }
  }
  /** The numbers at a place, until the module next takes memory. */
  view(place, length) { return new Float64Array(this.exports.memory.buffer, place, length); }

  /** The poses [x, y, heading] of the graph of a log, J, the number of steps, and whether they converged. */
  solve(log) {
    const graph = this.graph(log);
    try {
      const { poses, steps, converged } = graph.solve(graph.deadReckoning());
      return { poses, steps, converged, cost: graph.costs(poses).J };
    } finally { graph.free(); }
  }
  /** Where a sighting [range, bearing, orientation] places its landmark, h^-1(x, z), and its covariance R Q R' as
   *  [xx, xy, yy, xt, yt, tt]. `noiseRange`: the range at which Q is taken, if it is not that of the sighting. */
  place(pose, sighting, { noise = {}, noiseRange = sighting[0] } = {}) {
    return this.with([pose, sighting, numbersOf(noise), new Array(9).fill(0)], (x, z, n, out) => {
      this.exports.vm_place(x, z, n, noiseRange, out);
      const numbers = [...this.view(out, 9)];
      return { landmark: numbers.slice(0, 3), covariance: numbers.slice(3) };
    });
  }
  /** The sighting [range, bearing, orientation] of a landmark [x, y, heading] from a pose, without noise. */
  sight(pose, landmark) {
    return this.with([pose, landmark, [0, 0, 0]], (x, m, z) => {
      this.exports.vm_sight(x, m, z);
      return [...this.view(z, 3)];
    });
  }
  graph(log) { return new Graph(this, log); }
  online(options) { return new Online(this, options); }
  fastslam(options) { return new FastSlam(this, options); }
}

/**
 * The graph of a log. With `pairs`, a list of [sighting, sighting] of one landmark by their numbers in the log, the step of the
 * first one before that of the second, each pair is a virtual-motion edge, and motion edges are added if `motions` is true.
 * With `weight: "marginal"` each landmark is one edge instead. `frame`: "body", the landmark's axes, or "world". Without `pairs`
 * each sighting counts once. Motions may consist of several controls: `starts` has the first control of each, and
 * in the end the number of all controls. `kernel`: "none", "huber", "cauchy" or "geman-mcclure", with its width.
 */
class Graph {
  constructor(engine, log) {
    const { start, controls, sightings, oriented = true, noise = {}, pairs, motions = true, kernel = "none", width = 1, weight = "pairs",
            frame = "body" } = log;
    const starts = log.starts ?? [...controls.keys(), controls.length];
    this.engine = engine;
    this.size = starts.length;
    this.landmarks = [...new Set(sightings.map((row) => row[1]))].sort((a, b) => a - b);
    const marginal = weight === "marginal", seen = marginal ? this.landmarks : pairs;
    this.members = pairs ? 1 + motions * (starts.length - 1) + seen.length : 3;
    this.weighted = kernel !== "none";
    const options = [+oriented, +motions, ["none", "huber", "cauchy", "geman-mcclure"].indexOf(kernel), width, +(frame === "body"), +marginal];
    if (options[2] < 0) throw new Error(`there is no kernel "${kernel}"`);
    const rows = [start, controls.flat(), starts, flat(sightings, 5), numbersOf(noise), options, (pairs ?? []).flat()];
    this.own = engine.with(rows, (x, u, s, z, n, o, p) =>
      engine.exports.vm_graph(x, u, s, starts.length, z, sightings.length, n, o, p, pairs ? pairs.length : -1));
  }
  /** The poses that follow from the controls alone. */
  deadReckoning() {
    return this.engine.with([new Array(3 * this.size).fill(0)], (out) => {
      this.engine.exports.vm_graph_dead_reckoning(this.own, out);
      return triples(this.engine.view(out, 3 * this.size));
    });
  }
  /** J at poses, and e' Omega e without the kernel of the anchor, the motion edges and the pairs, in this order. */
  costs(poses) {
    const zeros = new Array(this.members).fill(0);
    return this.engine.with([poses.flat(), zeros, zeros], (x, costs, squares) => {
      const count = this.engine.exports.vm_graph_costs(this.own, x, costs, squares);
      const J = this.engine.view(costs, count).reduce((sum, cost) => sum + cost, 0);
      return { J, squares: [...this.engine.view(squares, count)] };
    });
  }
  /** At most so many Gauss-Newton steps from poses. `determined` is false where the edges leave a pose free. */
  solve(poses, mostSteps = 100) {
    return this.engine.with([poses.flat(), [0, 0]], (x, out) => {
      const end = this.engine.exports.vm_graph_solve(this.own, x, mostSteps, out);
      const [norm, steps] = this.engine.view(out, 2);
      return { poses: triples(this.engine.view(x, 3 * this.size)), norm, steps, converged: end === 1, determined: end !== 2 };
    });
  }
  /** What is proven of poses: `status` "global" (no poses have a lower J), "global for its weights" (the same of the cost with the
   *  weights of the kernel held), "not proven" or "not applicable", and the relative `gap` to a lower bound on all costs. */
  proof(poses) {
    return this.engine.with([poses.flat(), [0, 0, 0]], (x, out) => {
      if (!this.engine.exports.vm_graph_proof(this.own, x, out)) return { status: "not applicable", gap: NaN };
      const [bound, J, global] = this.engine.view(out, 3), gap = J > 0 && !(global && bound === 0) ? (J - bound) / J : 0;
      return { status: !global ? "not proven" : this.weighted ? "global for its weights" : "global", gap };
    });
  }
  /** The covariance of each pose, by rows, at poses; null where the edges leave a pose free. */
  covariances(poses) {
    return this.engine.with([poses.flat(), new Array(9 * this.size).fill(0)], (x, out) => {
      if (!this.engine.exports.vm_graph_covariances(this.own, x, out)) return null;
      const numbers = [...this.engine.view(out, 9 * this.size)];
      return poses.map((_, k) => numbers.slice(9 * k, 9 * k + 9));
    });
  }
  /** The most probable landmarks [x, y, heading] for poses, in the order of `landmarks`. */
  map(poses) {
    return this.engine.with([poses.flat(), new Array(3 * this.landmarks.length).fill(0)], (x, out) => {
      this.engine.exports.vm_graph_map(this.own, x, out);
      return triples(this.engine.view(out, 3 * this.landmarks.length));
    });
  }
  free() { this.engine.exports.vm_graph_free(this.own); }
}

/** Graph SLAM while the robot drives. */
class Online {
  constructor(engine, { start = [0, 0, 0], oriented = true, noise = {} } = {}) {
    this.engine = engine;
    this.own = engine.with([start, numbersOf(noise)], (x, n) => engine.exports.vm_online(x, n, +oriented));
  }
  /** A motion (null: none), then sightings from the new pose; returns that pose. */
  step(control, sightings = []) {
    const { exports } = this.engine;
    return this.engine.with([control ?? [], flat(sightings, 4), [0, 0, 0]], (u, z, out) => {
      if (!exports.vm_online_step(this.own, control ? u : 0, z, sightings.length)) {
        throw new Error("the step leaves a pose or landmark undetermined, so that it was not taken");
      }
      exports.vm_online_pose(this.own, out);
      return [...this.engine.view(out, 3)];
    });
  }
  /** A landmark [x, y, heading], or null. Without orientations the heading means nothing. */
  landmark(name) {
    return this.engine.with([[0, 0, 0]], (out) =>
      this.engine.exports.vm_online_landmark(this.own, name, out) ? [...this.engine.view(out, 3)] : null);
  }
  free() { this.engine.exports.vm_online_free(this.own); }
}

/** FastSLAM 1.0 and 2.0 with known ids. */
class FastSlam {
  constructor(engine, { start = [0, 0, 0], particles = 100, oriented = true, noise = {}, version = 1 } = {}) {
    this.engine = engine;
    this.count = particles;
    this.version = version - 1;
    this.own = engine.with([start, numbersOf(noise)], (x, n) => engine.exports.vm_fastslam(x, particles, n, +oriented));
  }
  /** Move all particles; `key` is a BigInt from which their random numbers follow. */
  move(control, key) { this.engine.with([control], (u) => this.engine.exports.vm_fastslam_move(this.own, u, key)); }
  /** Weigh by sightings; returns the effective sample size, or -1 if nothing was weighed. */
  weigh(sightings) {
    return this.engine.with([flat(sightings, 4)], (z) =>
      this.engine.exports.vm_fastslam_weigh(this.own, z, sightings.length, this.version));
  }
  /** Systematic resampling from an offset in [0, 1); returns the ancestor of each particle. */
  resample(offset) {
    return this.engine.with([new Float64Array(this.count)], (out) => {
      this.engine.exports.vm_fastslam_resample(this.own, offset, out);
      return [...this.engine.view(out, this.count)];
    });
  }
  /** The number of the particle of the largest weight. */
  get best() { return this.engine.exports.vm_fastslam_best(this.own); }
  /** Poses [x, y, heading] and log weights of all particles. */
  particles() {
    const N = this.count;
    return this.engine.with([new Float64Array(3 * N), new Float64Array(N)], (poses, weights) => {
      this.engine.exports.vm_fastslam_particles(this.own, poses, weights);
      const [x, y, heading] = [0, 1, 2].map((k) => this.engine.view(poses + 8 * N * k, N));
      return { poses: Array.from(x, (_, i) => [x[i], y[i], heading[i]]), logWeights: [...this.engine.view(weights, N)] };
    });
  }
  /** A landmark in the map of a particle, [x, y] and its covariance [xx, xy, yy] in one list, or null. */
  landmark(name, particle = this.best) {
    return this.engine.with([new Array(5).fill(0)], (out) =>
      this.engine.exports.vm_fastslam_landmark(this.own, particle, name, out) ? [...this.engine.view(out, 5)] : null);
  }
  free() { this.engine.exports.vm_fastslam_free(this.own); }
}

/** Rows of a fixed length, one after another; a missing orientation is 0. */
const flat = (rows, length) => rows.flatMap((row) => [...row, 0].slice(0, length));
const triples = (numbers) => Array.from({ length: numbers.length / 3 }, (_, k) => [...numbers.subarray(3 * k, 3 * k + 3)]);

function numbersOf(noise) {
  for (const name of Object.keys(noise)) {
    if (!(name in BOOK)) throw new Error(`there is no noise "${name}"; its names are ${Object.keys(BOOK).join(", ")}`);
  }
  return Object.keys(BOOK).map((name) => noise[name] ?? BOOK[name]);
}
