"""An adoption as one HTML file: ladder, before and after, sizes, what comes next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from .adopt import Adoption, emulation_error
from .adopt_figures import before_after, ladder_figure
from .figures import Figure
from .judging import Candidate
from .ladder import Rung
from .page import (
    count,
    document,
    errors,
    figure,
    heading,
    pages,
    paragraph,
    table,
)
from .sharpen import Sharpening
from .version import ModelVersion
from .words import INSIDE, in_words, sizes

SHOWN = 5
"""Measurements that are proposed."""

NONE = "\u2013"


def adopt_report(
    made: Adoption,
    version: ModelVersion,
    next_measurements: Sequence[Sharpening] = (),
    notes: Sequence[str] = (),
) -> str:
    """An adoption as one HTML file that opens anywhere, without a network, and prints.

    Parameters
    ----------
    made : Adoption
    version : ModelVersion
        That it made.
    next_measurements : sequence of Sharpening
        Best first.
    notes : sequence of str
        Warnings besides those of the adoption.

    Returns
    -------
    str
    """
    name = made.study.measurements.source or "measurements"
    title = f"{in_words(made.fit.hypothesis.name)} adopted: {name}"
    drawn: list[Figure] = []
    body = "\n".join(
        part
        for section in (
            _head(made, version, name),
            _ladder(made, drawn),
            _warnings(made, notes),
            _sizes(made),
            _figures(made, drawn),
            _next(next_measurements),
            errors(made.study, made.fit),
            _method(made),
            _versions(version),
        )
        for part in section
    )
    return document(title, body, drawn)


def _head(made: Adoption, version: ModelVersion, name: str) -> Iterator[str]:
    study = made.study
    devices = len(study.measurements.devices)
    yield f"<h1>{escape(in_words(made.fit.hypothesis.name))} in the model</h1>"
    yield paragraph(
        f"{name}: {count(devices, 'device')}, "
        f"{count(len(study.measurements.curves), 'curve')}, "
        f"{count(len(study.readings.value), 'reading')}; model version "
        f"{version.version}.",
        "muted",
    )
    first, last, floor = made.ladder[0], made.ladder[-2], made.ladder[-1]
    if last.heldout_error == last.heldout_error:
        change = last.heldout_error - first.heldout_error
        way = "falls" if change < 0 else "rises"
        words = (
            f"On devices that took no part in the fit the error {way} from "
            f"{first.heldout_error:.2f} to {last.heldout_error:.2f} times the noise; a "
            f"model with the right physics errs by about {floor.heldout_error:.2f}, "
            "since each new device has its own tolerances."
        )
    else:
        words = "There is one device only: nothing was left out to judge the fit by."
    kind = "identified" if last.helps else "tied"
    yield f'<p class="verdict {kind}">{escape(words)}</p>'


def _ladder(made: Adoption, drawn: list[Figure]) -> Iterator[str]:
    yield heading("The ladder")
    yield table(
        ("Model", "Held-out error", "90 % interval", "Times the rung before"),
        [
            (
                f"<strong>{escape(rung.name)}</strong>",
                _number(rung.heldout_error),
                _span(rung.low, rung.high),
                _ratio(rung),
            )
            for rung in made.ladder
        ],
        numbers=(1, 2, 3),
    )
    yield paragraph(
        "Root mean square of what is left on devices that took no part in the fit, in "
        "units of the noise; its interval is over devices (jackknife). That of the "
        "noise floor is where a right model errs in 90 % of sets of such devices.",
        "muted",
    )
    yield figure(
        drawn,
        ladder_figure(made.ladder),
        "Bars: 90 % intervals. Shaded: where the error of a model with the right "
        "physics lies. Baseline: everything as stated. Recalibrated: moduli, "
        "thicknesses and camera scales inferred within their tolerances.",
    )


def _number(value: float) -> str:
    return f"{value:.2f}" if value == value else NONE


def _span(low: float, high: float) -> str:
    return f"{low:.2f} to {high:.2f}" if low == low else NONE


def _ratio(rung: Rung) -> str:
    if rung.ratio != rung.ratio:
        return NONE
    return f"{rung.ratio:.2f} ({_span(rung.ratio_low, rung.ratio_high)})"


def _warnings(made: Adoption, notes: Sequence[str]) -> Iterator[str]:
    lines = dict.fromkeys((*made.study.measurements.warnings, *made.warnings, *notes))
    if lines:
        yield heading("Warnings")
        yield f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def _sizes(made: Adoption) -> Iterator[str]:
    yield heading("Sizes against the literature")
    yield table(
        ("Parameter", "Value \u00b1 std", "90 % interval", "Literature range"),
        [
            (
                escape(size.name),
                f"<strong>{escape(size.number)}</strong>",
                escape(size.interval),
                escape(size.range)
                + ("" if size.plausibility == INSIDE else f"<br>{escape(size.remark)}")
                + f'<br><span class="muted">{escape(size.source)}</span>',
            )
            for size in sizes(Candidate(made.fit, 1.0))
        ],
    )


def _figures(made: Adoption, drawn: list[Figure]) -> Iterator[str]:
    yield heading("Before and after")
    yield (
        "<noscript><p>The figures are drawn by the script in this file; the tables say "
        "the same without it.</p></noscript>"
    )
    for group in range(len(made.study.kinds)):
        for devices in pages(made.study, group):
            yield figure(
                drawn,
                before_after(made, group, devices),
                "Points: measured, their bars 90 % of the noise; open ones: unloading. "
                "As stated: finite elements of the devices as the file states them. "
                "Calibrated: moduli, thicknesses and camera scales inferred too; its "
                "band is 90 % of what calibrations and sizes leave open.",
            )


def _next(found: Sequence[Sharpening]) -> Iterator[str]:
    if not found:
        return
    yield heading("What to measure next")
    yield table(
        ("Measurement", "Parameter", "Its std would fall to"),
        [
            (escape(one.words), escape(one.best[0]), f"{100 * one.best[1]:.0f} %")
            for one in found[:SHOWN]
        ],
        numbers=(2,),
    )


def _method(made: Adoption) -> Iterator[str]:
    allowed = made.study.measurements.tolerances
    sentences = (
        "The effects are solved by finite elements at the measured devices, alone and "
        "together, until their curves are known at the best fit, and fitted to all "
        "curves at once, with priors of the width of their literature ranges.",
        "The stated values are not taken at their word: moduli of material batches "
        f"({100 * allowed.modulus:g} %), layer thicknesses "
        f"({1e6 * allowed.thickness:g} um) and camera scales "
        f"({100 * allowed.camera_scale:g} %) are inferred with the effects.",
        "Each rung's error is measured on one device at a time, which takes no part in "
        "the fit of effects and calibrations that predicts it; its own thicknesses are "
        "those stated.",
        "The corrected curves are finite elements at the posterior mean; the curves of "
        f"the fit are within {emulation_error(made):.2g} noise standard deviations of "
        "them.",
    )
    yield heading("Method")
    yield f"<ol>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ol>"


def _versions(version: ModelVersion) -> Iterator[str]:
    rows = [
        ("Model version", version.version),
        ("Parent", version.parent),
        *((f"Measurements, {one.name}", one.sha256) for one in version.measurements),
        ("pba", version.package),
        ("Commit", version.commit or "not known"),
        ("Generator version", version.generator),
        ("Mesh", f"baseline {version.level}, changes by effects {version.fast}"),
        ("Seed", str(version.seed)),
        ("Date", version.date or "not given"),
    ]
    yield heading("Versions")
    yield table(
        ("What", "Which"),
        [(escape(what), f"<code>{escape(which)}</code>") for what, which in rows],
        kind="named",
    )
