// Two tables of the reader, odometry and sightings, as a log: columns by their names, units in the names, one pose for each time
// at which something was seen. The names and units are those of graphslam/tables/columns.py, which the page has as data.

/** A file that cannot be read; the message names the file and the line. */
export class TableError extends Error {}

const FACTORS = { s: 1, ms: 1e-3, us: 1e-6, ns: 1e-9, m: 1, cm: 1e-2, mm: 1e-3, radians: 1, degrees: Math.PI / 180 };

/** The column's name in small letters and underscores without its unit, and the unit. */
function plain(title, { units }) {
  let name = title.trim().replace(/^["'#]+|["'#]+$/g, "").trim().toLowerCase(), unit = null;
  const bracket = name.match(/[[(]\s*([^\])]*?)\s*[\])]\s*$/);
  if (bracket) [unit, name] = [units[bracket[1]] ?? null, name.slice(0, bracket.index)];
  let words = name.replace(/%/g, "").split(/[^0-9a-z°]+/).filter((word) => word);
  const last = words.at(-1), before = words.at(-2);
  if (words.length > 1 && !unit && last in units) {
    const two = last === "s" && words.length > 2 && ["m", "mm", "cm", "radians", "degrees"].includes(units[before]);
    unit = units[two ? before : last];
    words = words.slice(0, two ? -2 : -1);
  }
  return { name: words.join("_"), unit };
}

/** The rows of a table as numbers by role, each with its line. Optional roles end in "?"; "id" may be a word. */
export function readTable(file, text, roles, columns, words) {
  const fail = (line, message) => { throw new TableError(`${file}:${line}: ${message}`); };
  const lines = text.replace(/^\uFEFF/, "").split(/\r?\n/).map((line, k) => [k + 1, line]).filter(([, line]) => line.trim());
  if (lines.length < 2) fail(1, words.noRows);
  const separator = [";", "\t", ","].find((s) => lines[0][1].includes(s)) ?? /\s+/;
  const cut = (line) => line.trim().split(separator).map((cell) => cell.trim());
  const titles = cut(lines[0][1]), names = titles.map((title) => plain(title, columns)), found = {};
  for (const tail of [false, true]) {
    for (const role of roles.map((r) => r.replace("?", ""))) {
      const fits = (own, name) => own === name || (tail && !columns.whole.includes(name) && own.endsWith(`_${name}`));
      const taken = Object.values(found).map(({ column }) => column);
      for (const name of role in found ? [] : columns.names[role]) {
        const column = names.findIndex(({ name: own }, k) => !taken.includes(k) && fits(own, name));
        if (column < 0) continue;
        found[role] = { column, factor: FACTORS[names[column].unit] ?? 1, unit: names[column].unit };
        break;
      }
    }
  }
  for (const role of roles) if (!role.endsWith("?") && !(role in found)) fail(lines[0][0], words.noColumn(role, titles.join(", ")));
  const rows = lines.slice(1).map(([line, row]) => {
    const cells = cut(row), made = { line };
    for (const [role, { column, factor }] of Object.entries(found)) {
      const cell = cells[column] ?? "";
      if (role === "id") { made.id = cell; continue; }
      const number = Number(separator === "," ? cell : cell.replace(",", "."));
      if (cell === "" || !Number.isFinite(number)) fail(line, words.noNumber(titles[column], cell));
      made[role] = number * factor;
    }
    return made;
  });
  rows.forEach((row, k) => { if (k && row.t < rows[k - 1].t) fail(row.line, words.backwards); });
  for (const role of ["bearing", "orientation"]) {
    const wrong = rows.find((row) => Math.abs(row[role]) > 2 * Math.PI);
    if (wrong && !found[role].unit) fail(wrong.line, words.degrees(role, wrong[role]));
  }
  return rows;
}

/** The log of odometry (t, nu, omega) and sightings, as the engine takes it, and the names of the landmarks. */
export function logOf(odometry, sightings, file, words) {
  const first = odometry[0].t, last = odometry.at(-1).t;
  const known = sightings.filter(({ t, id }) => t >= first && t <= last && id !== "" && Number(id) !== -1);
  if (!known.length) throw new TableError(`${file}:${sightings[0].line}: ${words.noOverlap}`);
  const wrong = known.find(({ range }) => !(range > 0));
  if (wrong) throw new TableError(`${file}:${wrong.line}: ${words.noRange(wrong.range)}`);
  const names = [...new Set(known.map(({ id }) => id))], times = [...new Set(known.map(({ t }) => t))];
  const inside = odometry.map(({ t }) => t).filter((t) => t > times[0] && t < times.at(-1));
  const cuts = [...new Set([...inside, ...times])].sort((a, b) => a - b), starts = times.map((t) => cuts.indexOf(t));
  let row = 0;
  const controls = cuts.slice(0, -1).map((t, k) => {
    while (row + 1 < odometry.length && odometry[row + 1].t <= t) ++row;
    return [odometry[row].nu, odometry[row].omega, cuts[k + 1] - t];
  });
  const steps = new Map(times.map((t, k) => [t, k]));
  const rows = known.map((s) => [steps.get(s.t), names.indexOf(s.id), s.range, s.bearing, s.orientation ?? 0]);
  const oriented = known.every((s) => s.orientation !== undefined);
  return { start: [0, 0, 0], controls, starts, sightings: rows, oriented, names, left: sightings.length - known.length };
}
