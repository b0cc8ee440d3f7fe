// Exercises that answer: compares the numbers in the fields with the right ones, and says what is wrong. Words and numbers are in
// the page (`exercises.py`); nothing is sent.

/** The value of an expression such as -0.25, 3/4, pi/2, 0.14^2, sqrt(2) or 1e-4; NaN where it is none. */
export function read(text) {
  const plain = text.normalize("NFKC").toLowerCase().replace(/[−–ー]/g, "-").replace(/[×·]/g, "*").replace(/[*]{2}/g, "^").replace(/÷/g, "/").replace(/π/g, "pi")
    .replace(/√/g, "sqrt").replace(/^([^.,]*),([^.,]*)$/, "$1.$2");
  const tokens = plain.match(/\d*\.?\d+(?:e[-+]?\d+)?|\d+\.|pi|sqrt|\S/g) ?? [];
  let k = 0;
  const takes = (...names) => (names.includes(tokens[k]) ? tokens[k++] : null);
  function sum() {
    let value = product();
    for (let sign; (sign = takes("+", "-"));) value += (sign === "+" ? 1 : -1) * product();
    return value;
  }
  function product() {
    let value = signed();
    for (let sign; (sign = takes("*", "/"));) value = sign === "*" ? value * signed() : value / signed();
    return value;
  }
  function signed() { return takes("-") ? -signed() : takes("+") ? signed() : power(); }
  function power() {
    const base = atom();
    return takes("^") ? base ** signed() : base;
  }
  function atom() {
    if (takes("pi")) return Math.PI;
    if (takes("sqrt")) return Math.sqrt(atom());
    if (takes("(")) { const inner = sum(); return takes(")") ? inner : NaN; }
    return /^[\d.]/.test(tokens[k] ?? "") ? Number(tokens[k++]) : NaN;
  }
  const value = sum();
  return k === tokens.length ? value : NaN;
}

/** What is wrong with numbers, in one sentence, and which of them are: [sentence, list of their places]. */
export function judge({ right, slack, mistakes, factors, others, words }, given) {
  const columns = right[0].length, numbers = right.flat(), slacks = slack.flat();
  const off = (value, k, times = 1) => !(Math.abs(given[k] - value) <= times * slacks[k]);
  const wrong = [...numbers.keys()].filter((k) => off(numbers[k], k));
  if (!wrong.length) return [words.right + words.stop, wrong];
  const unreadable = wrong.filter((k) => !Number.isFinite(given[k]));
  if (unreadable.length) return [words.unreadable + words.stop, unreadable];
  const explained = (list) => list.find(({ value }) => { const theirs = value.flat(); return wrong.every((k) => !off(theirs[k], k)); });
  let text = factors.find(([factor]) => wrong.every((k) => !off(factor * numbers[k], k, Math.abs(factor))))?.[1];
  const whole = explained(mistakes) ?? (text ? null : explained(others));
  if (whole) return [whole.text + words.stop, wrong];
  text ??= wrong.every((k) => !off(numbers[k], k, 5)) ? words.nearly : words.wrong;
  const named = (name, k) => words[name].replace("{r}", Math.floor(k / columns) + 1).replace("{c}", k % columns + 1);
  const same = (place) => right.length > 1 && wrong.length > 1 && new Set(wrong.map(place)).size === 1;
  const where = numbers.length === 1 ? ""
    : same((k) => k % columns) ? named("column", wrong[0])
    : same((k) => Math.floor(k / columns)) ? named("row", wrong[0])
    : wrong.map((k) => named(right.length > 1 ? "entry" : "number", k)).join(words.and);
  return [text + (where && `: ${where}`) + words.stop, wrong];
}

export function makeExercises() {
  for (const form of document.querySelectorAll("form.ask[hidden]")) {
    const question = JSON.parse(form.querySelector("script").textContent), fields = [...form.querySelectorAll("input")];
    form.hidden = false;
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const [sentence, wrong] = judge(question, fields.map((field) => read(field.value)));
      fields.forEach((field, k) => field.setAttribute("aria-invalid", wrong.includes(k)));
      form.classList.toggle("ask-right", !wrong.length);
      form.querySelector(".ask-answer").textContent = sentence;
    });
  }
}
typeof document$ === "undefined" ? makeExercises() : document$.subscribe(makeExercises);
