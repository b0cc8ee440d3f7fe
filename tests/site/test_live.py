"""The figures that readers move, driven in a browser by mouse and keyboard, with numbers compared with Python."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Chromium
from live_pages import FIGURE, MARKS, Open, drag, switch

from graphslam import Graph, Log, MotionModel, SensorModel, load, solve, textbook
from graphslam.se2 import wrap
from graphslam.solvers.certificate import prove

pytestmark = MARKS


def graph_of(log: Log, shown: dict[str, Any], **options: Any) -> Graph:
    """The graph that a figure shows, of a log with the sightings of the figure, as `vmslam.js` takes them."""
    rows = np.array(shown["sightings"])
    log = replace(log, sightings=rows[:, 2:], steps=rows[:, 0].astype(int), landmarks=rows[:, 1].astype(int))
    return Graph.from_log(
        log, **({"edges": "virtual+motion", "weight": "pairs", "frame": "body", "kernel": "none"} | options)
    )


def agrees(page: Chromium, log: Log, **options: Any) -> float:
    """J of the figure, which Python computes for the same poses and measurements."""
    poses = np.array(page.evaluate(f"{FIGURE}.live.state.poses"))
    graph = graph_of(log, page.evaluate(f"{FIGURE}.live.log()"), **options)
    shown = float(page.evaluate(f"{FIGURE}.dataset.cost"))
    assert shown == pytest.approx(graph.cost(poses), rel=1e-9, abs=1e-9)
    return shown


@pytest.mark.parametrize("name", ["three_poses", "loop"])
def test_the_graph_has_the_numbers_of_python(open_page: Open, name: str) -> None:
    import live

    log = live.log(name)
    page = open_page("graph", name)
    start = agrees(page, log)
    stepped = solve(Graph.from_log(log, edges="virtual+motion", kernel="none"), initialize="given", max_iterations=1)
    page.click("figure.live button[data-name=step]")
    poses = np.array(page.evaluate(f"{FIGURE}.live.state.poses"))
    np.testing.assert_allclose(poses[:, :2], stepped.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(poses[:, 2] - stepped.poses[:, 2]), 0, atol=1e-9)
    # the page says that a step goes to where J is smaller
    assert agrees(page, log) < start
    page.click("figure.live button[data-name=all]")
    best = agrees(page, log)
    assert best == pytest.approx(solve(Graph.from_log(log, edges="virtual+motion", kernel="none")).cost, rel=1e-9)

    switch(page, "wrong")
    wrong = agrees(page, log)
    assert wrong > 1.2 * best
    switch(page, "kernel")
    assert agrees(page, log, kernel="cauchy") < wrong
    switch(page, "wrong")
    switch(page, "kernel")
    switch(page, "psi")
    agrees(page, log, dimensions=2)
    switch(page, "psi")
    if name == "three_poses":  # the other log falls into pieces without motion edges
        switch(page, "motions")
        assert agrees(page, log, edges="virtual") < best
        switch(page, "motions")
    switch(page, "ellipses")
    assert page.evaluate("document.querySelectorAll('.live-stage .ellipse').length") == log.num_poses
    assert page.complaints() == []


@pytest.mark.parametrize("name", ["three_poses", "loop"])
def test_frame_and_weight_are_those_of_python(open_page: Open, name: str) -> None:
    import live

    log = live.log(name)
    page = open_page("graph", name)
    agrees(page, log)
    switch(page, "world")
    agrees(page, log, frame="world")
    page.click("figure.live button[data-name=all]")
    agrees(page, log, frame="world")
    switch(page, "marginal")
    agrees(page, log, frame="world", weight="marginal")
    switch(page, "world")
    page.click("figure.live button[data-name=all]")
    best = agrees(page, log, weight="marginal")
    options = {"edges": "virtual+motion", "weight": "marginal", "kernel": "none"}
    assert best == pytest.approx(solve(Graph.from_log(log, **options)).cost, rel=1e-9)
    # as the pages say: J is smaller than with pairs, and the ellipses are larger
    pairs = solve(Graph.from_log(log, **(options | {"weight": "pairs"})))
    marginal = solve(Graph.from_log(log, **options))
    assert best < pairs.cost
    assert np.trace(pairs.covariance(log.num_poses - 1)) < np.trace(marginal.covariance(log.num_poses - 1))
    # one member for each landmark, drawn as rays to its mean
    squares = page.evaluate(f"{FIGURE}.live.costs().squares")
    assert len(squares) == 1 + (log.num_poses - 1) + len(set(log.landmarks.tolist()))
    switch(page, "wrong")
    switch(page, "kernel")
    agrees(page, log, weight="marginal", kernel="cauchy")
    switch(page, "psi")
    agrees(page, log, weight="marginal", kernel="cauchy", dimensions=2)
    assert page.complaints() == []


@pytest.mark.parametrize("name", ["three_poses", "loop"])
@pytest.mark.parametrize("weight", ["pairs", "marginal"])
def test_the_certificate_is_that_of_python(open_page: Open, name: str, weight: str) -> None:
    import live

    log = live.log(name)
    page = open_page("graph", name, *(["marginal=yes"] if weight == "marginal" else []))
    said = f"[{FIGURE}.dataset.proof, document.querySelector('.live-status').textContent]"

    def expected(**options: Any) -> str:
        poses = np.array(page.evaluate(f"{FIGURE}.live.state.poses"))
        return prove(graph_of(log, page.evaluate(f"{FIGURE}.live.log()"), weight=weight, **options), poses).status

    switch(page, "certificate")
    # dead reckoning is no minimum
    assert page.evaluate(said)[0] == expected() == "not proven"
    page.click("figure.live button[data-name=all]")
    status, text = page.evaluate(said)
    assert status == expected() == "global"
    assert "Proven: no poses have a lower J" in text
    # all poses moved together are as good, and only the anchor says where they are
    switch(page, "anchor")
    page.evaluate(f"""{{ const {{ live }} = {FIGURE};
        live.state.poses = live.state.poses.map(([x, y, heading]) => [x + 1, y, heading]); live.draw(); }}""")
    assert page.evaluate(said)[0] == "global"
    page.evaluate(f"{{ const {{ live }} = {FIGURE}; live.state.poses[1][0] += 0.3; live.draw(); }}")
    assert page.evaluate(said)[0] == "not proven"
    switch(page, "anchor")
    switch(page, "world")
    assert page.evaluate(said)[0] == expected(frame="world") == "not applicable"
    switch(page, "world")
    # as the pages say: a wrong sighting raises J, and the minimum is proven all the same
    switch(page, "wrong")
    page.click("figure.live button[data-name=all]")
    assert page.evaluate(said)[0] == expected() == "global"
    switch(page, "kernel")
    page.click("figure.live button[data-name=all]")
    assert page.evaluate(said)[0] == expected(kernel="cauchy") == "global for its weights"
    assert page.complaints() == []


def test_without_the_anchor_the_first_pose_stays_where_it_is_put(open_page: Open) -> None:
    import live

    log = live.log("loop")
    page = open_page("graph", "loop")
    page.click("figure.live button[data-name=all]")
    best = agrees(page, log)
    switch(page, "anchor")
    drag(page, ".handles g:nth-of-type(5) circle.pose", 40, 25)  # after four landmarks, the first pose
    first = page.evaluate(f"{FIGURE}.live.state.poses[0]")
    assert np.hypot(*(np.array(first) - log.initial_poses[0])[:2]) > 0.2
    # J without the term of the anchor
    poses, graph = (
        np.array(page.evaluate(f"{FIGURE}.live.state.poses")),
        graph_of(log, page.evaluate(f"{FIGURE}.live.log()")),
    )
    moved = poses[0] - log.initial_poses[0]
    anchor = 1e6 * moved @ moved
    assert float(page.evaluate(f"{FIGURE}.dataset.cost")) == pytest.approx(graph.cost(poses) - anchor, rel=1e-4)
    page.click("figure.live button[data-name=all]")
    assert float(page.evaluate(f"{FIGURE}.dataset.cost")) == pytest.approx(best, rel=1e-6)
    np.testing.assert_allclose(page.evaluate(f"{FIGURE}.live.state.poses[0]"), first, atol=1e-9)
    assert "no inverse" in page.evaluate("document.querySelector('.live-status').textContent")
    switch(page, "ellipses")
    assert page.evaluate("document.querySelectorAll('.live-stage .ellipse').length") == 0
    assert page.complaints() == []


def test_poses_and_landmarks_move_by_mouse_finger_and_keys(open_page: Open) -> None:
    import live

    log = live.log("three_poses")
    page = open_page("graph", "three_poses")
    before = agrees(page, log)
    poses = page.evaluate(f"{FIGURE}.live.state.poses")
    last, star = ".handles g:last-of-type circle.pose", ".handles g:first-of-type path.landmark"
    drag(page, last, 30, 10)
    moved = page.evaluate(f"{FIGURE}.live.state.poses")
    scale = page.evaluate(f"30 / ({FIGURE}.live.state.poses[2][0] - {poses[2][0]})")
    assert moved[2][1] - poses[2][1] == pytest.approx(-10 / scale, rel=0.1)
    assert agrees(page, log) != before
    drag(page, last, -30, -10, touch=True)
    assert page.evaluate(f"{FIGURE}.live.state.poses[2][0]") == pytest.approx(poses[2][0], abs=2 / scale)
    agrees(page, log)

    page.evaluate("document.querySelector('.handles g:last-of-type').focus()")
    x, _, heading = page.evaluate(f"{FIGURE}.live.state.poses[2]")
    page.press("ArrowRight", 39)
    assert page.evaluate(f"{FIGURE}.live.state.poses[2][0]") == pytest.approx(x + 0.05)
    page.send("Input.dispatchKeyEvent", type="rawKeyDown", key="ArrowLeft", windowsVirtualKeyCode=37, modifiers=8)
    assert page.evaluate(f"{FIGURE}.live.state.poses[2][2]") == pytest.approx(heading + 0.05)

    sightings = page.evaluate(f"{FIGURE}.live.log().sightings")
    drag(page, star, 20, 20)
    assert np.abs(np.array(page.evaluate(f"{FIGURE}.live.log().sightings")) - sightings).max() > 0.01
    agrees(page, log)
    assert page.complaints() == []


def test_the_kernel_keeps_the_poses_as_the_page_says(open_page: Open) -> None:
    page = open_page("graph", "loop", "mistaken=11")

    def poses() -> np.ndarray:
        page.click("figure.live button[data-name=all]")
        return np.array(page.evaluate(f"{FIGURE}.live.state.poses"))[:, :2]

    before = poses()
    switch(page, "wrong")
    assert round(np.linalg.norm(poses() - before, axis=1).max(), 1) == 0.7
    switch(page, "kernel")
    assert np.linalg.norm(poses() - before, axis=1).max() > 0.5  # another minimum
    switch(page, "wrong")
    assert np.linalg.norm(poses() - before, axis=1).max() < 0.3
    switch(page, "wrong")
    assert np.linalg.norm(poses() - before, axis=1).max() < 0.3


def test_captions_of_the_chapters_state_the_numbers_of_the_figures(open_page: Open) -> None:
    def cost(button: str) -> float:
        page.click(f"figure.live button[data-name={button}]")
        return float(page.evaluate(f"{FIGURE}.dataset.cost"))

    page = open_page("graph", "loop")  # problem.md
    assert (round(cost("reset"), 1), round(cost("all"), 1)) == (303.4, 28.7)
    page = open_page("graph", "three_poses", "motions=no")  # system.md, linearisation.md, motion-edges.md
    assert (round(cost("reset"), 3), round(cost("step"), 3)) == (6.053, 0.016)
    left = []
    for turn in (0.3, 2.0):
        assert cost("all") < 1e-9
        page.evaluate(f"{FIGURE}.live.state.poses[2][2] += {turn}, {FIGURE}.live.draw()")
        before = float(page.evaluate(f"{FIGURE}.dataset.cost"))
        left.append(cost("step") / before)
    assert left[0] < 1 / 100 and left[1] > 1 / 4
    cost("reset")
    switch(page, "motions")
    assert round(cost("all"), 3) == 1.718


def test_edges_that_leave_poses_free_are_said(open_page: Open) -> None:
    page = open_page("graph", "three_poses", "psi=no", "motions=no", language="ja")
    page.click("figure.live button[data-name=all]")
    assert "一意に決まりません" in page.evaluate("document.querySelector('.live-status').textContent")


def test_without_the_engine_the_text_remains(open_page: Open, folder: Path) -> None:
    hidden = (folder / "engine").rename(folder / "hidden")
    try:
        page = open_page("graph", "loop", until="document.querySelector('.live-missing') !== null")
        text = page.evaluate(f"{FIGURE}.innerText")
        assert "A figure." in text and "make docs" in text
    finally:
        hidden.rename(folder / "engine")


def test_a_page_that_is_opened_as_a_file_says_what_it_needs(open_page: Open, folder: Path) -> None:
    page = open_page("graph", "loop", language="ja")
    page.send("Page.navigate", url=(folder / "page.html").as_uri())
    page.wait_for("document.querySelector('.live-missing') !== null")
    assert "Webサーバ" in page.evaluate(f"{FIGURE}.innerText")
    page.events.clear()


def test_figures_fit_on_a_phone(open_page: Open) -> None:
    page = open_page("graph", "loop", language="ja")
    page.resize(390, 844)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.resize(1280, 900)


def test_covariances_are_those_of_python(open_page: Open) -> None:
    page = open_page("covariance", language="ja")

    def agree(misprint: bool) -> None:
        (x1, z1), (x2, z2) = (
            (np.array(s["pose"]), np.array(s["z"])) for s in page.evaluate(f"{FIGURE}.live.state.seen")
        )
        R1, R2 = textbook.sighting_derivative(x1, z1), textbook.sighting_derivative(x2, z2)
        Q1, Q2 = (textbook.sighting_covariance(z, SensorModel()) for z in (z1, z2))
        R2 = R1 if misprint else R2
        C = R1 @ Q1 @ R1.T + R2 @ Q2 @ R2.T
        shown = page.evaluate(f"{FIGURE}.live.places().sum")
        np.testing.assert_allclose(shown, C[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]], rtol=1e-9, atol=1e-12)

    agree(misprint=False)
    drag(page, ".handles g:nth-of-type(3) circle.end", 40, -25)
    drag(page, ".handles g:nth-of-type(2) circle.end", -20, 15)
    agree(misprint=False)
    switch(page, "misprint")
    agree(misprint=True)
    assert page.complaints() == []


def own_log(folder: Path) -> Log:
    """The log of the example's two tables alone, as Python reads them."""
    import live

    folder.mkdir()
    for file in live.TABLES:
        shutil.copy(file, folder)
    return load(folder)


