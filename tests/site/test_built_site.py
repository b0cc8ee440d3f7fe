"""The built site in a real browser: every page in both languages, light and dark, on a desktop and on a phone."""

from __future__ import annotations

import json
import re
import sys
import threading
import tomllib
from collections.abc import Iterator
from functools import partial
from http.server import ThreadingHTTPServer
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Chromium, Quiet, find_browser
from matplotlib.image import imread

SITE = Path(__file__).parents[2] / "site"
BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium"),
    pytest.mark.skipif(not (SITE / "index.html").exists(), reason="needs the site: make docs"),
]
PAGES = sorted(path.parent.relative_to(SITE).as_posix() for path in SITE.rglob("index.html"))
#: [bytes]
LARGEST = 2_000_000

#: what a page loads, with the index of the search, without what is folded [bytes]
LOADED = """performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
    .reduce((sum, entry) => sum + entry.encodedBodySize, 0)"""
#: what is wrong with a page, as a list of sentences
FAULTS = """(() => {
    const faults = [], text = document.querySelector("article").innerText;
    if (document.documentElement.scrollWidth > innerWidth) faults.push("wider than the window");
    for (const image of document.querySelectorAll("article img")) {
        if (!image.alt) faults.push("no alternative text: " + image.src);
        if (image.complete && !image.naturalWidth && image.checkVisibility()) faults.push("not loaded: " + image.src);
    }
    for (const slider of document.querySelectorAll("figure.slider")) {
        const images = [...slider.querySelectorAll("img")], input = slider.querySelector("input");
        const opened = slider.closest("details:not([open])");
        if (opened) opened.open = true;
        for (const [number, image] of images.entries()) {
            input.value = number;
            input.dispatchEvent(new Event("input"));
            if (images.some((other) => other.checkVisibility() !== (other === image))) faults.push("slider: " + image.src);
        }
        if (opened) opened.open = false;
    }
    if (document.querySelector("article .arithmatex, article .katex-error")) faults.push("a formula is not rendered");
    const right = document.querySelector("article").getBoundingClientRect().right + 1;
    for (const box of document.querySelectorAll("article .formula, article pre > code, article table")) {
        let clipping = box;
        while (clipping.tagName !== "ARTICLE" && !["auto", "scroll"].includes(getComputedStyle(clipping).overflowX))
            clipping = clipping.parentElement;
        const cut = clipping.tagName === "ARTICLE" && box.checkVisibility() && box.getBoundingClientRect().right > right;
        if (cut) faults.push("cut: " + box.textContent.slice(0, 60));
    }
    if (/[{]{2} |\\\\\\\\[a-z]+[{]/.test(text.replace(/[`]/g, ""))) faults.push("raw markup is visible");
    return faults; })()"""
#: texts in sight whose contrast with what is behind them is below 3 (WCAG 2.1, success criterion 1.4.3 for large letters)
FAINT = """(() => {
    const numbers = (colour) => {
        const canvas = (window.probe ??= new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true }));
        canvas.clearRect(0, 0, 1, 1);
        canvas.fillStyle = colour;
        canvas.fillRect(0, 0, 1, 1);
        return canvas.getImageData(0, 0, 1, 1).data;
    };
    const known = new Map(), memo = (colour) => known.get(colour) ?? (known.set(colour, numbers(colour)), known.get(colour));
    const light = (rgb) => [0.2126, 0.7152, 0.0722].reduce((sum, part, k) => {
        const v = rgb[k] / 255;
        return sum + part * (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    }, 0);
    const faint = new Set();
    for (const box of document.querySelectorAll("article :is(p, li, td, th, h1, h2, pre code, .katex-html, label)")) {
        if (!box.checkVisibility() || !box.textContent.trim()) continue;
        let behind = box;
        while (behind && memo(getComputedStyle(behind).backgroundColor)[3] < 250) behind = behind.parentElement;
        const under = behind ? memo(getComputedStyle(behind).backgroundColor) : [255, 255, 255, 255];
        const own = memo(getComputedStyle(box).color), alpha = own[3] / 255;
        const mixed = [0, 1, 2].map((k) => (alpha ? own[k] * alpha : 0) + under[k] * (1 - alpha));
        const [a, b] = [light(mixed), light(under)].sort((p, q) => q - p);
        if ((a + 0.05) / (b + 0.05) < 3) faint.add(box.tagName + ": " + box.textContent.trim().slice(0, 40));
    }
    return [...faint].slice(0, 5); })()"""
