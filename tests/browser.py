"""A headless browser for the tests of pages; they are skipped where there is none."""

from __future__ import annotations

import atexit
import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-unsafe-swiftshader"
).split()
PATIENCE = 180_000  # ms; a busy machine without a graphics card draws slowly
SCREENSHOTS = Path(__file__).resolve().parents[1] / "out" / "screenshots"


@dataclass
class Opened:
    """A page, what went wrong in it, and what it asked the network for."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def picture(self, selector: str = "canvas") -> np.ndarray:
        """What an element shows (H, W, 3)."""
        # Of the page, cut to the element: a picture of the element alone waits until it stands still, which takes long
        # where the picture is drawn in software.
        area = self.page.locator(selector).first.bounding_box(timeout=PATIENCE)
        data = self.page.screenshot(clip=area, timeout=PATIENCE)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def keep(self, name: str) -> None:
        """A screenshot under out/screenshots, to be looked at."""
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=str(SCREENSHOTS / name), timeout=PATIENCE)


@cache
def chromium() -> Any:
    """The one browser of all tests of a process: a start costs more than most tests of a page do."""
    playwright = pytest.importorskip("playwright.sync_api", reason="browser tests need the package playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("browser tests need Chromium (Debian: apt install chromium)")
    running = playwright.sync_playwright().start()
    atexit.register(running.stop)
    browser = running.chromium.launch(executable_path=program, args=FLAGS)
    atexit.register(browser.close)
    return browser


@contextmanager
def opened(address: str, width: int = 1200, height: int = 800, offline: bool = False) -> Iterator[Opened]:
    """A page in headless Chromium, which shares nothing with other pages.

    Args:
        offline: no network at all.
    """
    context = chromium().new_context(viewport={"width": width, "height": height}, offline=offline)
    try:
        found = Opened(context.new_page())
        found.page.set_default_timeout(PATIENCE)
        found.page.on("pageerror", lambda error: found.errors.append(str(error)))
        found.page.on("console", lambda message: found.errors.append(message.text) if message.type == "error" else None)
        found.page.on("request", lambda request: found.requests.append(request.url))
        found.page.goto(address, timeout=PATIENCE)
        yield found
    finally:
        context.close()


def wait_until(page: Any, condition: str, timeout: float = PATIENCE) -> None:
    """Waits, ms, for a condition in JavaScript. It is asked from here: the policy of our pages lets nothing, not even
    the browser's driver, evaluate text inside them."""
    end = time.monotonic() + timeout / 1000
    while not page.evaluate(condition):
        assert time.monotonic() < end, f"never came true: {condition}"
        page.wait_for_timeout(50)
