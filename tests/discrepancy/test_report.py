"""The report: one valid HTML file that fetches nothing and says everything."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import escape, unescape
from html.parser import HTMLParser

import pytest

from discrepancy.report import report
from discrepancy.words import verdict
from tests.discrepancy.ranked import DEVICES, SOURCE, WARNING, ranked
from tests.discrepancy.test_figures import tie

VOID = {"meta", "br", "link", "img", "input", "hr"}
ALLOWED = {
    *("html", "head", "meta", "title", "style", "body", "main", "script", "noscript"),
    *("h1", "h2", "p", "table", "thead", "tbody", "tr", "th", "td", "strong", "br"),
    *("span", "figure", "div", "figcaption", "ul", "ol", "li", "code"),
}
"""Tags that the report writes; any other is one that came in from outside."""


class Page(HTMLParser):
    """Reads a page strictly: tags close in the order in which they opened."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.words: list[str] = []
        self.style = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append((self.tags[-1][1], data))
        elif self.open and self.open[-1] == "style":
            self.style += data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def text() -> str:
    study, ranking = ranked()
    judged = replace(
        ranking, unjudged={"mullins": "no <time>"}, warnings=("late & low",)
    )
    return report(
        study,
        judged,
        fails_where="Above 35 kPa <all> devices.",
        next_measurement="bulge test & more",
        seed=17,
    )


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_it_is_one_page_of_known_tags(text: str, page: Page) -> None:
    assert text.startswith("<!DOCTYPE html>")
    assert {tag for tag, _ in page.tags} <= ALLOWED
    assert [tag for tag, _ in page.tags].count("h1") == 1
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(set(ids)) == len(ids)


def test_nothing_is_fetched(page: Page) -> None:
    for _, attrs in page.tags:
        assert not {"src", "href", "srcset", "data", "action", "poster"} & set(attrs)
    assert "url(" not in page.style and "@import" not in page.style
    rules = [a["content"] for _, a in page.tags if a.get("http-equiv")]
    assert len(rules) == 1 and str(rules[0]).startswith("default-src 'none';")
    assert "http" not in str(rules[0])
    addresses = re.compile(r"https?://")
    assert not addresses.search(page.style) and not addresses.search(page.text)
    for attrs, script in page.scripts:
        if "id" in attrs or len(script) < 10_000:  # all but Plotly's own
            assert not addresses.search(script)


def test_plotly_is_there_once(page: Page) -> None:
    assert sum(len(script) > 1_000_000 for _, script in page.scripts) == 1
    drawing = page.scripts[-1][1]
    assert "Plotly.newPlot" in drawing


def test_every_place_has_its_figure(page: Page) -> None:
    places = [a["data-figure"] for _, a in page.tags if "data-figure" in a]
    stored = {a["id"]: json.loads(s) for a, s in page.scripts if "id" in a}
    assert places == list(stored)
    titles = [figure["layout"]["title"]["text"] for figure in stored.values()]
    assert titles == [
        "How probable each explanation is",
        "Where the baseline fails: measured less predicted",
        "Tip deflection: measured and predicted",
        "Inflation of the roof: measured and predicted",
        "Tip deflection: what each candidate would explain",
        "Inflation of the roof: what each candidate would explain",
        "Could these readings tell the explanations apart?",
    ]
    assert stored["figure-1"]["layout"]["yaxis"]["ticktext"][0] == "&lt;b&gt;"
    assert all(figure["layout"]["width"] < 711 for figure in stored.values())


def test_names_from_outside_are_text(text: str, page: Page) -> None:
    for outside in (*DEVICES[:1], SOURCE, WARNING, "<all>", "<time>"):
        assert outside not in text
    assert escape(SOURCE) in text
    assert WARNING in page.text and SOURCE in page.text
    assert "late & low" in page.text


def test_it_says_everything(page: Page) -> None:
    _, ranking = ranked()
    said = " ".join(verdict(ranking, "bulge test & more").split())
    assert said in page.text
    for words in (
        "pressure_offset",
        "nothing missing",
        "an effect without a name",
        f"{ranking.baseline_error:.2f} times the noise",
        f"{ranking.candidate('pressure_offset').heldout_error:.2f}",
        "-0.01 to 0.01",
        "Above 35 kPa <all> devices.",
        "mullins",
        "no <time>",
        "ab" * 32,
        "2 devices, 2 curves, 11 readings; 2 effects judged",
    ):
        assert words in page.text, words
    assert "Seed 17" in page.text
    assert "log odds -2" in page.text


def test_a_tie_is_in_the_table() -> None:
    study, ranking = ranked()
    tied = Page(report(study, tie(ranking)))
    assert "tied with pressure_offset" in tied.text
    assert ("p", {"class": "verdict tied"}) in tied.tags
    for absent in ("What to measure next", "What could not be judged"):
        assert absent not in tied.text
    assert "tied with" not in Page(report(study, ranking)).text


def test_escaping_keeps_what_was_written(text: str) -> None:
    title = re.search("<title>(.*?)</title>", text)
    assert title is not None
    assert unescape(title[1]) == f"Which physics is missing: {SOURCE}"
