"""Figures: valid Plotly, true to scale, true to the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from fastapi.testclient import TestClient

from datagen.device import named_device
from datagen.errors import InputError
from service.figures import device_figure, response_figure
from tests.service.test_predict import S1, ask


def boxes(figure: dict[str, Any]) -> np.ndarray:
    """(b, 4) array of x0, y0, x1, y1, mm, of all shapes."""
    return np.array(
        [[s["x0"], s["y0"], s["x1"], s["y1"]] for s in figure["layout"]["shapes"]]
    )


@pytest.mark.parametrize("name", ["S1", "D8-1x1", "D8-4x1", "D8-4x2", "D8-3x3"])
def test_the_drawing_has_the_sizes_of_the_device(name: str) -> None:
    design = named_device(name)
    figure = device_figure(design)
    go.Figure(figure)
    assert figure["layout"]["yaxis"]["scaleanchor"] == "x"
    drawn = boxes(figure)
    size = np.abs(drawn[:, 2:] - drawn[:, :2]) * 1e-3
    along, across = design.balloon_size
    from_above = np.isclose(size, [along, across]).all(axis=1)
    assert from_above.sum() == design.divisions_x * design.divisions_y
    cut = np.isclose(size, [along, design.cavity_height]).all(axis=1)
    assert cut.sum() == design.divisions_x
    for thickness in (design.upper_thickness, design.lower_thickness):
        assert np.isclose(size, [design.length, thickness]).all(axis=1).sum() == 1
    balloons = drawn[from_above]
    assert balloons[:, 0].min() == pytest.approx(design.balloon_start * 1e3)
    assert balloons[:, 1].min() == pytest.approx(-balloons[:, 3].max())
    assert design.length * 1e3 - balloons[:, 2].max() == pytest.approx(
        design.tip_margin * 1e3
    )
    # The views do not overlap, and the paper holds them.
    low, high = figure["layout"]["yaxis"]["range"]
    assert drawn[:, [1, 3]].min() > low
    assert drawn[:, [1, 3]].max() < high
    top_of_cut = drawn[cut][:, 3].max()
    assert top_of_cut < balloons[:, 1].min()


def test_curves_show_value_and_interval(client: TestClient) -> None:
    answer = ask(client, S1, [20, 0, 10]).json()
    figure = response_figure([answer], ["inflation_mm"])
    go.Figure(figure)
    low, high, line = figure["data"]
    assert line["x"] == [0, 10, 20]  # a curve runs from left to right
    order = [1, 2, 0]
    inflation = answer["inflation_mm"]
    assert line["y"] == [inflation["value"][i] for i in order]
    assert low["y"] == [inflation["low"][i] for i in order]
    assert high["y"] == [inflation["high"][i] for i in order]
    assert high["fill"] == "tonexty"
    assert "mm" in figure["layout"]["yaxis"]["title"]["text"]


def test_surrogate_and_finite_elements_side_by_side(client: TestClient) -> None:
    answers = [ask(client, S1).json(), ask(client, S1, source="fem").json()]
    body = {"answers": answers, "quantities": ["tip_deflection_mm", "inflation_mm"]}
    figure = client.post("/v1/figures/response", json=body).json()
    go.Figure(figure)
    named = [trace["name"] for trace in figure["data"] if trace.get("showlegend")]
    assert named == ["Surrogate, 90 % interval", "Finite elements"]
    assert {trace["yaxis"] for trace in figure["data"]} == {"y", "y2"}
    first, second = (figure["layout"][axis]["domain"] for axis in ("yaxis", "yaxis2"))
    assert second[1] < first[0]  # the panels do not overlap
    assert figure["layout"]["xaxis"]["anchor"] == "y2"


def test_unknown_quantity(client: TestClient) -> None:
    with pytest.raises(InputError, match="inflation_mm"):
        response_figure([], ["volume"])
    body = {"answers": [ask(client, S1).json()], "quantities": ["volume"]}
    response = client.post("/v1/figures/response", json=body)
    assert response.json()["error"]["field"] == "quantities"


def test_lists_of_different_lengths(client: TestClient) -> None:
    answer = ask(client, S1).json()
    answer["inflation_mm"]["low"].pop()
    response = client.post("/v1/figures/response", json={"answers": [answer]})
    assert response.status_code == 422
    assert response.json()["error"]["field"] == "inflation_mm"


def test_the_drawing_over_http(client: TestClient) -> None:
    design = {"device": "D8-4x2"}
    figure = client.post("/v1/figures/device", json=design).json()
    assert figure == device_figure(named_device("D8-4x2"))
