"""Datasets: many designs, each with its path; the only file that knows the HDF5 layout.

The layout is described in ``docs/dataset-format.md``.  It follows netCDF-4, so that
xarray opens it with its dimensions, coordinates and units, and plain h5py does too.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .atomic import reason, replacing
from .device import LONG_NAMES, MAX_PRESSURE, Design
from .errors import FileError, InputError
from .response import OUTPUTS, PATH_STATUS
from .space import Parameter, Space
from .worker import NO_STEP, STEP_STATUS, Row, split_inputs

if TYPE_CHECKING:
    import h5py

Array = np.ndarray

SCHEMA = "pba-dataset"
SCHEMA_VERSION = 4
"""Raised whenever an older reader would misread a newer file.

2 brought derivatives, 3 pairs, 4 parts of a hypercube; what has none of them is still
written as version 1, which is the same then.
"""

ATTRIBUTES = (
    *("schema_version", "generator_version", "row_count", "seed", "mesh_level"),
    *("effects", "max_pressure_Pa", "design_space", "sha256"),
)
"""What a file says of itself, beside its title and schema."""

PARAMETER_FIELDS = (
    *("name", "unit", "lower", "upper", "scale", "off", "prior", "source"),
)
"""What a file keeps of each parameter of its space."""

SEAL = b"\npba-dataset sha256 "
"""Begins the last line of a file: the checksum of all bytes before it."""

CORRUPT = (
    OSError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    RuntimeError,
    IndexError,
    MemoryError,
    OverflowError,
)
"""What h5py raises, by place of the damage, when a file is not what it should be."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Paths of n designs with up to s load steps and m outputs, all SI.

    Parameters
    ----------
    variables : tuple of d str
        Names of the columns of `inputs`: those of `space`.
    inputs : (n, d) array, SI
    pressure : (n, s) array, Pa
        Gauge pressure of each load step; NaN pads shorter paths.
    outputs : tuple of m str
    values : (n, s, m) array, SI
        NaN where a step was not reached.
    status : (n, s) int8 array
        Places in `STEP_STATUS`: 0 converged, 1 no step, others why a step failed.  The
        converged steps of a path come first.
    path_status : tuple of n str
        How each path ended, a key of `PATH_STATUS`.
    message : tuple of n str
        Where a path stopped and why; empty where it was completed.
    limit_pressure : (n,) array, Pa
        Pressure at which the path turns; NaN where that was not met.
    space : Space
        What was sampled, columns in the order of `variables`.
    seed : int
    level : str
        Mesh level.
    effects : tuple of str
        Effects whose parameters are sampled too, as columns ``effect.parameter``.
    generator_version : str
        Version of the model that computed the values.
    max_pressure : float, Pa
        Where paths end that meet no limit point.
    sensitivities : int
        How many rows, from the first, have derivatives.
    parameters : tuple of k str
        What the outputs are differentiated by; empty without derivatives.
    jacobian : (n, s, m, k) array, SI, or None
        Derivatives at fixed gauge pressure; NaN at limit points, in rows without
        derivatives and where a step was not reached.
    base : str
        Digest of the dataset whose rows the paths are paired with; empty without.
    base_row : (n,) int array or None
        Row there of the same design, whose pressures are among those of the path.
    hypercube : int
        Size of the Latin hypercube that the designs are the first of; 0 where they are
        all of it, or others of it.

    Raises
    ------
    InputError
        When shapes, names, codes or values contradict each other.
    """

    variables: tuple[str, ...]
    inputs: Array
    pressure: Array
    outputs: tuple[str, ...]
    values: Array
    status: Array
    path_status: tuple[str, ...]
    message: tuple[str, ...]
    limit_pressure: Array
    space: Space
    seed: int
    level: str
    effects: tuple[str, ...]
    generator_version: str
    max_pressure: float = MAX_PRESSURE
    sensitivities: int = 0
    parameters: tuple[str, ...] = ()
    jacobian: Array | None = None
    base: str = ""
    base_row: Array | None = None
    hypercube: int = 0

    def __post_init__(self) -> None:
        for name in ("inputs", "pressure", "values", "limit_pressure"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        object.__setattr__(self, "status", np.asarray(self.status, dtype=np.int8))
        n, d, m = len(self.path_status), len(self.variables), len(self.outputs)
        s = self.pressure.shape[1] if self.pressure.ndim == 2 else 1
        shapes = {
            "inputs": (n, d),
            "pressure": (n, s),
            "values": (n, s, m),
            "status": (n, s),
            "limit_pressure": (n,),
            "message": (n,),
        }
        if (self.jacobian is None) != (not self.parameters):
            raise InputError("parameters", len(self.parameters), "those of jacobian")
        if self.jacobian is not None:
            shapes["jacobian"] = (n, s, m, len(self.parameters))
        if (self.base_row is None) != (not self.base):
            raise InputError("base", self.base, "a digest where rows are paired")
        if self.base_row is not None:
            rows = np.asarray(self.base_row, dtype=np.int64)
            object.__setattr__(self, "base_row", rows)
            shapes["base_row"] = (n,)
        for name, shape in shapes.items():
            given = np.shape(getattr(self, name))
            if given != shape:
                raise InputError(name, given, f"shape {shape}")
        if 0 in (n, d, s, m):
            raise InputError(
                "values", (n, s, m), "at least one design, step and output"
            )
        self._check_contents()

    def _check_contents(self) -> None:
        if self.variables != self.space.names:
            names = ", ".join(self.space.names)
            raise InputError("variables", ", ".join(self.variables), names)
        if not np.isfinite(self.inputs).all():
            row, column = np.argwhere(~np.isfinite(self.inputs))[0]
            bad = float(self.inputs[row, column])
            raise InputError(
                self.variables[column], bad, f"a finite number in row {row}"
            )
        unknown = (self.status < 0) | (self.status >= len(STEP_STATUS))
        if unknown.any():
            top = len(STEP_STATUS) - 1
            raise InputError("status", int(self.status[unknown][0]), f"0 to {top}")
        for name in self.path_status:
            if name not in PATH_STATUS:
                raise InputError("path_status", name, ", ".join(PATH_STATUS))
        converged = self.status == 0
        row = _first_row(converged[:, 1:] & ~converged[:, :-1])
        if row is not None:
            raise InputError("status", f"row {row}", "converged steps before any other")
        known = np.isfinite(self.pressure) & np.isfinite(self.values).all(axis=2)
        row = _first_row(converged & ~known)
        if row is not None:
            raise InputError("values", f"row {row}", "finite in every converged step")

    def __len__(self) -> int:
        return len(self.path_status)

    def steps(self, row: int) -> int:
        """Number of converged load steps of a path; they are its first ones."""
        return int((self.status[row] == 0).sum())

    def design(self, row: int) -> Design:
        """The design of a row."""
        design, _ = split_inputs(self.variables, self.inputs[row], self.effects)
        return Design.from_sample(design)

    def effect_parameters(self, row: int) -> dict[str, dict[str, float]]:
        """``{effect: {parameter: value}}`` of a row, SI."""
        return split_inputs(self.variables, self.inputs[row], self.effects)[1]

    def output(self, name: str) -> Array:
        """(n, s) array of one output, SI."""
        if name not in self.outputs:
            raise InputError("output", name, ", ".join(self.outputs))
        return self.values[:, :, self.outputs.index(name)]

    def row(self, row: int) -> Row:
        """One path as it was solved: what `from_rows` collects."""
        steps = int((self.status[row] != STEP_STATUS.index(NO_STEP)).sum())
        slopes = self.jacobian is not None and row < self.sensitivities
        return Row(
            row=row,
            outputs=self.outputs,
            pressure=self.pressure[row, :steps],
            values=self.values[row, :steps],
            status=self.status[row, :steps],
            path_status=self.path_status[row],
            limit_pressure=float(self.limit_pressure[row]),
            message=self.message[row],
            parameters=self.parameters if slopes else (),
            jacobian=self.jacobian[row, :steps] if slopes else None,  # type: ignore[index]
        )

    def subset(self, rows: Sequence[int] | Array) -> Dataset:
        """Those rows alone, in that order."""
        chosen = np.arange(len(self))[np.asarray(rows)]
        arrays = ("inputs", "pressure", "values", "status", "limit_pressure")
        slopes = None if self.jacobian is None else self.jacobian[chosen]
        return replace(
            self,
            jacobian=slopes,
            base_row=None if self.base_row is None else self.base_row[chosen],
            hypercube=0,
            sensitivities=int((chosen < self.sensitivities).sum()),
            path_status=tuple(self.path_status[i] for i in chosen),
            message=tuple(self.message[i] for i in chosen),
            **{name: getattr(self, name)[chosen] for name in arrays},
        )

    def digest(self) -> str:
        """SHA-256 of everything in the dataset but its schema version.

        Equal datasets have equal digests whatever file, compression or platform they
        come from; a single changed bit anywhere gives another one.
        """
        sha = hashlib.sha256()

        def add(name: str, content: bytes) -> None:
            sha.update(f"{name} {len(content)}\n".encode() + content)

        for name in ("inputs", "pressure", "values", "limit_pressure"):
            array = getattr(self, name)
            # All NaN alike: their payload bits mean nothing.
            clean = np.where(np.isnan(array), np.nan, array).astype("<f8")
            add(f"{name} {array.shape}", clean.tobytes())
        if self.jacobian is not None:
            clean = np.where(np.isnan(self.jacobian), np.nan, self.jacobian)
            add(f"jacobian {clean.shape}", clean.astype("<f8").tobytes())
            add("parameters", json.dumps(self.parameters).encode())
            add("sensitivities", json.dumps(self.sensitivities).encode())
        if self.hypercube:
            add("hypercube", json.dumps(self.hypercube).encode())
        if self.base_row is not None:
            add("base_row", self.base_row.astype("<i8").tobytes())
            add("base", self.base.encode())
        for name in ("variables", "outputs", "path_status", "message", "effects"):
            add(name, json.dumps(getattr(self, name)).encode())
        for name in ("seed", "level", "generator_version", "max_pressure"):
            add(name, json.dumps(getattr(self, name)).encode())
        # By name and not by code, which may differ between versions of the program.
        add("status", " ".join(STEP_STATUS[code] for code in self.status.flat).encode())
        space = [[getattr(p, name) for name in PARAMETER_FIELDS] for p in self.space]
        add("space", json.dumps(space).encode())
        return sha.hexdigest()

    @classmethod
    def from_rows(cls, rows: Sequence[Row], **fixed: Any) -> Dataset:
        """Collect finished rows, in the order of their numbers.

        `fixed` are the fields that the rows do not carry (`inputs`, `space`, ...).
        """
        ordered = sorted(rows, key=lambda row: row.row)
        outputs = ordered[0].outputs
        n, m = len(ordered), len(outputs)
        s = max(1, *(len(row.pressure) for row in ordered))
        pressure, values = np.full((n, s), np.nan), np.full((n, s, m), np.nan)
        status = np.full((n, s), STEP_STATUS.index(NO_STEP), dtype=np.int8)
        with_slopes = [row for row in ordered if row.jacobian is not None]
        parameters = with_slopes[0].parameters if with_slopes else ()
        jacobian = np.full((n, s, m, len(parameters)), np.nan) if parameters else None
        for i, row in enumerate(ordered):
            if row.row != i or row.outputs != outputs:
                raise InputError("rows", row.row, f"row {i} with {', '.join(outputs)}")
            steps = len(row.pressure)
            pressure[i, :steps], values[i, :steps] = row.pressure, row.values
            status[i, :steps] = row.status
            if row.jacobian is not None and jacobian is not None:
                if row.parameters != parameters:
                    raise InputError("rows", row.row, f"with {', '.join(parameters)}")
                jacobian[i, :steps] = row.jacobian
        return cls(
            pressure=pressure,
            outputs=outputs,
            values=values,
            status=status,
            path_status=tuple(row.path_status for row in ordered),
            message=tuple(row.message for row in ordered),
            limit_pressure=np.array([row.limit_pressure for row in ordered]),
            parameters=parameters,
            jacobian=jacobian,
            **fixed,
        )

    def write(self, path: str | Path) -> None:
        """Write one HDF5 file, whole or not at all; an older one is replaced.

        Raises
        ------
        FileError
            When the file cannot be written.
        """
        import h5py

        with replacing(Path(path)) as temporary:
            # The format that netCDF-4 files have, variables in the order of writing.
            version = ("v108", "v108")
            with h5py.File(temporary, "w", libver=version, track_order=True) as file:
                _write(file, self)
            seal = hashlib.sha256(temporary.read_bytes()).hexdigest()
            with temporary.open("ab") as stream:
                stream.write(SEAL + seal.encode() + b"\n")

    @classmethod
    def read(cls, path: str | Path) -> Dataset:
        """Read and check a file.

        Raises
        ------
        FileError
            When it is missing, not HDF5, of another kind or schema version, truncated
            or damaged, or its row count, shapes or checksum do not fit.
        """
        import h5py

        path = Path(path)
        if not path.exists():
            raise FileError(path, "does not exist")
        try:
            _check_seal(path)
            # A reader needs no lock: files are replaced, never changed.
            with h5py.File(path, "r", locking=False) as file:
                return _read(file, path)
        except InputError as error:
            raise FileError(path, f"contradicts itself: {error}") from error
        except CORRUPT as error:
            raise FileError(path, _damage(path, error)) from error


def _first_row(bad: Array) -> int | None:
    """First row of a (n, s) mask with a True in it."""
    rows = np.flatnonzero(bad.any(axis=1))
    return int(rows[0]) if rows.size else None


def _check_seal(path: Path) -> None:
    """Refuse damaged bytes before HDF5 sees them, which may loop for ever on them.

    The seal is one line after the end of the HDF5 content, where HDF5 does not look.  A
    file that another program has written anew has none; its values are still checked.
    """
    content, seal, checksum = path.read_bytes().rpartition(SEAL)
    if seal and hashlib.sha256(content).hexdigest().encode() != checksum.strip():
        raise FileError(path, "damaged: its bytes do not match their checksum")


def _damage(path: Path, error: BaseException) -> str:
    import h5py

    if path.is_dir():
        return "is a folder, not a dataset"
    if not path.is_file() or not _readable(path):
        text = reason(error) if isinstance(error, OSError) else str(error)
        return f"cannot be read: {text}"
    if not h5py.is_hdf5(path):
        return "not an HDF5 file"
    if "truncated" in str(error):
        return "truncated: the file ends before its data does"
    detail = " ".join(str(error).split()) or type(error).__name__
    return f"damaged or incomplete: {detail.strip(chr(39) + chr(34))}"


def _readable(path: Path) -> bool:
    try:
        path.open("rb").close()
    except OSError:
        return False
    return True


def space_to_json(space: Space) -> list[dict[str, Any]]:
    """The parameters of a space as plain data."""
    return [{name: getattr(p, name) for name in PARAMETER_FIELDS} for p in space]


def _version_of(data: Dataset) -> int:
    """The oldest schema that says all there is."""
    if data.hypercube:
        return SCHEMA_VERSION
    if data.base_row is not None:
        return 3
    return 2 if data.parameters else 1


def _write(file: h5py.File, data: Dataset) -> None:
    import h5py

    text = h5py.string_dtype("utf-8")
    rows, steps, _ = data.values.shape
    file.attrs.update(
        {
            "title": "Inflation paths of pneumatic balloon actuators",
            "schema": SCHEMA,
            "schema_version": np.int64(_version_of(data)),
            "generator_version": data.generator_version,
            "row_count": np.int64(rows),
            "seed": np.int64(data.seed),
            "mesh_level": data.level,
            "effects": json.dumps(data.effects),
            "max_pressure_Pa": np.float64(data.max_pressure),
            "design_space": json.dumps(space_to_json(data.space)),
            "sha256": data.digest(),
        }
    )
    scales = [
        ("design", np.arange(rows), "row of the dataset, from 0"),
        ("load_step", np.arange(steps), "place along the path, from 0"),
        ("output", np.array(data.outputs, dtype=text), "name of the output, SI"),
    ]
    if data.jacobian is not None:
        by = np.array(data.parameters, dtype=text)
        scales.append(("parameter", by, "what the outputs are differentiated by, SI"))
        file.attrs["sensitivities"] = np.int64(data.sensitivities)
    for name, values, long_name in scales:
        file.create_dataset(name, data=values).make_scale(name)
        file[name].attrs["long_name"] = long_name

    def put(name: str, dims: str, values: Array, long_name: str, **more: Any) -> None:
        floating = values.dtype.kind == "f"
        packed = {"compression": "gzip", "shuffle": True}
        fill = {"fillvalue": np.nan} if floating else {}
        variable = file.create_dataset(
            name, data=values, **fill, **(packed if values.ndim > 1 else {})
        )
        for axis, dim in enumerate(dims.split()):
            variable.dims[axis].attach_scale(file[dim])
        variable.attrs.update({"long_name": long_name} | more)
        if floating:
            variable.attrs["_FillValue"] = np.array([np.nan])

    def put_text(name: str, dim: str, values: Sequence[str], long_name: str) -> None:
        put(name, dim, np.array(values, dtype=text), long_name)

    for i, p in enumerate(data.space):
        column = np.ascontiguousarray(data.inputs[:, i])
        put(p.name, "design", column, LONG_NAMES.get(p.name, p.name), units=p.unit)
    if data.base_row is not None:
        words = "row of the same design in the dataset that the paths are paired with"
        put("base_row", "design", data.base_row, words)
        file.attrs["base"] = data.base
    if data.hypercube:
        file.attrs["hypercube"] = np.int64(data.hypercube)
    steps_of = "design load_step"
    pressure_words = "gauge pressure of the load step"
    put("pressure", steps_of, data.pressure, pressure_words, units="Pa")
    flags = {
        "flag_values": np.arange(len(STEP_STATUS), dtype=np.int8),
        "flag_meanings": " ".join(STEP_STATUS),
    }
    put("status", steps_of, data.status, "status of the load step", **flags)
    put(
        "response",
        "design load_step output",
        data.values,
        "outputs along the path, each in its own SI unit",
        coordinates="pressure output_units output_long_name",
    )
    if data.jacobian is not None:
        put(
            "sensitivity",
            "design load_step output parameter",
            data.jacobian,
            "derivatives of the outputs at fixed gauge pressure, SI by SI",
            coordinates="pressure",
        )
    known = {output.name: output for output in OUTPUTS}
    units = [known[name].unit if name in known else "" for name in data.outputs]
    names = [known[name].long_name if name in known else "" for name in data.outputs]
    put_text("output_units", "output", units, "unit of the output")
    put_text("output_long_name", "output", names, "meaning of the output")
    limit_words = "pressure at which the equilibrium path turns; NaN: not met"
    put("limit_pressure", "design", data.limit_pressure, limit_words, units="Pa")
    endings = "; ".join(f"{key}: {meaning}" for key, meaning in PATH_STATUS.items())
    put_text(
        "path_status", "design", data.path_status, f"how the path ended: {endings}"
    )
    put_text("message", "design", data.message, "where and why the path stopped short")


def _read(file: h5py.File, path: Path) -> Dataset:
    attributes = file.attrs
    if attributes.get("schema") != SCHEMA:
        raise FileError(path, f"an HDF5 file, but not a {SCHEMA}")
    for name in ATTRIBUTES:
        if name not in attributes:
            raise FileError(path, f"incomplete: it has no attribute {name}")
    version = int(attributes["schema_version"])
    if not 1 <= version <= SCHEMA_VERSION:
        raise FileError(
            path, f"schema version {version}; this program reads 1 to {SCHEMA_VERSION}"
        )
    rows = int(attributes["row_count"])
    for name in ("response", "pressure", "status", "path_status"):
        if len(file[name]) != rows:
            raise FileError(
                path, f"{name} has {len(file[name])} rows, row_count says {rows}"
            )
    space = Space(tuple(Parameter(**p) for p in json.loads(attributes["design_space"])))
    more: dict[str, Any] = {}
    if "sensitivity" in file:
        more = {
            "sensitivities": int(attributes["sensitivities"]),
            "parameters": _texts(file["parameter"]),
            "jacobian": file["sensitivity"][()],
        }
    if "base_row" in file:
        more |= {
            "base": str(attributes["base"]),
            "base_row": file["base_row"][()],
        }
    if "hypercube" in attributes:
        more["hypercube"] = int(attributes["hypercube"])
    data = Dataset(
        variables=space.names,
        inputs=np.stack([file[name][()] for name in space.names], axis=1),
        pressure=file["pressure"][()],
        outputs=_texts(file["output"]),
        values=file["response"][()],
        status=_step_codes(file["status"], path),
        path_status=_texts(file["path_status"]),
        message=_texts(file["message"]),
        limit_pressure=file["limit_pressure"][()],
        space=space,
        seed=int(attributes["seed"]),
        level=str(attributes["mesh_level"]),
        effects=tuple(json.loads(attributes["effects"])),
        generator_version=str(attributes["generator_version"]),
        max_pressure=float(attributes["max_pressure_Pa"]),
        **more,
    )
    if not math.isfinite(data.max_pressure) or data.digest() != attributes["sha256"]:
        raise FileError(path, "damaged: the values do not match their checksum")
    return data


def _texts(variable: h5py.Dataset) -> tuple[str, ...]:
    return tuple(str(text) for text in variable.asstr()[()])


def _step_codes(variable: h5py.Dataset, path: Path) -> Array:
    """Codes of this program for the file's, which the file explains itself."""
    meanings = str(variable.attrs["flag_meanings"]).split()
    codes: Array = np.full(256, -1, dtype=np.int8)
    for value, name in zip(variable.attrs["flag_values"], meanings, strict=True):
        if name not in STEP_STATUS:
            raise FileError(path, f"unknown step status {name!r}")
        codes[int(value)] = STEP_STATUS.index(name)
    own: Array = codes[variable[()].astype(np.uint8)]
    return own