#: exercises whose fields do not accept the right numbers, or that are not visible
UNANSWERED = """[...document.querySelectorAll("form.ask")].filter((form) => {
    for (let box = form.closest("details"); box; box = box.parentElement.closest("details")) box.open = true;
    const right = JSON.parse(form.querySelector("script").textContent).right.flat();
    form.querySelectorAll("input").forEach((field, k) => { field.value = right[k]; });
    form.requestSubmit();
    return !form.checkVisibility() || !form.classList.contains("ask-right");
}).map((form) => form.innerText)"""
#: the pages that the search of the site finds for each question, best first
FOUND = """(async () => {
    const config = JSON.parse(document.getElementById("__config").textContent), worker = new Worker(config.search);
    const index = await (await fetch(new URL(config.base + "/search/search_index.json", location))).json();
    const ask = (type, data, answer) => new Promise((done) => {
        worker.onmessage = (event) => event.data.type === answer && done(event.data.data);
        worker.postMessage({ type, data });
    });
    await ask(0, { config: index.config, docs: index.docs, options: { suggest: false } }, 1);
    const found = [];
    for (const question of %s)
        found.push((await ask(2, question, 3)).items.map((sections) => sections[0].location.split("#")[0]));
    return found; })()"""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(SITE)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    assert BROWSER is not None
    with Chromium(BROWSER, Path(tmp_path_factory.mktemp("profile"))) as chromium:
        yield chromium


@pytest.mark.parametrize("page", PAGES)
def test_page(page: str, address: str, browser: Chromium) -> None:
    browser.events.clear()
    browser.resize(1300, 900)
    browser.send("Network.setCacheDisabled", cacheDisabled=True)
    browser.send("Page.navigate", url=f"{address}/{page}/")
    browser.wait_for("document.readyState === 'complete' && document.querySelector('article') !== null")
    assert browser.evaluate("document.documentElement.lang") == ("ja" if page.split("/")[0] == "ja" else "en")
    # the phone last: on the way back to a wide window the theme moves its navigation for a while
    for width, height in ((1300, 900), (390, 844)):
        browser.resize(width, height)
        for number, scheme in enumerate(("default", "slate")):
            # the first visit takes the colours that the system prefers, and keeps them: later only the button changes them
            browser.evaluate(f"document.querySelectorAll('input[name=__palette]')[{number}].click()")
            browser.wait_for(f"document.body.dataset.mdColorScheme === {scheme!r}")
            assert browser.evaluate(FAULTS) == [], (scheme, width)
            assert browser.evaluate(FAINT) == [], (scheme, width)
    if browser.evaluate("document.querySelector('figure.live') !== null"):
        # such a figure loads the engine when it comes into view
        browser.evaluate("document.querySelector('figure.live').scrollIntoView()")
        browser.wait_for("document.querySelector('figure.live.ready, .live-missing') !== null")
    # the theme looks for a site map beside each page, to find the translation, and does without it
    assert [complaint for complaint in browser.complaints() if "sitemap.xml" not in complaint] == []
    assert browser.evaluate(LOADED) < LARGEST
    # opening the exercises loads what is folded; they are hidden until their script is ready
    browser.wait_for("[...document.querySelectorAll('form.ask')].every((form) => !form.hidden)")
    assert browser.evaluate(UNANSWERED) == []
    assert browser.evaluate(FAULTS) == [], "with the exercises open"


@pytest.mark.parametrize("language", ["en", "ja"])
def test_search_finds_the_page_among_the_first_three(language: str, address: str, browser: Chromium) -> None:
    questions = tomllib.loads((SITE.parent / "docs" / "_site" / "questions.toml").read_text())[language]
    assert len(questions) >= 30
    browser.send("Page.navigate", url=f"{address}/{'ja/' if language == 'ja' else ''}index.html")
    browser.wait_for("document.readyState === 'complete' && document.querySelector('article') !== null")
    found = browser.evaluate(FOUND % json.dumps(list(questions)))
    missed = {
        question: pages[:5]
        for (question, page), pages in zip(questions.items(), found, strict=True)
        if page not in list(dict.fromkeys(pages))[:3]
    }
    assert missed == {}


