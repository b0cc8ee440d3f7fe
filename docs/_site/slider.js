// Turns the figures of a slider, which are all shown without JavaScript, into one figure with a slider below.
function makeSliders() {
  for (const figure of document.querySelectorAll("figure.slider:not(.ready)")) {
    const images = [...figure.querySelectorAll("img")];
    const caption = figure.querySelector("figcaption");
    const input = document.createElement("input");
    Object.assign(input, { type: "range", min: 0, max: images.length - 1, value: 0, step: 1 });
    const show = () => {
      images.forEach((image, k) => { image.hidden = k !== Number(input.value); image.loading = "eager"; });
      caption.textContent = images[input.value].dataset.label;
      input.setAttribute("aria-valuetext", caption.textContent);
    };
    input.setAttribute("aria-label", caption.textContent);
    input.addEventListener("input", show);
    figure.insertBefore(input, caption);
    figure.classList.add("ready");
    show();
  }
}
typeof document$ === "undefined" ? document.addEventListener("DOMContentLoaded", makeSliders) : document$.subscribe(makeSliders);
