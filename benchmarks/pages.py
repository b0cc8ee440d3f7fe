"""The built site in a browser: weight of pages, time until the first picture, frames a second of figures that move.

    make docs
    python benchmarks/pages.py                 # all pages; the figures with 200 poses and with 1,000 particles
    python benchmarks/pages.py --pages index method/graph/edges

The weight is all that a page loads, with the engine where a figure needs it. Frames are counted while a script drags a pose
of a graph, and while FastSLAM steps, each frame with all that a reader would see. Beside other programs the processor time of
a frame says more: 16.7 ms are 60 frames a second.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "docs" / "_site")]

import live  # noqa: E402
from chromium import Chromium, Quiet, find_browser  # noqa: E402

from graphslam import simulate  # noqa: E402

SITE = ROOT / "site"
LOADED = """performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
    .reduce((sum, entry) => sum + entry.encodedBodySize, 0)"""
FIRST = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN"
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><link rel="stylesheet" href="_site/extra.css">
<body>{figure}<script src="_site/live.js"></script></body></html>"""
#: how many frames a second the browser draws while `act` runs before each
FRAMES = """new Promise((done) => {
    const live = document.querySelector("figure.live").live, from = performance.now();
    let frames = 0;
    const next = () => {
        (%s)(live, frames);
        if (++frames < %d) requestAnimationFrame(next);
        else done(1000 * frames / (performance.now() - from));
    };
    requestAnimationFrame(next);
})"""
DRAG = "(live, k) => { live.state.poses[5][0] += 0.02 * Math.sin(k / 5); live.draw(); }"
STEP = "(live) => { if (!live.step()) live.restart(); }"


def seconds(browser: Chromium) -> float:
    """The processor time of the page's main thread: scripts, styles, layout and painting; other programs do not matter."""
    metrics = browser.send("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", nargs="*", help="addresses below site/; default: all")
    parser.add_argument("--frames", type=int, default=180)
    options = parser.parse_args()
    program = find_browser()
    if program is None or not (SITE / "index.html").exists():
        sys.exit("this needs a browser (apt-get install chromium) and the site (make docs)")
    every = sorted(path.parent.relative_to(SITE).as_posix() for path in SITE.rglob("index.html"))
    pages = every if options.pages is None else [page.replace("index", ".") for page in options.pages]
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(SITE)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    with tempfile.TemporaryDirectory() as profile, Chromium(program, Path(profile)) as browser:
        browser.send("Network.setCacheDisabled", cacheDisabled=True)
        browser.send("Performance.enable", timeDomain="threadTicks")
        measured = []
        for page in pages:
            browser.send("Page.navigate", url=f"{address}/{page}/")
            browser.wait_for("document.readyState === 'complete' && document.querySelector('article') !== null")
            if browser.evaluate("document.querySelector('figure.live') !== null"):
                browser.evaluate("document.querySelector('figure.live').scrollIntoView()")
                browser.wait_for("document.querySelector('figure.live.ready') !== null")
            measured.append((browser.evaluate(LOADED), browser.evaluate(FIRST), page))
        print(f"{len(measured)} pages, the heaviest:")
        for weight, first, page in sorted(measured, reverse=True)[:8]:
            print(f"  {weight / 1e6:5.2f} MB, first picture after {first:4.0f} ms  {page}")
        print(f"slowest first picture: {max(first for _, first, _ in measured if first == first):.0f} ms")
        # two figures that no page has, on the files of the site
        logs = {"many": simulate(seed=1, steps=199, clean=True, max_range=2.5)}
        live.log = lambda name, bundled=live.log: logs.get(name) or bundled(name)
        for name, arguments, act in (
            ("graph of 200 poses", ["graph", "many", "controls="], DRAG),
            ("the same with ellipses", ["graph", "many", "ellipses=yes", "controls="], DRAG),
            ("FastSLAM, 1,000 particles", ["fastslam", "drive"], STEP),
        ):
            (SITE / "measured.html").write_text(PAGE.format(figure=live.figure([*arguments, name])))
            browser.send("Page.navigate", url=f"{address}/measured.html")
            browser.wait_for("document.querySelector('figure.live.ready') !== null")
            if "fastslam" in arguments:
                browser.evaluate("document.querySelector('figure.live').live.change('particles')(1000)")
            before = seconds(browser)
            rate = browser.evaluate(FRAMES % (act, options.frames))
            busy = 1000 * (seconds(browser) - before) / options.frames
            edges = browser.evaluate("document.querySelector('figure.live').live.costs?.().squares.length ?? 0")
            what = f"{name}, {edges} edges" if edges else name
            print(
                f"{what}: {rate:.0f} frames a second, {busy:.1f} ms of processor time for each ({1000 / busy:.0f} a second)"
            )
        (SITE / "measured.html").unlink()
    server.shutdown()


if __name__ == "__main__":
    main()