@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_own_tables_have_the_solution_of_python(open_page: Open, tmp_path: Path, kernel: str) -> None:
    log = own_log(tmp_path / "robot")
    page = open_page("own")
    if kernel == "none":
        switch(page, "kernel")
    page.click("figure.live button[data-name=example]")
    page.wait_for(f"{FIGURE}.live.state.found != null")
    found = page.evaluate(f"{FIGURE}.live.state.found")
    graph = Graph.from_log(
        log,
        edges="virtual+motion",
        weight="marginal",
        frame="body",
        kernel=kernel,
        motion=MotionModel(),
        sensor=SensorModel(),
    )
    np.testing.assert_allclose(np.array(found["raw"])[:, :2], log.initial_poses[:, :2], atol=1e-9)
    poses = np.array(found["poses"])
    assert found["converged"] and len(poses) == log.num_poses
    assert found["J"] == pytest.approx(graph.cost(poses), rel=1e-9)
    solution = solve(graph.with_initial(poses))
    assert found["J"] == pytest.approx(solution.cost, rel=1e-9)
    np.testing.assert_allclose(poses[:, :2], solution.poses[:, :2], atol=1e-7)
    assert f"{log.num_poses} poses" in page.evaluate("document.querySelector('.live-status').textContent")
    # nothing leaves the computer: the page loads its own files only, and sends nothing
    requests = [e["params"]["request"] for e in page.events if e["method"] == "Network.requestWillBeSent"]
    assert {request["method"] for request in requests} == {"GET"}
    assert page.complaints() == []