def test_symbols_explain_themselves(address: str, browser: Chromium) -> None:
    browser.resize(1280, 900)
    browser.send("Page.navigate", url=f"{address}/ja/method/graph/information/")
    browser.wait_for("document.readyState === 'complete' && document.querySelector('.symbol-tip') !== null")
    tip, shown = "document.querySelector('.symbol-tip')", "document.querySelector('.symbol-tip').checkVisibility()"
    x, y = browser.evaluate("""(() => {
        const symbol = document.querySelector("div.formula [data-sym]");
        symbol.scrollIntoView({ block: "center" });
        const box = symbol.getBoundingClientRect();
        return [box.x + box.width / 2, box.y + box.height / 2]; })()""")
    assert not browser.evaluate(shown)
    browser.move_mouse(x, y)
    browser.wait_for(shown)
    assert "センサ値の共分散行列" in browser.evaluate(f"{tip}.innerText")
    browser.press("Escape", 27)
    browser.wait_for(f"!{shown}")
    browser.move_mouse(2, 2)
    browser.click("div.formula [data-sym]")
    browser.wait_for(shown)
    browser.press("Escape", 27)
    browser.wait_for(f"!{shown}")
    # by keyboard all symbols of a formula
    browser.send("Emulation.setFocusEmulationEnabled", enabled=True)
    browser.evaluate(
        "document.activeElement.blur(), document.querySelector('div.formula').focus({ focusVisible: true })"
    )
    browser.wait_for(shown)
    assert browser.evaluate(f"{tip}.childElementCount") >= 4
    # each link leads to a heading in the same language
    links = browser.evaluate("[...document.querySelectorAll('details.symbols a')].map((link) => link.href)")
    assert len(links) > 5
    for link in set(links):
        page, _, anchor = link.removeprefix(f"{address}/").partition("#")
        assert page.startswith("ja/")
        assert not anchor or f'id="{anchor}"' in (SITE / page / "index.html").read_text()


#: what a page without JavaScript hides, or shows although it does nothing
UNREADABLE = """(() => {
    const faults = [], all = (selector) => [...document.querySelectorAll(selector)];
    if (all("article p").some((text) => !text.closest("details, .tabbed-block") && !text.checkVisibility()))
        faults.push("text");
    if (all("div.formula .katex-html").some((formula) => !formula.closest("details") && !formula.checkVisibility()))
        faults.push("formulas");
    if (all("figure.live figcaption").some((text) => !text.checkVisibility() || text.innerText.length < 40))
        faults.push("live");
    if (all("figure.slider").some((slider) => !slider.closest("details")
        && [...slider.querySelectorAll("img")].some((image) => !image.checkVisibility()))) faults.push("slider");
    if (all("article :is(button, input[type=range], form.ask)").some((control) => control.checkVisibility()))
        faults.push("controls that do nothing");
    return faults; })()"""


