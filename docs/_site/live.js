// Loads the figures that readers move (`<figure class="live">`) when they come into view. Without JavaScript, or without the
// engine in `engine/vmslam.wasm`, the sentence inside the figure remains.
const LIVE = new URL(".", document.currentScript.src);

async function makeLive(figure) {
  const words = (await import(new URL("live/words.js", LIVE))).wordsOf(document.documentElement.lang);
  try {
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
    figure.insertAdjacentHTML("beforeend", `<p class="live-missing">${words.missing}</p>`);
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
