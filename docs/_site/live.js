// Loads the figures that readers move (`<figure class="live">`) when they come into view. Without JavaScript, or without the
// engine in `engine/vmslam.wasm`, the sentence inside the figure remains.
const LIVE = new URL(".", document.currentScript.src);
// not among the other words, which a page that is opened as a file cannot load
const MISSING = {
  en: "This figure needs the engine as WebAssembly, which this copy of the site does not have, or a browser that may load it: "
    + "build the site with <code>make docs</code> and open it through a web server, for example <code>python -m http.server</code>.",
  ja: "この図には、WebAssemblyにしたエンジンと、それを読み込めるブラウザが必要です。このサイトには見つかりませんでした。"
    + "<code>make docs</code> でサイトを作り、<code>python -m http.server</code> などのWebサーバ経由で開いてください。",
};

async function makeLive(figure) {
  try {
    const words = (await import(new URL("live/words.js", LIVE))).wordsOf(document.documentElement.lang);
    const { load, BOOK } = await import(new URL("../engine/vmslam.js", LIVE));
    const answer = await fetch(new URL("../engine/vmslam.wasm", LIVE));
    if (!answer.ok) throw new Error(answer.statusText);
    window.vmslam ??= load(await answer.arrayBuffer());
    const { make } = await import(new URL(`live/${figure.dataset.kind}.js`, LIVE));
    const data = JSON.parse(figure.querySelector("script")?.textContent ?? "{}");
    // tests and the console move the figure, too
    figure.live = make(figure, await window.vmslam, data, words, BOOK);
    figure.classList.add("ready");
  } catch (error) {
    figure.insertAdjacentHTML("beforeend", `<p class="live-missing">${MISSING[document.documentElement.lang.slice(0, 2)] ?? MISSING.en}</p>`);
    console.info(error);
  }
}

function watchLive() {
  const seen = new IntersectionObserver((entries) => entries.forEach(({ target, isIntersecting }) => {
    if (!isIntersecting) return;
    seen.unobserve(target);
    makeLive(target);
  }), { rootMargin: "200px" });
  document.querySelectorAll("figure.live:not(.ready)").forEach((figure) => seen.observe(figure));
}
typeof document$ === "undefined" ? document.addEventListener("DOMContentLoaded", watchLive) : document$.subscribe(watchLive);
