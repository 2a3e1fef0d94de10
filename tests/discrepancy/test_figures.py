"""Figures of a ranking: valid Plotly, and the numbers they stand for."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest

from discrepancy import figures
from discrepancy.bands import MARGIN, calibrated_band
from discrepancy.evidence import Fit
from discrepancy.judging import Ranking
from discrepancy.noise import Frame
from discrepancy.study import Study
from tests.discrepancy.ranked import DEVICES, NOISE, PRESSURE, ranked

Array = np.ndarray
ESCAPED = ("&lt;b&gt;", "T &amp; U")


@pytest.fixture(scope="module")
def study() -> Study:
    return ranked()[0]


@pytest.fixture(scope="module")
def ranking() -> Ranking:
    return ranked()[1]


@pytest.fixture(scope="module")
def baseline(ranking: Ranking) -> Fit:
    return ranking.candidate("nothing").fit


def drawn(figure: dict[str, Any], **wanted: Any) -> list[dict[str, Any]]:
    """Traces with some properties, of a figure that Plotly accepts."""
    go.Figure(figure)
    return [
        trace
        for trace in figure["data"]
        if all(trace.get(key) == value for key, value in wanted.items())
    ]


def readings(study: Study, group: int, device: int) -> Array:
    """Which readings are those of one quantity of one device."""
    of = study.readings
    return np.flatnonzero((of.group == group) & (of.device == device))


@pytest.mark.parametrize("group", [0, 1])
def test_the_overlay_has_points_lines_and_bands(
    study: Study, ranking: Ranking, baseline: Fit, group: int
) -> None:
    best = ranking.best.fit
    figure = figures.overlay(study, group, baseline, best)
    points = drawn(figure, mode="markers")
    assert len(points) == len(DEVICES)
    for device, trace in enumerate(points):
        at = readings(study, group, device)
        curve = study.measurements.curves[device]
        there = np.isfinite(curve.values[:, group])
        assert trace["x"] == pytest.approx(PRESSURE[there] / 1e3)
        assert trace["y"] == pytest.approx(curve.values[there, group] * 1e3)
        bars = trace["error_y"]["array"]
        assert bars == pytest.approx([1.645 * NOISE[group] * 1e3] * len(at), rel=1e-3)
    for name, fit in (("Baseline, calibrated", baseline), ("With cure_mismatch", best)):
        lines = drawn(figure, name=name)
        low, high = calibrated_band(fit)
        for device, trace in enumerate(lines):
            at = readings(study, group, device)
            assert trace["y"] == pytest.approx(fit.predict()[at] * 1e3)
            bands = drawn(figure, legendgroup=None, yaxis=trace["yaxis"])
            assert len(bands) == 4
            ends = {tuple(np.round(band["y"], 12)) for band in bands}
            assert tuple(np.round(low[at] * 1e3, 12)) in ends
            assert tuple(np.round(high[at] * 1e3, 12)) in ends
    layout = figure["layout"]
    assert layout["xaxis"]["title"]["text"] == "Pressure (kPa)"
    unit = ("Tip deflection (mm)", "Inflation of the roof (mm)")[group]
    assert layout["yaxis"]["title"]["text"] == unit
    assert [note["text"] for note in layout["annotations"]] == [
        f"<b>{name}</b>" for name in ESCAPED
    ]
    assert not drawn(figures.overlay(study, group, baseline), name="With cure_mismatch")
    one = figures.overlay(study, group, baseline, devices=DEVICES[1:])
    assert len(drawn(one, mode="markers")) == 1


def test_a_band_is_the_posterior_of_the_calibrations(baseline: Fit) -> None:
    """For linear calibrations in closed form: A (I + A^T C^-1 A)^-1 A^T."""
    frame = Frame(baseline.readings)
    columns = baseline.hypothesis.predict(baseline.t).columns
    smooth = baseline.amplitude("smooth")
    share = np.array([smooth[int(g)] for g in frame.group])
    turned = frame.turn @ columns
    errors = np.diag(1 + share**2 * frame.smooth)
    whole = errors + turned @ turned.T
    left = np.eye(columns.shape[1]) - turned.T @ np.linalg.solve(whole, turned)
    std = np.sqrt(np.einsum("ij,jk,ik->i", columns, left, columns))
    low, high = calibrated_band(baseline, draws=20000)
    assert high - low == pytest.approx(2 * MARGIN * std, rel=0.05)
    assert (high + low) / 2 == pytest.approx(baseline.predict(), abs=0.1 * std.min())
    assert calibrated_band(baseline)[0] == pytest.approx(calibrated_band(baseline)[0])


def test_a_band_holds_what_sizes_leave_open(ranking: Ranking) -> None:
    best = ranking.best.fit
    fixed = replace(best, samples=np.zeros((0, 0)), weights=np.zeros(0))
    bands = (calibrated_band(fit, draws=20000) for fit in (best, fixed))
    widths = [high - low for low, high in bands]
    assert (widths[0] >= widths[1] * 0.9).all()
    assert widths[0].max() > widths[1].max()


def test_the_map_shows_residuals_in_noise(study: Study, baseline: Fit) -> None:
    figure = figures.residual_map(study, baseline)
    lack = (study.readings.value - baseline.predict()) / study.readings.noise
    strips = drawn(figure, type="heatmap")
    assert len(strips) == 4
    for i, strip in enumerate(strips):
        group, device = divmod(i, 2)
        at = readings(study, group, device)
        assert strip["z"][0] == pytest.approx(lack[at])
        edges = np.array(strip["x"])
        cells = np.digitize(figures.loads(study)[at] / 1e3, edges)
        assert cells.tolist() == list(range(1, len(at) + 1))
        assert strip["customdata"][0] == pytest.approx(figures.loads(study)[at] / 1e3)
        assert np.mean(strip["y"]) == pytest.approx(device)
        assert f"<extra>{ESCAPED[device]}</extra>" in strip["hovertemplate"]
    scale = figure["layout"]["coloraxis"]
    assert scale["cmin"] == -scale["cmax"] < 0
    assert scale["cmax"] == pytest.approx(np.percentile(np.abs(lack), 95))
    assert scale["colorscale"][2] == [0.5, "#f7f7f7"]
    assert figure["layout"]["yaxis"]["ticktext"] == list(ESCAPED)
    assert figure["layout"]["xaxis2"]["title"]["text"] == "Pressure (kPa)"


def test_readings_at_one_load_share_a_cell() -> None:
    strip = figures._strip(
        np.array([10.0, 30, 10]), np.array([1.0, 5, 3]), 0, "", "kPa"
    )
    assert strip["z"] == [[2, 5]]
    assert strip["x"] == [0, 20, 40]
    alone = figures._strip(np.array([10.0]), np.array([1.0]), 0, "", "kPa")
    assert alone["x"] == [9.5, 10.5]


def test_unloading_and_other_runs_have_rows_of_their_own(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = study.measurements.curves
    branch = np.array(["loading", "loading", "unloading"])
    curves = (
        replace(first, branch=branch),
        replace(second, run=3, orientation=math.pi),
    )
    changed = replace(study.measurements, curves=curves)
    monkeypatch.setattr(study, "measurements", changed)
    assert [(name, len(at)) for name, at in figures._rows(study, 1)] == [
        ("<b>", 2),
        ("<b>, unloading", 1),
        ("T & U, run 3, turned by 180 deg", 3),
    ]


def test_the_right_signature_runs_through_the_residual(
    study: Study, ranking: Ranking, baseline: Fit
) -> None:
    named = [ranking.candidate("cure_mismatch"), ranking.candidate("pressure_offset")]
    figure = figures.signatures(study, 0, baseline, named)
    noise = study.readings.noise
    points = drawn(figure, name="Measured less baseline")
    apart = {}
    for one in named:
        lines = drawn(figure, name=one.name)
        for device, (line, point) in enumerate(zip(lines, points, strict=True)):
            at = readings(study, 0, device)
            change = (one.fit.predict() - baseline.predict()) / noise
            lack = (study.readings.value - baseline.predict()) / noise
            assert line["y"] == pytest.approx(change[at])
            assert point["y"] == pytest.approx(lack[at])
            assert line["x"] == point["x"]
        lacks = [
            np.subtract(p["y"], q["y"]) for p, q in zip(lines, points, strict=True)
        ]
        apart[one.name] = float(np.abs(np.concatenate(lacks)).max())
    assert apart["cure_mismatch"] < 4 < 10 < apart["pressure_offset"]
    assert figure["layout"]["yaxis"]["title"]["text"] == "Change (noise std)"
    assert figure["layout"]["yaxis2"]["matches"] == "y"


def tie(ranking: Ranking) -> Ranking:
    """The same with its two named candidates tied."""
    names = ("cure_mismatch", "pressure_offset")
    shares = dict(zip(names, (0.6, 0.35), strict=True))
    candidates = [
        replace(
            one,
            probability=shares.get(one.name, 0.0125),
            tied_with=tuple(n for n in names if n != one.name)
            if one.name in names
            else (),
        )
        for one in ranking.candidates
    ]
    candidates.sort(key=lambda one: -one.probability)
    return replace(ranking, verdict="tied", effects=names, candidates=tuple(candidates))


def test_bars_are_probabilities_best_first(ranking: Ranking) -> None:
    (bars,) = drawn(figures.ranking_bars(ranking), type="bar")
    shown = bars["x"]
    assert shown[0] == pytest.approx(100 * ranking.best.probability)
    assert shown == sorted(shown, reverse=True)
    assert set(bars["marker"]["pattern"]["shape"]) == {""}
    tied = tie(ranking)
    figure = figures.ranking_bars(tied)
    (bars,) = drawn(figure, type="bar")
    assert bars["x"][:2] == pytest.approx([60, 35])
    assert bars["text"][:3] == ["60 % (tied)", "35 % (tied)", "1.2 %"]
    assert bars["marker"]["pattern"]["shape"][:3] == ["/", "/", ""]
    assert f"log odds {math.log(0.35 / 0.6):.1f}" in bars["customdata"][1]
    assert "tied with cure_mismatch" in bars["customdata"][1]
    axis = figure["layout"]["yaxis"]
    assert axis["ticktext"][:2] == ["cure_mismatch", "pressure_offset"]
    assert axis["range"][0] > axis["range"][1]  # the best one is at the top
    assert "nothing missing" in axis["ticktext"]


def test_rows_of_the_confusion_matrix_are_the_truth(ranking: Ranking) -> None:
    names = ("cure_mismatch", "nothing")
    lopsided = replace(
        ranking, confused=names, confusion=np.array([[0.9, 0.1], [0.3, 0.7]])
    )
    figure = figures.confusion_matrix(lopsided)
    (cells,) = drawn(figure, type="heatmap")
    assert cells["z"] == [pytest.approx([90, 10]), pytest.approx([30, 70])]
    assert cells["customdata"][1][0] == ["nothing missing", "cure_mismatch"]
    layout = figure["layout"]
    assert layout["yaxis"]["title"]["text"] == "If this were true,"
    assert layout["yaxis"]["ticktext"] == ["cure_mismatch", "nothing missing"]
    assert layout["yaxis"]["range"] == [1.5, -0.5]
