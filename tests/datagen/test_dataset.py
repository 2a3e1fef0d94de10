"""Datasets: what is written is read, by us and by xarray; damage is told."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from numpy.testing import assert_array_equal

from datagen.dataset import SCHEMA_VERSION, Dataset
from datagen.device import DESIGN_SPACE, Design
from datagen.errors import FileError, InputError
from datagen.response import OUTPUT_NAMES, PATH_STATUS, Response
from datagen.space import Parameter, Space
from datagen.worker import STEP_STATUS, Row, Task

from .fake_solver import solve_fake
from .making import make

ROOT = Path(__file__).parents[2]

ARRAYS = ("inputs", "pressure", "values", "status", "limit_pressure")

STIFFENING = Parameter(
    "strain_stiffening.inverse_limit", "1", 0.0, 0.5, off=0.0, source="test"
)
SPACE = Space((*DESIGN_SPACE, STIFFENING))


def sample(rows: int = 7, seed: int = 5) -> Dataset:
    inputs = SPACE.sample(rows, seed)
    effects = ("strain_stiffening",)
    solved = [
        solve_fake(Task(i, SPACE.names, tuple(row), effects, "draft", 150e3))
        for i, row in enumerate(inputs.tolist())
    ]
    return Dataset.from_rows(
        solved[::-1],  # in any order
        variables=SPACE.names,
        inputs=inputs,
        space=SPACE,
        seed=seed,
        level="draft",
        effects=effects,
        generator_version="fake-1",
    )


@pytest.fixture
def data() -> Dataset:
    return sample()


@pytest.fixture
def path(data: Dataset, tmp_path: Path) -> Path:
    data.write(tmp_path / "data.h5")
    return tmp_path / "data.h5"


def assert_same(one: Dataset, other: Dataset) -> None:
    for name in ARRAYS:
        assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
        assert getattr(one, name).dtype == getattr(other, name).dtype
    for name in ("variables", "outputs", "path_status", "message", "space", "seed"):
        assert getattr(one, name) == getattr(other, name)
    for name in ("level", "effects", "generator_version", "max_pressure"):
        assert getattr(one, name) == getattr(other, name)
    assert one.digest() == other.digest()


def test_what_is_written_is_read(data: Dataset, path: Path) -> None:
    read = Dataset.read(path)
    assert_same(data, read)
    assert read.jacobian is None
    assert "Ω" in read.message[1]


def test_two_writes_are_equal_byte_for_byte(data: Dataset, tmp_path: Path) -> None:
    data.write(tmp_path / "a.h5")
    data.write(tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.h5", "b.h5"]


def test_rows_give_designs_steps_and_parameters(data: Dataset) -> None:
    design = data.design(2)
    assert isinstance(design, Design)
    assert design.balloon_length == data.inputs[2, 0]
    parameters = data.effect_parameters(2)
    assert parameters == {"strain_stiffening": {"inverse_limit": data.inputs[2, -1]}}
    for i in range(len(data)):
        steps = data.steps(i)
        assert 3 <= steps <= 8
        assert np.isfinite(data.pressure[i, :steps]).all()
        assert np.isnan(data.pressure[i, steps:]).all()
        assert np.isnan(data.values[i, steps:]).all()
        assert (data.status[i, steps:] == STEP_STATUS.index("no_step")).all()
    assert max(map(data.steps, range(len(data)))) == data.pressure.shape[1]


def test_a_path_that_never_started_is_kept() -> None:
    nothing = Row(
        row=0,
        outputs=OUTPUT_NAMES,
        pressure=np.empty(0),
        values=np.empty((0, len(OUTPUT_NAMES))),
        status=np.empty(0, dtype=np.int8),
        path_status="step_too_small",
        limit_pressure=np.nan,
        message="no equilibrium at 1 Pa",
    )
    again = Row.from_dict(nothing.to_dict())
    assert again.values.shape == (0, len(OUTPUT_NAMES))
    template = sample(1)
    fixed = {
        name: getattr(template, name)
        for name in ("variables", "inputs", "space", "seed", "level", "effects")
    }
    data = Dataset.from_rows([again], generator_version="fake-1", **fixed)
    assert data.steps(0) == 0
    assert data.values.shape == (1, 1, len(OUTPUT_NAMES))


def test_row_from_response_drops_padding_and_codes_the_status() -> None:
    m = len(OUTPUT_NAMES)
    pressure = np.array([[1e3, 2e3, 3e3, np.nan]])
    values = np.ones((1, 4, m))
    values[0, 2:] = np.nan
    response = Response(
        outputs=OUTPUT_NAMES,
        pressure=pressure,
        values=values,
        std=np.zeros_like(values),
        status=np.array([["converged", "converged", "inverted_element", "no_step"]]),
        path_status=("inverted_element",),
        limit_pressure=np.array([np.nan]),
        message=("at 3 kPa",),
    )
    row = Row.from_response(4, response)
    assert row.pressure.tolist() == [1e3, 2e3, 3e3]
    assert [STEP_STATUS[code] for code in row.status] == [
        "converged",
        "converged",
        "inverted_element",
    ]
    unknown = replace(response, status=np.full((1, 4), "maybe"))
    with pytest.raises(InputError, match="maybe"):
        Row.from_response(4, unknown)


def test_subset_keeps_rows_in_the_order_asked_for(data: Dataset) -> None:
    part = data.subset([4, 0])
    assert_array_equal(part.inputs, data.inputs[[4, 0]])
    assert_array_equal(part.values, data.values[[4, 0]])
    assert part.message == (data.message[4], data.message[0])
    assert part.design(1) == data.design(0)
    mask = np.arange(len(data)) == 3
    assert part.digest() != data.digest()
    assert data.subset(mask).design(0) == data.design(3)
    with pytest.raises(IndexError):
        data.subset([len(data)])


def test_digest_sees_every_field(data: Dataset) -> None:
    changed = []
    for name in ("inputs", "pressure", "values", "limit_pressure"):
        array = getattr(data, name).copy()
        place = np.argwhere(np.isfinite(array))[0]
        array[tuple(place)] = np.nextafter(array[tuple(place)], np.inf)
        changed.append(replace(data, **{name: array}))
    status = data.status.copy()
    status[0, data.steps(0) - 1] = STEP_STATUS.index("step_limit")
    changed.append(replace(data, status=status))
    for name, value in {
        "path_status": ("contact", *data.path_status[1:]),
        "message": ("other", *data.message[1:]),
        "seed": 6,
        "level": "fine",
        "effects": (),
        "generator_version": "fake-2",
        "max_pressure": 1e5,
        "hypercube": 100,
        "space": Space((*DESIGN_SPACE, replace(STIFFENING, upper=0.6))),
    }.items():
        changed.append(replace(data, **{name: value}))
    digests = {data.digest(), *(other.digest() for other in changed)}
    assert len(digests) == len(changed) + 1


def test_digest_is_the_same_everywhere() -> None:
    """Pinned: a change here makes every older file unreadable."""
    m = len(OUTPUT_NAMES)
    space = Space((Parameter("wall", "m", 1e-4, 5e-4, source="contract"),))
    data = Dataset(
        variables=("wall",),
        inputs=np.array([[2e-4], [3e-4]]),
        pressure=np.array([[1e3, 2e3], [1e3, np.nan]]),
        outputs=OUTPUT_NAMES,
        values=np.array([np.ones((2, m)), [np.ones(m), np.full(m, np.nan)]]),
        status=np.array([[0, 0], [0, 1]]),
        path_status=("completed", "contact"),
        message=("", "at 2 kPa"),
        limit_pressure=np.array([np.nan, np.nan]),
        space=space,
        seed=1,
        level="draft",
        effects=(),
        generator_version="1",
    )
    pinned = "ea76588e94eab23400d4cea6fd1f215d33b57e57694f427852f9805452213620"
    assert data.digest() == pinned


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("variables", DESIGN_SPACE.names, "inputs"),
        ("inputs", np.full((7, 14), np.nan), "balloon_length"),
        ("values", np.zeros((7, 2, 5)), "values"),
        ("status", np.full((7, 8), 99), "status"),
        ("path_status", ("fine",) * 7, "path_status"),
        ("message", ("",), "message"),
        ("pressure", np.zeros(7), "pressure"),
    ],
)
def test_contradictions_are_refused(
    data: Dataset, field: str, value: object, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        replace(data, **{field: value})


def test_converged_steps_have_values_and_come_first(data: Dataset) -> None:
    values = data.values.copy()
    values[2, 0, 1] = np.nan
    with pytest.raises(InputError, match=r"row 2.*finite"):
        replace(data, values=values)
    status = data.status.copy()
    status[1, 0] = STEP_STATUS.index("contact")
    with pytest.raises(InputError, match=r"row 1.*before"):
        replace(data, status=status)


def test_xarray_opens_it_with_names_and_units(data: Dataset, path: Path) -> None:
    with xarray.open_dataset(path, engine="h5netcdf") as opened:
        opened.load()
    assert dict(opened.sizes) == {"design": 7, "load_step": 8, "output": 5}
    assert opened["response"].dims == ("design", "load_step", "output")
    assert opened["status"].dims == opened["pressure"].dims == ("design", "load_step")
    assert set(opened.coords) >= {"design", "load_step", "output", "pressure"}
    tip = opened["response"].sel(output="tip_deflection")
    assert_array_equal(tip, data.output("tip_deflection"))
    assert str(tip.coords["output_units"].values) == "m"
    assert opened["balloon_length"].attrs["units"] == "m"
    assert opened["upper_modulus"].attrs["units"] == "Pa"
    assert opened["strain_stiffening.inverse_limit"].attrs["units"] == "1"
    assert_array_equal(opened["strain_stiffening.inverse_limit"], data.inputs[:, -1])
    for name in opened.variables:
        assert opened[name].attrs["long_name"], name
    assert opened["status"].attrs["flag_meanings"].split() == list(STEP_STATUS)
    assert_array_equal(opened["status"], data.status)
    assert opened["path_status"].values.tolist() == list(data.path_status)
    assert opened.attrs["seed"] == 5
    assert opened.attrs["row_count"] == 7


def test_the_document_is_true(
    data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its examples run, and it names every variable, attribute and status."""
    text = (ROOT / "docs" / "dataset-format.md").read_text()
    monkeypatch.chdir(tmp_path)
    data.write("paths.h5")
    examples = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(examples) == 3
    for example in examples:
        exec(example, {})
    with h5py.File("paths.h5") as file:
        names = {*file, *file.attrs, "hypercube"} - {*data.variables, "title"}
    for name in (*names, *PATH_STATUS):
        assert f"`{name}`" in text, name


