"""The page in a real browser: what a designer sees, types, presses and downloads."""

from __future__ import annotations

import csv
import io
import json
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.service.fake_server import settings
from tests.service.fakes import FakeSurrogate

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    import uvicorn

    from service.app import create_app

    app = create_app(
        settings(tmp_path_factory.mktemp("state")), lambda _folder: FakeSurrogate()
    )
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    deadline = time.monotonic() + 30
    while not server.started:
        assert time.monotonic() < deadline and thread.is_alive()
        time.sleep(0.02)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


@pytest.fixture
def page(browser: BrowserContext, address: str) -> Iterator[Page]:
    """The page after its first prediction; fails on any error or foreign request."""
    page = browser.new_page()
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(f"error: {error}"))
    page.on(
        "request",
        lambda request: (
            request.url.startswith((address, "data:", "blob:"))
            or troubles.append(f"fetched from elsewhere: {request.url}")
        ),
    )
    page.goto(address)
    page.wait_for_selector("#table table")
    yield page
    page.close()
    assert not troubles


def curve(page: Page, index: int = -1) -> list[float]:
    """y values that Plotly has drawn."""
    script = "([i]) => Array.from(document.getElementById('curves').data.at(i).y)"
    values: list[float] = page.evaluate(script, [index])
    return values


def waits_for(page: Page, selector: str, text: str) -> None:
    page.locator(selector, has_text=text).wait_for()


def test_the_first_look_is_a_prediction_of_the_published_device(page: Page) -> None:
    assert page.input_value("#device") == "S1"
    assert page.input_value("#upper_thickness_um") == "95"
    waits_for(page, "#source", "Surrogate")
    waits_for(page, "#range", "inside the trained range")
    assert page.locator("#table tbody tr").count() == 13
    assert len(curve(page)) == 13
    assert page.locator("#drawing .shapelayer path").count() >= 6
    assert "4 \u00d7 1 mm" in page.inner_text("#derived")


def test_a_change_is_predicted_at_once(page: Page) -> None:
    before = curve(page)
    page.fill("#upper_thickness_um", "190")  # the fake's answers are proportional to it
    page.wait_for_function(
        "y => document.getElementById('curves').data.at(-1).y.at(-1) > y * 1.5",
        arg=before[-1],
    )
    assert curve(page) == pytest.approx([2 * y for y in before])
    assert "upper_thickness_um=190" in page.url


def test_the_address_carries_the_design(page: Page, address: str) -> None:
    page.goto("about:blank")
    page.goto(f"{address}/#device=D8-4x2&case=2&cavity_height_um=50&to=20&step=10")
    page.wait_for_selector("#table table")
    assert page.input_value("#device") == "D8-4x2"
    assert page.input_value("#cavity_height_um") == "50"
    assert page.input_value("#upper_modulus_MPa") == "4.5"
    assert page.locator("#table tbody tr").count() == 3
    assert "4 \u00d7 2 balloons" in page.inner_text("#derived")


def test_a_bad_value_is_explained_at_its_field(page: Page) -> None:
    page.fill("#upper_thickness_um", "-5")
    waits_for(page, "#upper_thickness_um-error", "a number from 10 to 2000 um")
    assert page.get_attribute("#upper_thickness_um", "aria-invalid") == "true"
    assert page.is_disabled("#csv")
    page.fill("#upper_thickness_um", "")
    waits_for(page, "#upper_thickness_um-error", "needed: a number")
    page.fill("#upper_thickness_um", "95")
    page.wait_for_selector("#csv:enabled")
    assert page.is_hidden("#upper_thickness_um-error")
    page.fill("#balloon_length_mm", "9")
    waits_for(page, "#length_mm-error", "at least 10.27 mm")
    page.fill("#balloon_length_mm", "4")
    page.fill("#step", "0.001")
    waits_for(page, "#pressure-error", "at most 1000")


def test_out_of_range_says_why_and_asks_the_finite_elements(page: Page) -> None:
    page.fill("#lower_thickness_um", "1900")  # the fake takes 1.9 s for it
    waits_for(page, "#range", "outside the trained range")
    waits_for(page, "#reasons", "lower_thickness is outside the trained range")
    assert page.is_hidden("#source")
    assert page.is_disabled("#csv")
    page.click("#predict")
    page.wait_for_selector("#job .spinner", state="visible")
    waits_for(page, "#source", "Finite elements")
    waits_for(page, "#summary", "4321 unknowns")
    assert page.is_hidden("#job")
    assert page.is_enabled("#csv")


