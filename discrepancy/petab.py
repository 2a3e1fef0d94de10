"""PEtab tables as a measurement file: the part of the format that has a meaning here.

PEtab (Schmiester et al. 2021, PLoS Comput. Biol. 17 e1008646) keeps measurements,
conditions, observables and, from version 2, experiments in tables of their own.  Here

- a condition sets columns of a measurement file (``device``, ``length_mm``, ...,
  ``pressure_kPa``, ``orientation_deg``, ``branch``), as headings of the conditions
  table (version 1) or as ``targetId`` and ``targetValue`` (version 2);
- an observable's formula is the name of one quantity, as ``inflation_mm``;
- ``noiseParameters`` or a number as ``noiseFormula`` is its standard deviation, in the
  unit of the quantity; ``replicateId`` is the run;
- an experiment (version 2) applies conditions one after the other, each on top of
  those before; a measurement belongs to what holds at its time;
- ``time`` is ``time_s`` unless every time is 0 or ``inf``, a steady state.

Formulae, transformations, other noise than normal, parameters by name in place of
numbers and pre-equilibration are refused by name.  Model and parameter tables are not
read: the model is the device's own.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from datagen.errors import FileError

from .columns import NUMBERS, QUANTITY_NAMES, column_of
from .table import (
    NUMBER,
    Complaints,
    Row,
    Table,
    decimal_sign,
    decode,
    lines_of,
    read_bytes,
    short,
)

Line = tuple[str, dict[str, str]]
"""``FILE:LINE`` and the fields that are not empty, by heading."""

KINDS = ("measurement", "condition", "observable", "experiment")

COLUMNS = {
    "measurement": (
        *("observableId", "simulationConditionId", "preequilibrationConditionId"),
        *("experimentId", "measurement", "time", "observableParameters"),
        *("noiseParameters", "datasetId", "replicateId", "modelId"),
    ),
    "condition": ("conditionId", "conditionName", "targetId", "targetValue"),
    "observable": (
        *("observableId", "observableName", "observableFormula", "noiseFormula"),
        *("observableTransformation", "noiseDistribution"),
        *("observablePlaceholders", "noisePlaceholders"),
    ),
    "experiment": ("experimentId", "experimentName", "time", "conditionId"),
}
"""Headings of the format's versions 1 and 2; others are its users' own."""


@dataclass
class _Setting:
    """What conditions set: texts by field, and where each is written."""

    texts: dict[str, str] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)

    def over(self, other: _Setting) -> _Setting:
        """This one on top of another."""
        return _Setting(other.texts | self.texts, other.places | self.places)


@dataclass(frozen=True)
class _Observable:
    """A quantity, SI per unit, and the text of its standard deviation, if fixed."""

    quantity: str
    factor: float
    std: str | None


def petab_table(path: Path) -> tuple[Table, bytes]:
    """PEtab tables of a folder or of a problem file, as rows of a measurement file.

    Parameters
    ----------
    path : Path
        A problem file (``.yaml``), or a folder with one or with tables whose names
        hold ``measurement``, ``condition``, ``observable`` and ``experiment``.

    Returns
    -------
    Table and the bytes of all tables, one after the other

    Raises
    ------
    FileError
        When a table is missing or cannot be read.
    MeasurementError
        When a table uses what has no meaning here.
    """
    files = _files(path)
    complaints = Complaints(path)
    warnings: list[str] = []
    content: dict[str, list[Line]] = {}
    data = b""
    for kind in KINDS:
        content[kind] = []
        for file in files[kind]:
            raw = read_bytes(file)
            data += raw
            text, odd = decode(file, raw)
            warnings += odd
            content[kind] += _lines(file, text, COLUMNS[kind], warnings)
    if not content["measurement"]:
        raise FileError(path, "has no measurements")
    factors: dict[str, float] = {}
    conditions = _conditions(content["condition"], factors, complaints)
    observables = _observables(content["observable"], complaints, warnings)
    experiments = _experiments(content["experiment"], conditions, complaints)
    complaints.settle()
    rows = _rows(
        content["measurement"],
        conditions,
        experiments,
        observables,
        factors,
        complaints,
        warnings,
    )
    complaints.settle()
    place = f"{files['condition'][0]}:1"
    decimal = decimal_sign(path, rows)
    return Table(path, place, factors, tuple(rows), decimal, tuple(warnings)), data


# -- files -----------------------------------------------------------------------------


def _files(path: Path) -> dict[str, list[Path]]:
    """Tables by kind."""
    if path.is_dir():
        problems = sorted([*path.glob("*.yaml"), *path.glob("*.yml")])
        if len(problems) > 1:
            names = ", ".join(problem.name for problem in problems)
            raise FileError(path, f"holds several problem files ({names}); name one")
        if problems:
            return _files(problems[0])
        tables = sorted(path.glob("*.tsv"))
        files = {kind: [t for t in tables if _holds(t, kind)] for kind in KINDS}
    else:
        files = _listed(path)
    for kind in KINDS[:3]:
        if not files[kind]:
            raise FileError(
                path, f"has no table of {kind}s; allowed: a PEtab problem with one"
            )
    return files


def _holds(table: Path, kind: str) -> bool:
    """Whether a table is of a kind, by its name: `experimentalCondition` is one."""
    name = table.name.lower()
    return kind in name and not (kind == "experiment" and "condition" in name)


def _listed(path: Path) -> dict[str, list[Path]]:
    """Tables that a problem file lists; version 1 lists them under its one problem."""
    import yaml

    try:
        problem = yaml.safe_load(read_bytes(path))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        # Besides YAML's own: a date that is none, brackets without end.
        line = " ".join(str(error).split())
        raise FileError(path, f"not a YAML file: {line}") from error
    listed = problem
    if isinstance(problem, dict) and isinstance(problem.get("problems"), list):
        if len(problem["problems"]) != 1:
            raise FileError(
                path, f"holds {len(problem['problems'])} problems; allowed: one"
            )
        listed = problem["problems"][0]
    if not isinstance(listed, dict):
        raise FileError(path, "not a PEtab problem file")
    files = {}
    for kind in KINDS:
        names = listed.get(f"{kind}_files") or []
        if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
            raise FileError(path, f"{kind}_files: allowed: a list of file names")
        files[kind] = [path.parent / name for name in names]
    return files


def _lines(
    file: Path, text: str, columns: Sequence[str], warnings: list[str]
) -> list[Line]:
    """Lines of one table, by heading; headings that seem misspelt are told."""
    headings: list[str] = []
    lines = []
    for number, fields in lines_of(file, text, "\t"):
        place = f"{file}:{number}"
        if not headings:
            headings = fields
            twice = [one for one in headings if one and headings.count(one) > 1]
            if twice:
                raise FileError(place, f"column {twice[0]!r} stands there twice")
            for one in set(headings) - set(columns):
                near = difflib.get_close_matches(one, columns, 1, 0.8)
                if near and near[0] not in headings:
                    words = f"column {one!r} is not PEtab's and left out"
                    warnings.append(f"{short(place)}: {words}; did you mean {near[0]}?")
            continue
        if any(fields[len(headings) :]):
            words = f"{len(fields)} fields, but {len(headings)} headings"
            raise FileError(place, words)
        own = {h: t for h, t in zip(headings, fields, strict=False) if h and t}
        lines.append((place, own))
    return lines


def _required(line: Line, name: str, complaints: Complaints) -> str:
    place, fields = line
    if name not in fields:
        complaints.add(place, f"{name}: nothing is not allowed; allowed: a value")
    return fields.get(name, "")


# -- conditions, experiments, observables ----------------------------------------------


def _conditions(
    lines: list[Line], factors: dict[str, float], complaints: Complaints
) -> dict[str, _Setting]:
    """What each condition sets; fills in SI per unit of what is set."""
    conditions: dict[str, _Setting] = {}
    for line in lines:
        place, fields = line
        name = _required(line, "conditionId", complaints)
        long = "targetId" in fields
        if not long and name in conditions:
            complaints.add(place, f"conditionId: {name!r} is there already")
        if long:
            pairs = [(fields["targetId"], _required(line, "targetValue", complaints))]
        else:
            own = ("conditionId", "conditionName")
            pairs = [pair for pair in fields.items() if pair[0] not in own]
        setting = conditions.setdefault(name, _Setting())
        for heading, text in pairs:
            try:
                found = column_of(heading)
            except ValueError as error:
                complaints.add(place, str(error))
                continue
            if found is None or found[0] in QUANTITY_NAMES:
                complaints.add(
                    place,
                    f"{heading}: a condition on it is not supported; allowed: device, "
                    "the design columns, pressure_kPa and what else a measurement "
                    "file says about a reading",
                )
                continue
            one, factor = found
            if factors.setdefault(one, factor) != factor:
                complaints.add(place, f"{heading}: stands in two units")
            if long and one in setting.texts:
                complaints.add(place, f"{heading}: is set already for {name!r}")
            setting.texts[one], setting.places[one] = text, place
    return conditions


def _experiments(
    lines: list[Line], conditions: dict[str, _Setting], complaints: Complaints
) -> dict[str, list[tuple[float, _Setting]]]:
    """Times from which on each experiment has a setting, in order."""
    periods: dict[str, list[tuple[float, str, str]]] = {}
    for line in lines:
        place, fields = line
        name = _required(line, "experimentId", complaints)
        time = _time(place, _required(line, "time", complaints), complaints)
        condition = fields.get("conditionId", "")
        if condition and condition not in conditions:
            complaints.add(place, f"conditionId: {condition!r} is not in the table")
        periods.setdefault(name, []).append((time, condition, place))
    experiments: dict[str, list[tuple[float, _Setting]]] = {}
    for name, steps in periods.items():
        setting, experiments[name] = _Setting(), []
        fresh: set[str] = set()
        for time, condition, place in sorted(steps, key=lambda step: step[0]):
            own = conditions.get(condition, _Setting())
            if experiments[name] and experiments[name][-1][0] == time:
                # Conditions of one time act together, each on targets of its own.
                del experiments[name][-1]
                for target in sorted(fresh & set(own.texts)):
                    words = f"{target}: set twice at time {time:g} of {name!r}"
                    complaints.add(place, words)
            else:
                fresh = set()
            fresh |= set(own.texts)
            setting = own.over(setting)
            experiments[name].append((time, setting))
    return experiments


def _time(place: str, text: str, complaints: Complaints) -> float:
    if text in ("inf", "-inf") or NUMBER.fullmatch(text):
        return float(text.replace(",", "."))
    if text:
        complaints.add(place, f"time: {text!r} is not allowed; allowed: a number, inf")
    return 0.0


def _observables(
    lines: list[Line], complaints: Complaints, warnings: list[str]
) -> dict[str, _Observable]:
    """Observables that are one quantity each, with normal noise."""
    found: dict[str, _Observable] = {}
    for line in lines:
        place, fields = line
        name = _required(line, "observableId", complaints)
        if name in found:
            complaints.add(place, f"observableId: {name!r} is there already")
        formula = _required(line, "observableFormula", complaints)
        for heading, allowed in (
            ("observableTransformation", "lin"),
            ("noiseDistribution", "normal"),
        ):
            if fields.get(heading, allowed) != allowed:
                complaints.add(
                    place,
                    f"{heading}: {fields[heading]!r} is not supported; "
                    f"allowed: {allowed}",
                )
        try:
            quantity = column_of(formula)
        except ValueError:
            quantity = None
        if quantity is None or quantity[0] not in QUANTITY_NAMES:
            names = ", ".join(NUMBERS[q].name for q in QUANTITY_NAMES)
            complaints.add(
                place,
                f"observableFormula: {formula!r} is not supported; allowed: the name "
                f"of one quantity ({names})",
            )
            continue
        noise = fields.get("noiseFormula", "")
        std = noise if NUMBER.fullmatch(noise) else None
        placeholders = fields.get("noisePlaceholders", "").split(";")
        named = noise in placeholders or noise == f"noiseParameter1_{name}"
        if noise and std is None and not named:
            if not noise.isidentifier():
                complaints.add(
                    place,
                    f"noiseFormula: {noise!r} is not supported; allowed: a number, "
                    f"noiseParameter1_{name} or the name of a parameter",
                )
            warnings.append(f"{short(place)}: noise {noise!r} is taken for unknown")
        found[name] = _Observable(*quantity, std)
    return found


# -- measurements ----------------------------------------------------------------------


def _setting_at(
    line: Line,
    time: float,
    conditions: dict[str, _Setting],
    experiments: dict[str, list[tuple[float, _Setting]]],
    complaints: Complaints,
) -> _Setting:
    """What holds at a measurement."""
    place, fields = line
    if "experimentId" in fields:
        name = fields["experimentId"]
        held = [s for start, s in experiments.get(name, []) if start <= time]
        if name not in experiments:
            complaints.add(place, f"experimentId: {name!r} is not in the table")
        elif not held:
            complaints.add(place, f"time: {time:g} is before experiment {name!r}")
        return held[-1] if held else _Setting()
    name = _required(line, "simulationConditionId", complaints)
    if name and name not in conditions:
        complaints.add(
            place, f"simulationConditionId: {name!r} is not in the conditions table"
        )
    return conditions.get(name, _Setting())


def _rows(
    lines: list[Line],
    conditions: dict[str, _Setting],
    experiments: dict[str, list[tuple[float, _Setting]]],
    observables: dict[str, _Observable],
    factors: dict[str, float],
    complaints: Complaints,
    warnings: list[str],
) -> list[Row]:
    """One row for all quantities that were read at one time of one test."""
    rows: dict[tuple[str, ...], Row] = {}
    times: dict[tuple[str, ...], float] = {}
    for line in lines:
        place, fields = line
        time = _time(place, _required(line, "time", complaints), complaints)
        setting = _setting_at(line, time, conditions, experiments, complaints)
        for name in ("observableParameters", "preequilibrationConditionId"):
            if name in fields:
                complaints.add(
                    place,
                    f"{name}: {fields[name]!r} is not supported; allowed: nothing",
                )
        observable = observables.get(_required(line, "observableId", complaints))
        if observable is None:
            complaints.add(
                place,
                f"observableId: {fields.get('observableId', '')!r} is not in the "
                "observables table",
            )
            continue
        texts = {observable.quantity: _required(line, "measurement", complaints)}
        noise = fields.get("noiseParameters", "")
        if ";" in noise:
            complaints.add(
                place,
                f"noiseParameters: {noise!r} is not supported; allowed: one number",
            )
        elif noise and not NUMBER.fullmatch(noise):
            warnings.append(f"{short(place)}: noise {noise!r} is taken for unknown")
            noise = ""
        if noise or observable.std:
            texts[f"{observable.quantity}_std"] = noise or observable.std or ""
        for name in texts:
            if factors.setdefault(name, observable.factor) != observable.factor:
                complaints.add(place, f"{NUMBERS[name].name}: stands in two units")
        run = fields.get("replicateId", "")
        test = fields.get("experimentId") or fields.get("simulationConditionId", "")
        key: tuple[str, ...] = (test, str(time), run)
        while key in rows and observable.quantity in rows[key].texts:
            key = (*key, "again")  # a repeated reading: refused with its line later
        if key not in rows:
            own = dict(setting.texts) | ({"run": run} if run else {})
            rows[key] = Row(place, own, dict(setting.places))
            times[key] = time
        rows[key].texts.update(texts)
        rows[key].places.update(dict.fromkeys(texts, place))
    if any(row.texts.get("run") for row in rows.values()):
        factors.setdefault("run", 1.0)
        _number_runs(list(rows.values()), warnings)
    clocked = not all(time in (0.0, float("inf")) for time in times.values())
    order = {key[0]: i for i, key in reversed(list(enumerate(rows)))}
    if experiments:
        sequence = sorted(rows, key=lambda key: (order[key[0]], times[key]))
    else:
        sequence = list(rows)
    if clocked:
        factors.setdefault("time", 1.0)
        for key in sequence:
            rows[key].texts["time"] = f"{times[key]!r}".removesuffix(".0")
            rows[key].places.pop("time", None)
    return [rows[key] for key in sequence]


def _number_runs(rows: list[Row], warnings: list[str]) -> None:
    """Runs of each device by number, in order, where replicates have other names."""
    if all(NUMBER.fullmatch(row.texts.get("run", "1")) for row in rows):
        return
    runs: dict[str, dict[str, int]] = {}
    for row in rows:
        known = runs.setdefault(row.texts.get("device", ""), {})
        name = row.texts.get("run", "")
        row.texts["run"] = str(known.setdefault(name, len(known) + 1))
    names = ", ".join(f"{n!r} is {i}" for n, i in next(iter(runs.values())).items())
    warnings.append(f"{short(rows[0].place)}: replicates are taken for runs: {names}")