def test_codes_are_read_by_their_meaning(data: Dataset, path: Path) -> None:
    """A file of a program with other codes gives the same dataset."""
    with h5py.File(path, "r+") as file:
        status = file["status"]
        status[...] = (status[()] + 3) % len(STEP_STATUS)
        turned = [(code + 3) % len(STEP_STATUS) for code in range(len(STEP_STATUS))]
        status.attrs["flag_values"] = np.array(turned, dtype=np.int8)
    assert_same(data, Dataset.read(path))
    with h5py.File(path, "r+") as file:
        words = file["status"].attrs["flag_meanings"].replace("contact", "melted")
        file["status"].attrs["flag_meanings"] = words
    with pytest.raises(FileError, match="unknown step status 'melted'"):
        Dataset.read(path)


def test_derivatives_are_written_and_read(tmp_path: Path) -> None:
    data = make(tmp_path / "data.h5", sensitivities=5)
    read = Dataset.read(tmp_path / "data.h5")
    assert (read.sensitivities, read.parameters) == (5, ("wall", "upper_modulus"))
    assert_same(data, read)
    assert read.jacobian is not None and data.jacobian is not None
    assert_array_equal(read.jacobian, data.jacobian)
    known = np.isfinite(read.jacobian).any(axis=(1, 2, 3))
    assert known.tolist() == [True] * 5 + [False] * (len(data) - 5)
    assert read.digest() != make(tmp_path / "plain.h5").digest()
    part = read.subset([7, 2])
    assert (part.sensitivities, part.jacobian.shape[0]) == (1, 2)  # type: ignore[union-attr]
    with xarray.open_dataset(tmp_path / "data.h5", engine="h5netcdf") as opened:
        by_wall = opened["sensitivity"].sel(parameter="wall", output="inflation")
        assert_array_equal(by_wall, read.jacobian[:, :, 2, 0])