def test_a_job_can_be_cancelled(page: Page) -> None:
    page.fill("#lower_thickness_um", "1901")
    waits_for(page, "#range", "outside the trained range")
    page.click("#predict")
    waits_for(page, "#job-text", "Finite elements at work, ")
    page.click("#cancel")
    waits_for(page, "#summary", "Cancelled.")
    assert page.is_hidden("#job")


def test_a_cancelled_check_leaves_the_surrogates_answer(page: Page) -> None:
    page.fill("#upper_thickness_um", "96")
    page.wait_for_selector("#csv:enabled")
    page.route(
        re.compile("/v1/predict"),
        lambda route, request: (
            route.continue_(
                post_data=json.dumps(
                    {
                        **request.post_data_json,
                        "design": {
                            **request.post_data_json["design"],
                            "lower_thickness_um": 1903,
                        },
                    }
                )
            )
            if request.post_data_json.get("source") == "fem"
            else route.continue_()
        ),
    )
    page.click("#fem")
    waits_for(page, "#job-text", "Finite elements at work, ")
    page.click("#cancel")
    page.wait_for_selector("#job", state="hidden")
    assert page.is_enabled("#csv")
    assert page.inner_text("#source") == "Surrogate"


def test_what_is_shown_says_nothing_of_what_is_up_to_date(page: Page) -> None:
    page.fill("#lower_thickness_um", "1900")
    waits_for(page, "#range", "outside the trained range")
    page.check("#show-bending_angle_deg")
    page.wait_for_function("() => document.getElementById('curves').layout.yaxis3")
    assert page.inner_text("#range") == "outside the trained range"
    assert page.is_disabled("#csv")
    assert page.evaluate("document.getElementById('curves').classList.contains('old')")


def test_a_change_leaves_a_running_job_behind(page: Page) -> None:
    page.fill("#lower_thickness_um", "1902")
    waits_for(page, "#range", "outside the trained range")
    page.click("#predict")
    waits_for(page, "#job-text", "Finite elements at work")
    with page.expect_response(
        lambda answer: answer.request.method == "DELETE"
    ) as cancelled:
        page.fill("#lower_thickness_um", "140")
    assert cancelled.value.json()["status"] in ("cancelled", "cancelling")
    waits_for(page, "#source", "Surrogate")
    page.wait_for_timeout(2500)  # the job would end meanwhile
    assert page.inner_text("#source") == "Surrogate"


def test_finite_elements_beside_the_surrogate_and_more_quantities(page: Page) -> None:
    page.click("#fem")
    waits_for(page, "#source", "Finite elements")
    legend = page.locator("#curves .legendtext").all_text_contents()
    assert legend == ["Surrogate, 90 % interval", "Finite elements"]

    page.check("#show-bending_angle_deg")
    page.wait_for_function("() => document.getElementById('curves').layout.yaxis3")
    titles = page.locator("#curves .g-ytitle, #curves .g-y2title, #curves .g-y3title")
    assert titles.count() == 3


def test_download(page: Page, tmp_path: Path) -> None:
    with page.expect_download() as download:
        page.click("#csv")
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    rows = list(csv.DictReader(io.StringIO(file.read_text())))
    assert len(rows) == 13
    assert rows[2]["pressure_kPa"] == "10"
    assert rows[2]["upper_thickness_um"] == "95"
    assert (rows[2]["source"], rows[2]["model_version"]) == ("surrogate", "fake-1")
    low, value, high = (
        float(rows[2][f"tip_deflection_mm{end}"]) for end in ("_low", "", "_high")
    )
    assert low < value < high


def test_keyboard_and_labels(page: Page) -> None:
    page.focus("#device")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "case"
    page.keyboard.press("Tab")
    page.keyboard.type("7")
    page.focus("#length_mm")
    page.keyboard.press("Enter")  # the form is sent, the page stays
    waits_for(page, "#source", "Surrogate")
    assert page.locator("h1").count() == 1
    script = """() => [...document.querySelectorAll("input, select")]
        .filter((node) => !node.labels.length).map((node) => node.id)"""
    assert page.evaluate(script) == []


def test_nothing_sticks_out_at_any_width(page: Page) -> None:
    for width in (360, 820, 1440):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_timeout(400)
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_server_that_has_gone_is_told(page: Page) -> None:
    page.route(re.compile("/v1/check"), lambda route: route.abort())
    page.fill("#upper_thickness_um", "96")
    waits_for(page, "#summary", "the server does not answer")
