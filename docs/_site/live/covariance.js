// Two sightings of one landmark with their covariances R Q R', and the covariance of the residual, which is their sum.
import { Controls, Stage, draggable, element, fill, html, place } from "./stage.js";

const NUDGE = 0.05, TURN = 0.05, ARROW = 24;
/** Poses and sightings of the chapter on the information matrix. */
const START = [{ pose: [0, 0, 0], z: [4, 0.5, 0.2] }, { pose: [3, -1, 0.8], z: [2, 0.9, 1.1] }];

export function make(figure, engine, log, words) {
  const seen = START.map(({ pose, z }) => ({ pose: [...pose], z: [...z] })), state = { seen, misprint: false };
  const stage = new Stage(figure, words.covarianceLabel, draw);
  ["rays", "ellipses", "handles"].forEach((name) => stage.layer(name));

  /** h^-1(x, z) and the covariance of each sighting, and their sum; the slide has R_1 where the second term needs R_2. */
  function places() {
    const made = seen.map(({ pose, z }) => engine.place(pose, z));
    if (state.misprint) made[1].covariance = engine.place(seen[0].pose, seen[0].z, { noiseRange: seen[1].z[0] }).covariance;
    return { made, sum: made[0].covariance.map((number, k) => number + made[1].covariance[k]) };
  }
  function moveLandmark(k, x, y) {
    const heading = engine.place(seen[k].pose, seen[k].z).landmark[2];
    seen[k].z = engine.sight(seen[k].pose, [x, y, heading]);
    seen[k].z[0] = Math.max(seen[k].z[0], 0.05);
    draw();
  }
  const controls = new Controls(figure);
  controls.toggle("misprint", words.misprint, false, (on) => { state.misprint = on; draw(); });
  const status = html("p", { class: "live-status", role: "status" }, figure);
  html("p", { class: "live-legend" }, figure).textContent = words.covarianceLegend;

  const handles = seen.map((s, k) => {
    const ends = element("g", { role: "img", class: `sighting-${k + 1}` }, stage.layer("handles"));
    element("circle", { r: 16, class: "touch" }, ends);
    element("circle", { r: 6, class: "end" }, ends);
    draggable(ends, stage, ([x, y]) => moveLandmark(k, x, y), (dx, dy) => {
      const [x, y] = engine.place(s.pose, s.z).landmark;
      moveLandmark(k, x + NUDGE * dx, y + NUDGE * dy);
    });
    const node = element("g", { role: "img", class: `sighting-${k + 1}` }, stage.layer("handles"));
    element("circle", { r: 16, class: "touch" }, node);
    element("path", { class: "heading", d: `M0 0H${ARROW}m-6 -4l6 4l-6 4` }, node);
    element("circle", { r: 6, class: "end" }, node);
    draggable(node, stage, ([x, y]) => { s.pose = [x, y, s.pose[2]]; draw(); }, (dx, dy, turn) => {
      s.pose = [s.pose[0] + NUDGE * dx, s.pose[1] + NUDGE * dy, s.pose[2] + TURN * turn];
      draw();
    });
    return { ends, node };
  });

  function draw() {
    if (!stage.size) return;
    const { made, sum } = places(), [a, b] = made.map(({ landmark }) => landmark);
    fill(stage, "rays", [...seen.map(({ pose }, k) => [pose, made[k].landmark]), [a, b]], (points, k) =>
      ({ d: stage.path(points), class: k < 2 ? "ray" : "residual strong" }));
    const ellipses = made.map(({ landmark, covariance }, k) => [landmark, covariance, `ellipse sighting-${k + 1}`]);
    fill(stage, "ellipses", [...ellipses, [a, sum, "ellipse sum"]], ([mean, C, name]) => ({ d: stage.ellipse(mean, C), class: name }));
    handles.forEach(({ ends, node }, k) => {
      place(stage, ends, made[k].landmark, 0, `${words.landmark} ${k + 1}`, words.move);
      place(stage, node, seen[k].pose, seen[k].pose[2], `${words.pose} ${k + 1}`, words.move);
    });
    const e = [b[0] - a[0], b[1] - a[1]].map((n) => n.toFixed(2)).join(", ");
    status.textContent = `e = (${e}) m, σ_x = ${Math.sqrt(sum[0]).toFixed(3)} m, σ_y = ${Math.sqrt(sum[2]).toFixed(3)} m`;
  }
  stage.show([...seen.map(({ pose }) => pose), ...places().made.map(({ landmark }) => landmark)], 1.2);
  return { state, places, draw };
}
