"""Fixtures of the tests of figures that readers move."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

import pytest
from chromium import Chromium, Quiet
from live_pages import BROWSER, FIGURE, PAGE, ROOT, SITE, Open


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of the scripts and the engine alone."""
    import live

    wasm = ["make", "-C", ROOT / "engine" / "wasm", "-j2", f"PYTHON={sys.executable}", f"BUILD={live.ENGINE[0].parent}"]
    done = subprocess.run(wasm, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path_factory.mktemp("site")
    shutil.copytree(SITE, site / "_site", ignore=shutil.ignore_patterns("*.py", "katex", "__pycache__"))
    live.copy_files(site)
    return site


@pytest.fixture(scope="module")
def open_page(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Open]:
    """Open a page with one figure, given as in a marker, and wait until it is ready."""
    import live

    assert BROWSER is not None
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with Chromium(BROWSER, tmp_path_factory.mktemp("profile")) as browser:

        def opened(*arguments: str, language: str = "en", until: str = f"{FIGURE}.matches('.ready')") -> Chromium:
            figure = live.figure([*arguments, "A figure."])
            (folder / "page.html").write_text(PAGE.format(language=language, figure=figure))
            browser.events.clear()
            browser.send("Network.setCacheDisabled", cacheDisabled=True)
            browser.send("Page.navigate", url=f"http://127.0.0.1:{server.server_port}/page.html")
            browser.wait_for(f"document.readyState === 'complete' && {FIGURE} && {until}")
            return browser

        yield opened
    server.shutdown()
    server.server_close()
