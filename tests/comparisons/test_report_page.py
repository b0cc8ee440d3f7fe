"""The report in a real browser: opened from disk, operated, and compared with the numbers through its DOM."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import Chromium, find_browser

from comparisons import run
from comparisons.comparison import Comparison
from comparisons.show.report import write_report
from comparisons.show.report.view import View, view_of
from graphslam import simulate
from graphslam.metrics import position_errors

BROWSER = find_browser()
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium"),
]

NAMES = ["dead-reckoning", "textbook", "graph", "gtsam", "fastslam1"]
#: where a pose lies in the window: the drawing area of the map is a rectangle, its axes are linear
PLACE = """((x, y) => {
    const map = document.getElementById("map");
    map.scrollIntoView({ block: "center" });
    const box = map.querySelector(".nsewdrag").getBoundingClientRect();
    const [left, right] = map.layout.xaxis.range, [low, high] = map.layout.yaxis.range;
    return [box.x + box.width * (x - left) / (right - left), box.y + box.height * (high - y) / (high - low)];
})"""


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    log = simulate(seed=2, steps=24, clean=True).replace(name='a <b>log</b> & its "name" </script>')
    return run(log, estimators=NAMES, particles=50)


@pytest.fixture(scope="module")
def view(comparison: Comparison) -> View:
    return view_of(comparison)


@pytest.fixture(scope="module")
def page(comparison: Comparison, tmp_path_factory: Any) -> Path:
    path = Path(tmp_path_factory.mktemp("report")) / "page.html"
    write_report(comparison, path)
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: Any) -> Iterator[Chromium]:
    assert BROWSER is not None
    with Chromium(BROWSER, Path(tmp_path_factory.mktemp("profile"))) as chromium:
        yield chromium


@pytest.fixture
def opened(browser: Chromium, page: Path) -> Iterator[Chromium]:
    """The page, opened anew; whatever a test does with it, it must not complain."""
    browser.events.clear()
    browser.resize(1280, 900)
    browser.open(page)
    yield browser
    assert browser.complaints() == []


def draw_all(browser: Chromium) -> None:
    """Go through the page, so that all of its figures are drawn."""
    for name in ("map", "errors", "costs", "convergence", "matrix"):
        browser.evaluate(f"document.getElementById('{name}').scrollIntoView()")
        browser.wait_for(f"document.getElementById('{name}').dataset.drawn === 'yes'")


@pytest.mark.parametrize("name", ["graph", "fastslam1"])
def test_a_click_on_a_landmark_shows_its_sightings(
    opened: Chromium, view: View, comparison: Comparison, name: str
) -> None:
    estimate = next(e for e in view.estimates if e.name == name)
    j, place = next(iter(estimate.landmarks.items()))
    # alone, so that the mouse meets its landmark
    for other in NAMES:
        if other != name:
            opened.click(f"input[data-estimator='{other}']")
    for layer in ("truth", "path", "now"):
        opened.click(f"input[data-layer='{layer}']")
    x, y = opened.evaluate(f"{PLACE}({place[0]}, {place[1]})")
    opened.move_mouse(x - 40, y - 40)
    opened.move_mouse(x, y)
    opened.wait_for("document.querySelector('#map .hoverlayer .hovertext') !== null")
    for kind in ("mousePressed", "mouseReleased"):
        opened.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    opened.wait_for("!document.getElementById('match').hidden")
    text = opened.evaluate("document.getElementById('match').textContent")
    log = comparison.log
    steps = log.steps[log.landmarks == j]
    assert text.startswith(f"{name}, landmark {j}: {len(steps)} sightings in steps {steps[0]}")
    drawn = "document.getElementById('map').data.find((trace) => trace.meta.layer === 'matches').x"
    # from the pose to the landmark, and a gap
    assert opened.evaluate(f"{drawn}.length") == 3 * len(steps)
    at = opened.evaluate(drawn)
    assert at[0] == pytest.approx(estimate.poses[steps[0], 0], abs=1e-3) and at[1] == pytest.approx(place[0], abs=1e-3)


def count(browser: Chromium, selector: str) -> int:
    return int(browser.evaluate(f"document.querySelectorAll({selector!r}).length"))


@pytest.mark.slow
def test_it_opens_from_disk_and_asks_for_nothing_else(opened: Chromium, page: Path, comparison: Comparison) -> None:
    draw_all(opened)
    for name in ("map", "errors", "costs", "convergence"):
        assert count(opened, f"#{name} .scatterlayer .trace path.js-line") > 2, name
    assert count(opened, "#matrix .heatmaplayer image") == 2
    assert opened.evaluate("document.querySelector('h1').textContent") == comparison.log.name
    assert [url for url in opened.requests() if not url.startswith("data:")] == [page.as_uri()]
    assert page.stat().st_size < 8e6


def test_an_estimator_is_hidden_and_shown_everywhere(opened: Chromium) -> None:
    draw_all(opened)
    box = "input[data-estimator='textbook']"
    everything = {
        name: count(opened, f"#{name} .scatterlayer .trace") for name in ("map", "errors", "costs", "convergence")
    }
    row = "document.querySelector('#now tr[data-estimator=textbook]').offsetParent !== null"
    assert opened.evaluate(row)
    opened.click(box)
    opened.wait_for(f"document.querySelectorAll('#costs .scatterlayer .trace').length === {everything['costs'] - 2}")
    # path, landmarks, their ellipses, sightings, robot; its curve; J and norm
    fewer = {"map": 5, "errors": 1, "costs": 2, "convergence": 0}
    for name, traces in everything.items():
        assert count(opened, f"#{name} .scatterlayer .trace") == traces - fewer[name], name
    assert not opened.evaluate(row)
    opened.click(box)
    opened.wait_for(f"document.querySelectorAll('#costs .scatterlayer .trace').length === {everything['costs']}")
    assert {name: count(opened, f"#{name} .scatterlayer .trace") for name in everything} == everything


def test_layers_are_hidden_and_shown(opened: Chromium, view: View) -> None:
    traces = "#map .scatterlayer .trace"
    before = count(opened, traces)
    opened.click("input[data-layer='pose-ellipses']")
    known = sum(estimate.covariances is not None for estimate in view.estimates)
    opened.wait_for(f"document.querySelectorAll('{traces}').length === {before + known}")
    opened.click("input[data-layer='landmark-ellipses']")
    maps = sum(bool(estimate.landmark_covariances) for estimate in view.estimates)
    opened.wait_for(f"document.querySelectorAll('{traces}').length === {before + known - maps}")


def test_what_is_hidden_before_a_figure_is_drawn_stays_hidden(opened: Chromium) -> None:
    opened.click("input[data-estimator='graph']")
    draw_all(opened)
    assert opened.evaluate(
        "document.getElementById('costs').data.filter((t) => t.meta.estimator === 'graph').map((t) => t.visible)"
    ) == [False, False]


def test_the_slider_goes_through_the_steps(opened: Chromium, view: View, comparison: Comparison) -> None:
    cursor = "document.querySelector('#errors .shapelayer path').getAttribute('d')"
    markers = "#map .scatterlayer .trace .points path"
    robots = f"[...document.querySelectorAll('{markers}')].map((p) => p.getAttribute('transform')).join()"
    before = opened.evaluate(cursor), opened.evaluate(robots)
    assert opened.evaluate("document.getElementById('moment').textContent").startswith("step 0 of 24, 0.00 s")
    opened.evaluate("document.getElementById('step').focus()")
    for _ in range(3):
        opened.press("ArrowRight", 39)
    opened.click("#forward")
    opened.click("#forward")
    opened.click("#back")
    k = 4
    assert view.times is not None
    words = opened.evaluate("document.getElementById('moment').textContent")
    assert words.startswith(f"step {k} of 24, {view.times[k]:.2f} s, ")
    seen = [str(j) for t, j in zip(comparison.log.steps, comparison.log.landmarks) if t == k]
    assert words.endswith(f" {len(seen)} sightings: {', '.join(seen)}" if seen else " no sightings")
    opened.wait_for(f"{cursor} !== {before[0]!r} && {robots} !== {before[1]!r}")
    for row, estimate in enumerate(view.estimates):
        cells = opened.evaluate(
            f"[...document.querySelectorAll('#now tbody tr')[{row}].cells].map((c) => c.textContent)"
        )
        assert cells[0] == estimate.name
        expected = [*estimate.poses[k], estimate.errors[k]]
        assert [float(cell) for cell in cells[1:5]] == pytest.approx(expected, abs=6e-4)
        if estimate.covariances is None:
            assert cells[5:] == ["–"] * 3
        else:
            sigmas = estimate.covariances[k].diagonal() ** 0.5
            assert [float(cell) for cell in cells[5:]] == pytest.approx(sigmas, abs=6e-5)
    # the sightings from the pose end at what was seen: as many lines as sightings, and an ellipse
    lines = opened.evaluate(
        "document.getElementById('map').data.find((t) => t.meta.estimator === 'graph' && t.meta.part === 'sightings').x"
    )
    assert lines.count(None) == len(seen) + 1


def test_hover_shows_step_time_error_and_covariance(opened: Chromium, view: View, comparison: Comparison) -> None:
    for name in NAMES:
        if name != "graph":
            opened.click(f"input[data-estimator='{name}']")
    for layer in ("landmarks", "landmark-ellipses", "truth", "now"):
        opened.click(f"input[data-layer='{layer}']")
    opened.wait_for("document.querySelectorAll('#map .scatterlayer .trace').length === 1")
    estimate = next(e for e in view.estimates if e.name == "graph")
    assert estimate.covariances is not None and view.times is not None and comparison.log.true_poses is not None
    k = 9
    # figures that are drawn later may still move the map: look again where the pose is
    for _ in range(60):
        x, y = opened.evaluate(f"{PLACE}({estimate.poses[k, 0]}, {estimate.poses[k, 1]})")
        opened.move_mouse(x - 40, y - 40)
        opened.move_mouse(x, y)
        time.sleep(0.2)
        if opened.evaluate("document.querySelector('#map .hoverlayer .hovertext') !== null"):
            break
    text = opened.evaluate("document.querySelector('#map .hoverlayer .hovertext').textContent")
    error = position_errors(comparison.log.true_poses, comparison["graph"].poses)[k]
    sx, sy, st = estimate.covariances[k].diagonal() ** 0.5
    rho = estimate.covariances[k, 0, 1] / (sx * sy)
    for words in (
        f"graph, step {k}", f"time {view.times[k]:.2f} s", f"error {error:.3f} m", f"σx {sx:.4f} m", f"σy {sy:.4f} m",
        f"σθ {st:.4f} rad", f"ρxy {rho:.2f}".replace("-", "−"),
    ):  # fmt: skip
        assert words in text.replace("ρxy -", "ρxy −"), (words, text)
    # a click there brings the slider to the step
    for kind in ("mousePressed", "mouseReleased"):
        opened.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    opened.wait_for(f"document.getElementById('step').value === '{k}'")
    assert re.match(rf"step {k} of ", opened.evaluate("document.getElementById('moment').textContent"))


def test_hover_shows_no_zero_for_unknown_values(browser: Chromium, comparison: Comparison, tmp_path: Path) -> None:
    log = comparison.log
    assert log.true_poses is not None
    some = log.true_poses.copy()
    some[:5] = float("nan")
    write_report(Comparison(log.replace(true_poses=some), (comparison["fastslam1"],)), tmp_path / "page.html")
    browser.events.clear()
    browser.open(tmp_path / "page.html")
    texts = browser.evaluate("document.getElementById('map').data.find((t) => t.meta.layer === 'path').text")
    assert "error not known" in texts[4] and "error not known" not in texts[5]
    assert "covariance not known" in texts[5]
    assert browser.complaints() == []


@pytest.mark.parametrize("width", [1280, 800, 400])
def test_nothing_sticks_out_or_overlaps(opened: Chromium, width: int) -> None:
    opened.resize(width, 900)
    draw_all(opened)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    # tables and pairs of panels scroll on a phone
    inside = "[...document.querySelectorAll('.wide')].every((e) => e.scrollWidth <= e.clientWidth)"
    assert width == 400 or opened.evaluate(inside)
    # the words of each figure: ticks, titles, legend
    overlapping = opened.evaluate("""(() => {
        const found = [];
        for (const figure of document.querySelectorAll(".figure")) {
            const edge = figure.getBoundingClientRect();
            const texts = [...figure.querySelectorAll(".xtick text, .ytick text, .x2tick text, .y2tick text, "
                + ".infolayer text")].filter((t) => t.textContent.trim() && t.getClientRects().length);
            const boxes = texts.map((t) => t.getBoundingClientRect());
            boxes.forEach((a, i) => {
                if (a.left < edge.left - 1 || a.right > edge.right + 1 || a.bottom > edge.bottom + 1 || a.top < edge.top - 1)
                    found.push(figure.id + ": " + texts[i].textContent + " sticks out");
                boxes.slice(0, i).forEach((b, j) => {
                    if (a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1)
                        found.push(figure.id + ": " + texts[i].textContent + " on " + texts[j].textContent);
                });
            });
        }
        return found;
    })()""")
    assert overlapping == []
