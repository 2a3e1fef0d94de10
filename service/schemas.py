"""Bodies of the HTTP interface, in bench units, with their bounds.

Bounds and units come from the tables of `datagen`, so that the published schema cannot
drift from what is accepted.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from datagen.device import CASES, LIMITS, Design
from datagen.errors import InputError
from datagen.response import OUTPUTS
from datagen.units import BY_FIELD, QUANTITY
from surrogate.budget import FEWEST_PATHS

from .bench import (
    DEFAULTS,
    MAX_STEPS,
    PRESSURE_RANGE,
    Words,
    bounds,
    check_case,
    design_from_bench,
)

MAX_WAIT = 600.0
"""s.  Longest time that a request may ask to wait for the finite elements."""

MAX_DESIGNS = 100_000
"""Designs that one dataset job may ask for."""


class Strict(BaseModel):
    """A body in which a misspelt field is an error, not a silent default."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known_names(cls, body: Any) -> Any:
        """Refuse an unknown name with the list of known ones."""
        if isinstance(body, dict):
            for name in body:
                if name not in cls.model_fields:
                    raise PydanticCustomError(
                        "unknown_field",
                        "unknown name {name}",
                        {
                            # JSON may hold halves of a character; pydantic may not.
                            "name": name.encode(errors="backslashreplace").decode(),
                            "allowed": ", ".join(cls.model_fields),
                        },
                    )
        return body


