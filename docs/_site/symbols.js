// Symbols that explain themselves: the row of the table at the end of the page appears beside a symbol that the reader points at or
// taps, and the rows of all its symbols beside a formula that has the focus. Escape or a tap elsewhere closes it.
function makeSymbols() {
  const article = document.querySelector("article"), table = article?.querySelector("details.symbols");
  document.querySelector(".symbol-tip")?.remove();
  if (!table) return;
  const tip = document.createElement("div");
  Object.assign(tip, { className: "symbol-tip md-typeset", id: "symbol-tip", hidden: true });
  tip.setAttribute("role", "tooltip");
  document.body.append(tip);
  let waiting = null;

  function show(symbols, beside) {
    clearTimeout(waiting);
    const rows = [...new Set(symbols.map((symbol) => symbol.dataset.sym))].map((number) => table.querySelector(`#symbol-${number}`));
    tip.replaceChildren(...rows.filter(Boolean).map((row) => {
      const [symbol, meaning, unit, where] = [...row.cells], line = document.createElement("p");
      const link = where.firstChild.cloneNode(true);
      line.append(symbol.firstChild.cloneNode(true), ` ${meaning.textContent} `, unit.textContent && `[${unit.textContent}] `, link);
      return line;
    }));
    if (!tip.childElementCount) return;
    tip.hidden = false;
    const box = beside.getBoundingClientRect(), width = document.documentElement.clientWidth;
    tip.style.left = `${scrollX + Math.max(8, Math.min(box.left, width - tip.offsetWidth - 8))}px`;
    tip.style.top = `${scrollY + box.bottom + 6}px`;
  }
  const hide = (after = 0) => { clearTimeout(waiting); waiting = setTimeout(() => { tip.hidden = true; }, after); };
  const symbolOf = (event) => event.target.closest?.("[data-sym]");

  article.addEventListener("pointerover", (event) => {
    const symbol = symbolOf(event);
    if (symbol && event.pointerType === "mouse") { clearTimeout(waiting); waiting = setTimeout(() => show([symbol], symbol), 150); }
  });
  article.addEventListener("pointerout", (event) => { if (symbolOf(event) && event.pointerType === "mouse") hide(400); });
  tip.addEventListener("pointerenter", () => clearTimeout(waiting));
  tip.addEventListener("pointerleave", () => hide(200));
  article.addEventListener("click", (event) => { const symbol = symbolOf(event); if (symbol) show([symbol], symbol); });
  document.addEventListener("pointerdown", (event) => { if (!tip.contains(event.target) && !symbolOf(event)) hide(); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
  for (const formula of article.querySelectorAll("div.formula")) {
    formula.addEventListener("focus", () => {
      if (!formula.matches(":focus-visible")) return;
      show([...formula.querySelectorAll("[data-sym]")], formula);
      formula.setAttribute("aria-describedby", "symbol-tip");
    });
    formula.addEventListener("blur", () => hide(200));
  }
}
typeof document$ === "undefined" ? document.addEventListener("DOMContentLoaded", makeSymbols) : document$.subscribe(makeSymbols);