@pytest.mark.parametrize("page", ["", "ja/method/graph/edges/", "beyond/robust/", "ja/beyond/starts/", "own_robot/"])
def test_pages_can_be_read_without_javascript(page: str, address: str, browser: Chromium) -> None:
    browser.send("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.send("Page.navigate", url=f"{address}/{page}")
        browser.wait_for("document.readyState === 'complete' && document.querySelector('article') !== null")
        assert browser.evaluate(UNREADABLE) == []
    finally:
        browser.send("Emulation.setScriptExecutionDisabled", value=False)


def test_labels_of_figures_are_japanese_on_japanese_pages() -> None:
    sys.path.insert(0, str(SITE.parent / "docs" / "_site"))
    labels = import_module("labels")
    figures = [figure for kind in ("svg", "png") for figure in (SITE / "figures").rglob(f"*.{kind}")]
    figures = [figure for figure in figures if not figure.stem.endswith(".ja")]
    assert len(figures) > 30
    missing = {label: figure.name for figure in figures for label in labels.missing(figure)}
    assert missing == {}
    assert "真値" in (SITE / "figures" / "method" / "graph" / "problem" / "trajectories-0.ja.svg").read_text()


#: labels of an SVG that reach beyond it; the box of one with an exponent is higher than its letters
CUT = """(() => {
    const whole = document.documentElement.getBoundingClientRect();
    return [...document.querySelectorAll("text:not(:has(tspan))")].filter((label) => {
        const box = label.getBoundingClientRect();
        const beside = box.left < whole.left - 1 || box.right > whole.right + 1;
        return beside || box.top < whole.top - 2 || box.bottom > whole.bottom + 2;
    }).map((label) => label.textContent); })()"""


def test_no_label_of_a_figure_is_cut(address: str, browser: Chromium) -> None:
    cut = {}
    for figure in sorted((SITE / "figures").rglob("*.svg")):
        browser.send("Page.navigate", url=f"{address}/{figure.relative_to(SITE).as_posix()}")
        browser.wait_for("document.readyState === 'complete' && document.documentElement.tagName === 'svg'")
        if labels := browser.evaluate(CUT):
            cut[figure.name] = labels
    assert cut == {}


#: each formula in sight: its HTML, the size of its letters, and the places of its parts on the page, as far as they show [px]
FORMULAS = """((selector) => [...document.querySelectorAll(selector)].filter((f) => f.checkVisibility()).map((formula) => {
    const right = formula.closest("div.formula")?.getBoundingClientRect().right ?? Infinity;
    const boxes = [...formula.querySelectorAll(".katex-base")].map((part) => {
        const box = part.getBoundingClientRect();
        return [box.x + scrollX, box.y + scrollY, Math.min(box.width, right - box.x), box.height];
    });
    return [formula.outerHTML, getComputedStyle(formula).fontSize, boxes];
}))"""
#: the same formulas with the style sheet of KaTeX alone, one below the other
REFERENCE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><link rel="stylesheet" href="{katex}">
<style>body {{ margin: 20px; background: white; color: black }} p {{ margin: 0 0 24px; white-space: nowrap }}</style>
{lines}"""


def ink(picture: Any, box: Any) -> Any:
    """Where a picture (height, width) is dark, in a box and a margin of two pixels around it."""
    x, y, width, height = (round(number) for number in box)
    return picture[max(y - 2, 0) : y + height + 2, max(x - 2, 0) : x + width + 2] < 0.65


def uncovered(ink: Any, other: Any) -> float:
    """The part of the ink that has none of the other one within two pixels."""
    rows, columns = (min(a, b) for a, b in zip(ink.shape, other.shape))
    near = np.zeros((rows, columns), dtype=bool)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            near |= np.roll(other[:rows, :columns], (dy, dx), (0, 1))
    # the margin belongs to the neighbours, whose slanted letters reach over it
    own, near = (each[2 : rows - 2, 5 : columns - 5] for each in (ink, near))
    return float(np.sum(own & ~near) / max(np.sum(own), 1))


@pytest.mark.parametrize("chapter", ["method/graph", "method/fastslam", "beyond"])
def test_formulas_look_as_katex_draws_them_alone(chapter: str, address: str, browser: Chromium, tmp_path: Path) -> None:
    def look(page: str, selector: str) -> tuple[list[Any], Any]:
        browser.send("Page.navigate", url=f"{address}/{page}")
        browser.wait_for("document.readyState === 'complete' && document.querySelector('article, p') !== null")
        browser.evaluate("document.querySelector('input[name=__palette]')?.click()")  # light colours
        browser.wait_for("document.body.dataset.mdColorScheme !== 'slate'")
        browser.evaluate("document.fonts.ready")
        shown = browser.evaluate(f"{FORMULAS}({selector!r})")
        browser.screenshot(tmp_path / "page.png")
        return shown, imread(tmp_path / "page.png")[:, :, :3].mean(axis=2)

    browser.resize(1300, 900)
    wrong, compared = [], 0
    for page in [page for page in PAGES if page.rsplit("/", 1)[0] == chapter]:
        shown, picture = look(f"{page}/", "article .formula .katex")
        if not shown:
            continue
        sized = (html.replace("<span", f'<span style="font-size: {size}"', 1) for html, size, _ in shown)
        lines = "".join(f"<p>{html}</p>" for html in sized)
        text = REFERENCE.format(katex=f"{address}/_site/katex/katex.min.css", lines=lines)
        (SITE / "reference.html").write_text(text)
        alone, reference = look("reference.html", "p .katex")
        for (html, _, ours), (_, _, theirs) in zip(shown, alone, strict=True):
            for box, place in zip(ours, theirs, strict=True):
                if box[2] < 2:  # out of sight
                    continue
                inks = ink(picture, box), ink(reference, [*place[:2], min(place[2], box[2]), place[3]])
                compared += 1
                if abs(box[3] - place[3]) > 1 or max(uncovered(*inks), uncovered(*inks[::-1])) > 0.12:
                    wrong.append((page, re.sub("<.*?>", "", html)[-60:], [round(v) for v in box]))
    (SITE / "reference.html").unlink()
    assert compared > 100
    assert wrong == []
