// The reader's own data: two tables, solved in the page. Nothing is sent anywhere.
import { Controls, Stage, fill, html } from "./stage.js";
import { TableError, logOf, readTable } from "./tables.js";

const ROLES = { odometry: ["t", "nu", "omega"], sightings: ["t", "id", "range", "bearing", "orientation?"] };

export function make(figure, engine, data, words) {
  const state = { tables: {}, kernel: true, log: null, found: null }, inputs = {}, names = {};
  const area = html("div", { class: "live-files" }, figure);
  for (const kind of Object.keys(ROLES)) {
    // the button of a file input is in the browser's language, so that a label of the page's stands for it
    const row = html("div", {}, area), label = html("label", { class: "md-button" }, row);
    label.append(words[kind]);
    inputs[kind] = html("input", { type: "file", accept: ".csv,.tsv,.txt,text/csv", "data-name": kind }, label);
    inputs[kind].addEventListener("change", () => take([...inputs[kind].files], kind));
    names[kind] = html("output", {}, row);
  }
  html("p", { class: "live-legend" }, area).textContent = words.dropHere;
  area.addEventListener("dragover", (event) => event.preventDefault());
  area.addEventListener("drop", (event) => { event.preventDefault(); take([...event.dataTransfer.files]); });
  const controls = new Controls(figure);
  controls.button("example", words.example, async () => {
    for (const kind of Object.keys(ROLES)) {
      const url = new URL(`../../examples/${kind}.csv`, import.meta.url);
      state.tables[kind] = { name: `${kind}.csv`, text: await (await fetch(url)).text() };
    }
    solve();
  });
  controls.toggle("kernel", words.kernel, true, (on) => { state.kernel = on; solve(); });
  const status = html("p", { class: "live-status", role: "status" }, figure);
  const stage = new Stage(figure, words.ownLabel, draw);
  stage.svg.style.display = "none";
  ["raw", "line", "marks"].forEach((name) => stage.layer(name));
  const legend = html("p", { class: "live-legend" }, figure);

  /** Files by where they were dropped, else by their columns: only sightings have a bearing. */
  async function take(files, kind = null) {
    for (const file of files) {
      const text = await file.text(), chosen = kind ?? (/bearing|azimuth|phi|range|dist/i.test(text.split("\n")[0]) ? "sightings" : "odometry");
      state.tables[chosen] = { name: file.name, text };
    }
    solve();
  }
  function solve() {
    const { odometry, sightings } = state.tables;
    for (const [kind, table] of Object.entries(state.tables)) names[kind].textContent = table.name;
    if (!odometry || !sightings) {
      status.textContent = odometry ? words.needSightings : sightings ? words.needOdometry : "";
      return;
    }
    try {
      const [u, z] = Object.entries(ROLES).map(([kind, roles]) =>
        readTable(state.tables[kind].name, state.tables[kind].text, roles, data, words));
      const log = logOf(u, z, sightings.name, words);
      const began = performance.now(), plain = engine.graph(log), raw = plain.deadReckoning();
      let found = plain.solve(raw), J = plain.costs(found.poses).J, map = plain.map(found.poses);
      plain.free();
      if (state.kernel) {
        // a robust cost has more minima, so that it begins at that of the squares
        const robust = engine.graph({ ...log, kernel: "cauchy", width: data.widths[+log.oriented] });
        found = robust.solve(found.poses);
        J = robust.costs(found.poses).J, map = robust.map(found.poses);
        robust.free();
      }
      const seconds = (performance.now() - began) / 1000;
      Object.assign(state, { log, found: { ...found, raw, J, map } });
      status.innerHTML = `<strong>J = ${J.toFixed(3)}</strong> <span></span>`;
      status.lastChild.textContent = words.report(found.poses.length, map.length, log.sightings.length, log.left, seconds)
        + (found.converged ? "" : ` ${words.ownNotConverged}`);
      legend.textContent = words.ownLegend;
      stage.svg.style.display = "";
      stage.show([...raw, ...found.poses, ...map], 0.5);
    } catch (error) {
      if (!(error instanceof TableError)) throw error;
      status.textContent = error.message;
      state.found = null;
      stage.svg.style.display = "none";
      legend.textContent = "";
    }
  }
  function draw() {
    if (!stage.size || !state.found) return;
    const { poses, raw, map } = state.found;
    fill(stage, "raw", [stage.path(raw)], (d) => ({ d, class: "true-path" }));
    fill(stage, "line", [stage.path(poses)], (d) => ({ d, class: "chosen-path" }));
    fill(stage, "marks", map.map((m) => stage.at(m)), ([x, y]) => ({ d: `M${x - 5} ${y}h10m-5 -5v10`, class: "true-landmark" }));
  }
  return { state, solve, take };
}
