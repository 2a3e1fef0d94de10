"""The report in a real browser: it draws everything, fetches nothing, and prints."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from discrepancy.report import report
from tests.discrepancy.ranked import DEVICES, ranked

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report(*ranked()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(browser: BrowserContext, file: Path) -> Iterator[Page]:
    """The report, opened from a file; fails on any error, complaint or request."""
    page = browser.new_page()
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(f"error: {error}"))
    page.on(
        "console",
        lambda said: said.type == "error" and troubles.append(f"console: {said.text}"),
    )
    page.on(
        "request",
        lambda request: (
            request.url.startswith((file.as_uri(), "data:", "blob:"))
            or troubles.append(f"fetched: {request.url}")
        ),
    )
    page.goto(file.as_uri())
    page.wait_for_function("document.querySelectorAll('.plot-container').length >= 7")
    yield page
    page.close()
    assert not troubles


def test_every_figure_is_drawn(page: Page) -> None:
    drawn = page.evaluate(
        "Array.from(document.querySelectorAll('[data-figure]'))"
        ".map(p => [p.data.length, p.querySelectorAll('.main-svg').length])"
    )
    assert len(drawn) == 7
    assert all(traces > 0 and pictures > 0 for traces, pictures in drawn)
    names = page.locator("[data-figure=figure-1] .ytick text").all_text_contents()
    assert names[:2] == list(DEVICES)  # as text, not as bold type
    titles = page.locator("[data-figure=figure-2] .annotation").all_text_contents()
    assert [title.strip() for title in titles] == list(DEVICES)


@pytest.mark.parametrize("width", [900, 710])  # of a screen, and of A4
def test_nothing_is_wider_than_the_paper(page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(media="print" if width == 710 else "screen")
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_it_prints_on_a4(page: Page) -> None:
    paper = page.pdf(prefer_css_page_size=True)
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", paper)
    assert 3 <= len(boxes) <= 10
    for box in boxes:  # points
        assert [float(size) for size in box] == pytest.approx([595, 842], abs=1)