def test_derivatives_belong_to_what_a_run_resumes(tmp_path: Path) -> None:
    make(tmp_path / "data.h5", sensitivities=5)
    with pytest.raises(InputError, match="sensitivities"):
        make(tmp_path / "data.h5", sensitivities=4, resume=True)
    with pytest.raises(InputError, match="sensitivities: 13 is not allowed"):
        make(tmp_path / "more.h5", sensitivities=13)


def spoil(path: Path, change: str) -> None:
    """Damage a file in one of many ways."""
    content = path.read_bytes()
    if change == "truncated":
        path.write_bytes(content[: len(content) * 2 // 3])
    elif change == "empty":
        path.write_bytes(b"")
    elif change == "text":
        path.write_text("pressure_kPa,tip_deflection_mm\n")
    else:
        with h5py.File(path, "r+") as file:
            if change == "other HDF5":
                del file.attrs["schema"]
            elif change == "newer":
                file.attrs["schema_version"] = SCHEMA_VERSION + 1
            elif change == "rows":
                file.attrs["row_count"] = 8
            elif change == "no variable":
                del file["message"]
            elif change == "no attribute":
                del file.attrs["seed"]
            elif change == "shape":
                del file["status"]
                file["status"] = np.zeros((7, 3), dtype=np.int8)
                file["status"].attrs["flag_values"] = np.arange(2, dtype=np.int8)
                file["status"].attrs["flag_meanings"] = "converged no_step"
            elif change == "one bit":
                file["wall"][3] = np.nextafter(file["wall"][3], 1)
            elif change == "space":
                file.attrs["design_space"] = "[{]"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("truncated", "truncated: the file ends before its data does"),
        ("empty", "not an HDF5 file"),
        ("text", "not an HDF5 file"),
        ("other HDF5", "an HDF5 file, but not a pba-dataset"),
        ("newer", "schema version 5; this program reads 1 to 4"),
        ("rows", "response has 7 rows, row_count says 8"),
        ("no variable", "damaged or incomplete:.*message"),
        ("no attribute", "incomplete: it has no attribute seed"),
        ("shape", r"status: \(7, 3\) is not allowed; allowed: shape \(7, 8\)"),
        ("one bit", "do not match their checksum"),
        ("space", "damaged or incomplete"),
    ],
)
def test_a_bad_file_is_one_clear_line(path: Path, change: str, told: str) -> None:
    spoil(path, change)
    with pytest.raises(FileError, match=told) as caught:
        Dataset.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="does not exist"):
        Dataset.read(tmp_path / "none.h5")
    with pytest.raises(FileError, match="is a folder"):
        Dataset.read(tmp_path)
    with pytest.raises(FileError, match="cannot be written: No such file"):
        sample(2).write(tmp_path / "none" / "data.h5")


def test_random_damage_is_told_before_hdf5_sees_it(data: Dataset, path: Path) -> None:
    random = np.random.default_rng(11)
    content = path.read_bytes()
    told = 0
    for _ in range(60):
        spoiled = bytearray(content)
        for place in random.integers(0, len(content), 4):
            spoiled[place] ^= 1 << int(random.integers(0, 8))
        path.write_bytes(spoiled)
        try:
            read = Dataset.read(path)
        except FileError as error:
            told += "its bytes do not match their checksum" in str(error)
        else:
            assert_same(data, read)
    assert told >= 58


def test_a_reader_of_the_older_file_is_not_disturbed(data: Dataset, path: Path) -> None:
    before = path.read_bytes()
    with path.open("rb") as reader:
        data.subset([0]).write(path)
        assert reader.read() == before
    assert len(Dataset.read(path)) == 1


def test_a_failed_write_leaves_the_older_file(
    data: Dataset, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("datagen.dataset._write", full)
    with pytest.raises(FileError, match="cannot be written: No space left on device"):
        data.subset([0]).write(path)
    monkeypatch.undo()
    assert_same(data, Dataset.read(path))
    assert [p.name for p in path.parent.iterdir()] == [path.name]