def _whole(value: object) -> object:
    """2.0 is the whole number 2; JSON of some languages has no other."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _absent() -> Any:
    """Of a field that may be left out; unlike null it has no place in the schema."""
    return None


def _column(field: str, words: str) -> Any:
    """A design column with its bounds; which ones are needed depends on `device`."""
    column = BY_FIELD[field]
    lower, upper = bounds(column)
    default = DEFAULTS.get(column.name)
    said = f", {default:g} where left out" if default is not None else ""
    return Field(
        default_factory=_absent,
        ge=lower,
        le=upper,
        strict=True,
        description=f"{words} ({column.unit or 'whole number'}{said})",
        title=words,
        json_schema_extra={"unit": column.unit or "1"},
    )


Whole = Annotated[int, BeforeValidator(_whole)]


class DesignIn(Strict):
    """A device: a named one with changes, or every column of its own."""

    device: str = Field(
        default_factory=_absent,
        max_length=40,
        description="S1 or D8-MxN; the columns given replace those of this device",
        json_schema_extra={"pattern": r"^(S1|D8-[1-9][0-9]*x[1-9][0-9]*)$"},
    )
    case: Whole = Field(
        default_factory=_absent,
        ge=min(CASES),
        le=max(CASES),
        strict=True,
        description="material case of the named device, 1 where left out",
    )
    length_mm: float = _column("length", "strip length")
    width_mm: float = _column("width", "strip width")
    balloon_length_mm: float = _column("balloon_length", "balloon length in total")
    balloon_width_mm: float = _column("balloon_width", "balloon width in total")
    balloon_start_mm: float = _column("balloon_start", "clamp to first balloon")
    wall_mm: float = _column("wall", "wall between balloons")
    divisions_x: Whole = _column("divisions_x", "balloons along")
    divisions_y: Whole = _column("divisions_y", "balloons across")
    cavity_height_um: float = _column("cavity_height", "cavity height")
    upper_thickness_um: float = _column("upper_thickness", "upper layer thickness")
    lower_thickness_um: float = _column("lower_thickness", "lower layer thickness")
    upper_modulus_MPa: float = _column("upper_modulus", "upper layer modulus")
    lower_modulus_MPa: float = _column("lower_modulus", "lower layer modulus")

    def design(self) -> Design:
        """The device that is meant.

        Raises
        ------
        InputError
            When a column is missing, or the balloons do not fit the strip.
        """
        values = self.model_dump(exclude_unset=True)
        device = values.pop("device", None)
        case = check_case(values.pop("case", 1))
        return design_from_bench(values, device, case)


DESIGN_COLUMNS = tuple(
    name for name in DesignIn.model_fields if name not in ("device", "case")
)

Pressures = Annotated[
    list[
        Annotated[float, Field(ge=PRESSURE_RANGE[0], le=PRESSURE_RANGE[1], strict=True)]
    ],
    Field(
        min_length=1,
        max_length=MAX_STEPS,
        description="gauge pressure at each load step (kPa)",
        json_schema_extra={"unit": "kPa"},
    ),
]

Level = Literal["draft", "standard", "fine"]


class CheckIn(Strict):
    """A design and its load steps."""

    design: DesignIn
    pressure_kPa: Pressures


class PredictIn(CheckIn):
    """A design, its load steps, and how the answer is to be made."""

    source: Literal["auto", "fem"] = Field(
        default="auto",
        description="auto: finite elements only where the surrogate was not trained",
    )
    level: Level = Field(default="standard", description="mesh of the finite elements")
    wait_s: float = Field(
        default_factory=_absent,
        ge=0,
        le=MAX_WAIT,
        description="how long to wait for the finite elements before answering 202 "
        "with a job (s); the server's own setting where left out",
    )


class DatasetIn(Strict):
    """A dataset to be generated."""

    designs: Whole = Field(ge=1, le=MAX_DESIGNS, strict=True)
    seed: Whole = Field(ge=0, le=2**53, strict=True)
    effects: list[str] = Field(default=[], max_length=20)
    level: Level = "standard"


MeasurementsId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class JudgedIn(Strict):
    """How measurements are to be judged."""

    level: Level = Field(default="standard", description="mesh of the baseline")
    modulus_tolerance_pct: float = Field(
        default=5.0, ge=0, le=50, description="std of each batch's modulus (%)"
    )
    thickness_tolerance_um: float = Field(
        default=3.0, ge=0, le=100, description="std of each layer's thickness (um)"
    )
    camera_tolerance_pct: float = Field(
        default=0.5, ge=0, le=20, description="std of the camera's scale (%)"
    )
    seed: Whole = Field(default=0, ge=0, le=2**31, strict=True)


class MeasuredIn(JudgedIn):
    """Measurements, and how they are to be judged."""

    measurements: MeasurementsId = Field(
        description="id that ``/v1/measurements`` answered"
    )


class RankingIn(MeasuredIn):
    """Measurements, and the effects that may be missing."""

    effects: list[str] = Field(
        default=[], max_length=100, description="candidates; empty: the catalogue"
    )


ModelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]


class AdoptionIn(JudgedIn):
    """Effects to be put into the model, fitted to measurements."""

    measurements: Annotated[
        list[MeasurementsId],
        BeforeValidator(
            lambda one: [one] if isinstance(one, str) else one,
            json_schema_input_type=MeasurementsId | list[MeasurementsId],
        ),
    ] = Field(
        min_length=1,
        max_length=20,
        description="id that ``/v1/measurements`` answered, or a list of them, fitted "
        "together",
    )
    effects: list[str] = Field(min_length=1, max_length=20)
    model: ModelName = Field(description="name of the new version")
    on: ModelName | None = Field(
        default=None,
        description="a version whose effects are kept and fitted together with these; "
        "baseline: none",
    )
    use: bool = Field(default=True, description="whether it answers from then on")


class SurrogateIn(Strict):
    """How long the surrogate of a version may take: minutes, or a number of paths."""

    minutes: float | None = Field(default=None, ge=0.1, le=10_000)
    paths: Annotated[Whole, Field(ge=FEWEST_PATHS, le=100_000)] | None = None
    seed: Whole = Field(default=0, ge=0, le=2**31, strict=True)
    restart: bool = Field(
        default=False, description="discard what was begun or is there"
    )

    @model_validator(mode="after")
    def _one_budget(self) -> SurrogateIn:
        if self.minutes is not None and self.paths is not None:
            raise InputError("minutes", self.minutes, "either paths or minutes", "min")
        return self


class UseIn(Strict):
    """Which model is to answer."""

    model: ModelName = Field(
        description="name or id of a version, or baseline or the base model's name"
    )


class CurveOut(BaseModel):
    """One run of one device, as it was read."""

    device: str
    run: int
    specimen: str
    orientation_deg: float
    steps: int
    readings: int
    quantities: list[str]
    timed: bool
    branches: list[str]


class MeasurementsOut(BaseModel):
    """What is in a file of measurements."""

    id: str
    name: str
    sha256: str
    devices: list[str]
    readings: int
    curves: list[CurveOut]
    warnings: list[str]


Numbers = list[float | None]


class Quantity(BaseModel):
    """One quantity at every load step; null where the step was not reached."""

    value: Numbers
    low: Numbers = Field(description="lower end of the 90 % interval")
    high: Numbers = Field(description="upper end of the 90 % interval")


def _quantity(field: str) -> Any:
    output = next(output for output in OUTPUTS if output.name == field)
    column = BY_FIELD[field]
    return Field(
        description=f"{output.long_name} ({column.unit})",
        json_schema_extra={"unit": column.unit},
    )


class MeshError(BaseModel):
    """Estimate of the discretisation error at every load step; see docs/mesh-error.md.

    null where the path has no value there or has turned.
    """

    tip_deflection_mm: Numbers = _quantity("tip_deflection")
    bending_angle_deg: Numbers = _quantity("bending_angle")
    inflation_mm: Numbers = _quantity("inflation")
    inflation_lower_mm: Numbers = _quantity("inflation_lower")
    cavity_volume_uL: Numbers = _quantity("cavity_volume")


class PredictOut(BaseModel):
    """The answer, from the surrogate or from the finite elements."""

    pressure_kPa: list[float]
    tip_deflection_mm: Quantity = _quantity("tip_deflection")
    bending_angle_deg: Quantity = _quantity("bending_angle")
    inflation_mm: Quantity = _quantity("inflation")
    inflation_lower_mm: Quantity = _quantity("inflation_lower")
    cavity_volume_uL: Quantity = _quantity("cavity_volume")
    source: Literal["surrogate", "fem"]
    in_range: bool = Field(description="whether the surrogate was trained for this")
    reasons: list[str] = Field(description="why not, one sentence each")
    notes: list[str] = Field(description="what else is worth knowing")
    effects: list[str] = Field(
        default=[], description="adopted effects that the model has in it"
    )
    model_version: str
    status: str = Field(description="how the path ended")
    message: str = Field(description="where and why it stopped, if it did")
    limit_pressure_kPa: float | None = Field(
        description="where a balloon grows without bound (kPa); null if not met"
    )
    limit_pressure_error_kPa: float | None = Field(
        default=None, description="bound of its discretisation error (kPa)"
    )
    self_contact_pressure_kPa: float | None = Field(
        default=None,
        description="where neighbouring balloons met, which finite elements do not "
        "resist (kPa); null if they did not",
    )
    mesh_error: MeshError | None = Field(
        default=None,
        description="of the finite elements; half the width of their interval, which "
        "adopted effects widen by what their fit left open",
    )
    unknowns: int | None = Field(description="of the finite elements")
    seconds: float | None = Field(description="the finite elements took (s)")
    mesh_error_seconds: float | None = Field(
        default=None, description="the coarser mesh took on top (s)"
    )
    design: dict[str, int | float]


class CheckOut(BaseModel):
    """What a request means and who would answer it, without computing anything."""

    design: dict[str, int | float]
    tip_margin_mm: float
    rim_mm: float
    thickness_um: float
    in_range: bool
    reasons: list[str]
    notes: list[str]


class ErrorBody(BaseModel):
    """What is wrong; `field` and `allowed` where a value is."""

    type: str
    message: str
    field: str | None = None
    allowed: str | None = None
    problems: list[dict[str, Any]] | None = Field(
        default=None, description="all lines of a measurement file that are not allowed"
    )


class ErrorOut(BaseModel):
    """The one shape of every error."""

    error: ErrorBody


class JobOut(BaseModel):
    """A job as it stands; `result` is what the request would have answered."""

    id: str
    kind: str
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    submitted: str = Field(description="UTC, ISO 8601")
    progress: dict[str, Any]
    result: dict[str, Any] | None
    error: dict[str, Any] | None = Field(description="as in every error")


class FigureIn(Strict):
    """Curves to draw: answers of ``/v1/predict``, and which quantities of them."""

    answers: list[PredictOut] = Field(min_length=1, max_length=12)
    quantities: list[str] = Field(
        default=["inflation_mm", "tip_deflection_mm"], min_length=1, max_length=5
    )

    @model_validator(mode="after")
    def _equal_lengths(self) -> FigureIn:
        for answer in self.answers:
            steps = len(answer.pressure_kPa)
            for name in QUANTITY:
                quantity: Quantity = getattr(answer, name)
                for values in (quantity.value, quantity.low, quantity.high):
                    if len(values) != steps:
                        allowed = f"{steps} numbers, as many as pressure_kPa"
                        raise InputError(name, Words(f"{len(values)} numbers"), allowed)
        return self


def limits_table() -> list[dict[str, Any]]:
    """Every design column with its words, unit and bounds, in order."""
    rows = []
    for name in DESIGN_COLUMNS:
        info = DesignIn.model_fields[name]
        field = next(b.field for b in BY_FIELD.values() if b.name == name)
        lower, upper = bounds(BY_FIELD[field])
        rows.append(
            {
                "name": name,
                "label": info.title,
                "unit": BY_FIELD[field].unit,
                "lower": lower,
                "upper": upper,
                "whole": LIMITS[field].scale == "integer",
                "default": DEFAULTS.get(name),
            }
        )
    return rows
