"""docs/measurement-format.md says what the reader does, and its example is real."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from discrepancy.columns import DESIGN_NAMES, NUMBERS, TEXTS
from discrepancy.measurement import UNLOADING, Tolerances
from discrepancy.reading import MeasurementError, read_measurements
from examples.bench import DEVICES, DIGIT, FILE, HIDDEN, make

from .benches import write

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/measurement-format.md").read_text()


def test_every_column_is_documented() -> None:
    rows = [line.split("|")[1] for line in TEXT.splitlines() if line.startswith("| `")]
    named = set(re.findall(r"`(\w+)`", "".join(rows)))
    columns = {column.name for column in NUMBERS.values()} | set(TEXTS)
    rare = {"inflation_lower_std_mm", "cavity_volume_std_uL"}  # the row's "..."
    assert columns - rare <= named
    assert named - columns == set(vars(Tolerances()))


@pytest.mark.parametrize("field", [*DESIGN_NAMES, "pressure"])
def test_ranges_are_those_of_the_reader(field: str) -> None:
    column = NUMBERS[field]
    low, high = (column.bench.from_si(v) for v in (column.lower, column.upper))
    assert f"| `{column.name}` | {low:g} to {high:g} |" in TEXT


def test_the_error_shown_is_the_error_raised(tmp_path: Path) -> None:
    loads = [{"pressure_kPa": str(p)} for p in (5, 10, 15, 20, 25)]
    wrong = [{"pressure_kPa": str(p), "inflation_mm": "200"} for p in (30, 35, 40)]
    path = write(tmp_path, *loads, *wrong)
    with pytest.raises(MeasurementError) as caught:
        read_measurements(path)
    assert str(caught.value).replace(f"{tmp_path}/", "") in TEXT


def test_the_shipped_example() -> None:
    found = read_measurements(FILE)
    assert found.warnings == () and found.devices == tuple(DEVICES)
    kinds = [curve.specimen for curve in found.curves]
    assert kinds == ["actuator"] * 5 + ["bulge", "tensile"]
    assert [curve.run for curve in found.curves[:2]] == [1, 2]
    assert (found.curves[1].branch == UNLOADING).sum() == 4
    assert [batch.modulus for batch in found.batches] == [2.5e6, 4.5e6]


def test_the_example_is_what_its_script_makes() -> None:
    """The first device's curves; the others follow by the same lines."""
    name = next(iter(DEVICES))
    made = make(HIDDEN, 1, {name: DEVICES[name]})
    shipped = read_measurements(FILE).subset([name])
    for one, other in zip(made.curves, shipped.curves, strict=True):
        assert one.outputs == other.outputs
        digit = np.array([DIGIT[output] for output in one.outputs])
        assert (np.abs(one.values - other.values) < 1.5 * digit).all()
        np.testing.assert_allclose(one.std, other.std, rtol=1e-12)


def test_the_example_hides_what_it_says() -> None:
    """Seen where pressure has little say: the tip is up before the balloon is large."""
    name = next(iter(DEVICES))
    with_it, without = (make(h, 1, {name: DEVICES[name]}) for h in (HIDDEN, {}))
    shift = with_it.curves[0].output("tip_deflection")[0]
    shift -= without.curves[0].output("tip_deflection")[0]
    assert shift > 10 * with_it.curves[0].std[0, 0]