GOOD = "t,nu,omega\n0,1,0\n1,1,0\n2,1,0\n"


@pytest.mark.parametrize(
    ("odometry", "sightings", "message"),
    [
        (GOOD, "t;id;range;bearing\n0;7;2,5;0,1\n1,5;7;1,5;0,2\n", ""),
        (GOOD, "t,id,range,bearing\n0,7,2,0.1\n1,7,x,0.2\n", 'z.csv:3: range is "x", which is no number'),
        (GOOD, "t,id,range\n0,7,2\n", "z.csv:1: no column is recognised as bearing; the columns are t, id, range"),
        (GOOD, "t,id,range,bearing\n0,7,2,30\n1,7,1,40\n", "z.csv:2: bearing is 30.0000 rad, beyond 2 pi"),
        (GOOD, "t,id,range,bearing\n1,7,2,0\n0,7,1,0\n", "z.csv:3: the time is before that of the row above"),
        (GOOD, "t,id,range,bearing\n100,7,2,0\n", "z.csv:2: no sighting of a landmark lies within the time"),
        (GOOD, "t,id,range,bearing\n0,7,-2,0\n", "z.csv:2: the range is -2, but must be positive"),
        ("t,nu,omega\n", "t,id,range,bearing\n0,7,2,0\n", "u.csv:1: a table needs a line with the names"),
    ],
)
def test_a_table_that_cannot_be_read_is_said_with_its_line(
    open_page: Open, odometry: str, sightings: str, message: str
) -> None:
    page = open_page("own")
    page.evaluate(f"""(async () => {{ const live = {FIGURE}.live;
        await live.take([new File([{json.dumps(odometry)}], "u.csv")]);
        await live.take([new File([{json.dumps(sightings)}], "z.csv")]); }})()""")
    status = page.evaluate("document.querySelector('.live-status').textContent")
    assert status.startswith(message or "J = ")
    assert page.complaints() == []
