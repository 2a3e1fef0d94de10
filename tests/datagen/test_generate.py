"""Generation: the same values on any executor, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from threadpoolctl import threadpool_info, threadpool_limits

from datagen.dataset import Dataset
from datagen.device import DESIGN_SPACE
from datagen.errors import EffectError, FileError, GenerationError, InputError
from datagen.generate import Progress, generate, sampled_space
from datagen.model import GENERATOR_VERSION, Model
from datagen.worker import Row, Task

from . import fake_solver
from .fake_solver import VERSION, solve_fake, solve_slowly
from .making import alone, make

ROOT = Path(__file__).parents[2]


def test_every_row_is_there_with_its_own_design(tmp_path: Path, whole: Dataset) -> None:
    out = tmp_path / "data.h5"
    data = make(out)
    assert alone(out)
    assert Dataset.read(out).digest() == data.digest() == whole.digest()
    assert_array_equal(data.inputs, DESIGN_SPACE.sample(12, 3))
    assert (data.seed, data.level, data.effects) == (3, "standard", ())
    assert data.generator_version == VERSION
    for i, inputs in enumerate(data.inputs.tolist()):
        row = solve_fake(Task(i, data.variables, tuple(inputs), (), "standard", 150e3))
        steps = data.steps(i)
        assert_array_equal(data.values[i, :steps], row.values)
        assert_array_equal(data.pressure[i, :steps], row.pressure)
        assert data.path_status[i] == row.path_status
        assert data.message[i] == row.message
        assert_array_equal(data.limit_pressure[i], row.limit_pressure)


def test_one_and_two_processes_give_the_same(tmp_path: Path, whole: Dataset) -> None:
    for workers in (1, 2):
        out = tmp_path / f"{workers}.h5"
        make(out, executor=None, workers=workers, solve=solve_slowly)
        assert Dataset.read(out).digest() == whole.digest()
    one, two = (tmp_path / f"{workers}.h5" for workers in (1, 2))
    assert one.read_bytes() == two.read_bytes()


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**63 - 1),
    count=st.integers(1, 9),
    workers=st.integers(2, 5),
)
def test_any_number_of_workers_gives_the_same(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int, workers: int
) -> None:
    folder = tmp_path_factory.mktemp("workers")
    one = make(folder / "one.h5", count, seed)
    with ThreadPoolExecutor(workers) as threads:
        many = make(folder / "many.h5", count, seed, executor=threads, workers=workers)
    assert one.digest() == many.digest()
    assert len(many) == count


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two Dask workers behind loopback sockets."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        protocol="tcp",
        dashboard_address=None,
    ) as cluster:
        yield cluster


def test_a_dask_cluster_gives_the_same(
    tmp_path: Path, whole: Dataset, cluster: Any
) -> None:
    options = {"executor": None, "scheduler": cluster.scheduler_address}
    data = make(tmp_path / "a.h5", **options)
    assert data.digest() == whole.digest()
    with pytest.raises(GenerationError, match="row 3 failed: ZeroDivisionError"):
        make(tmp_path / "b.h5", solve=fake_solver.solve_with_bug, **options)


def test_a_dask_cluster_that_goes_away_is_told(
    tmp_path: Path, whole: Dataset, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("datagen.pool.DASK_PATIENCE", 1)
    out, address = tmp_path / "a.h5", cluster.scheduler_address

    def close(progress: Progress) -> None:
        if progress.done == 4:
            cluster.close()

    with pytest.raises(GenerationError, match=r"scheduler at .* is gone; \d+ of 12"):
        make(out, executor=None, scheduler=address, progress=close)
    assert make(out, resume=True).digest() == whole.digest()


def test_a_scheduler_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scheduler: 'nonsense://x' is not allowed"):
        make(tmp_path / "a.h5", executor=None, scheduler="nonsense://x")
    assert list(tmp_path.iterdir()) == []


def test_rows_are_solved_on_one_thread(tmp_path: Path) -> None:
    solve = fake_solver.solve_and_say_threads
    with threadpool_limits(limits=2):
        data = make(tmp_path / "here.h5", 2, solve=solve)
        assert max(pool["num_threads"] for pool in threadpool_info()) == 2
    assert_array_equal(data.values[:, 0, 0], 1)
    data = make(tmp_path / "there.h5", 2, executor=None, solve=solve)
    assert_array_equal(data.values[:, 0, 0], 1)


def test_the_finite_elements_in_a_worker(tmp_path: Path) -> None:
    """The worker gets effects, level and pressure, and solves as we do here."""
    data = generate(
        1,
        5,
        tmp_path / "a.h5",
        effects=["self_weight"],
        level="draft",
        max_pressure=2e3,
    )
    assert data.generator_version == GENERATOR_VERSION
    model = Model(("self_weight",), "draft", data.effect_parameters(0))
    with threadpool_limits(limits=1):
        response = model.explore(data.design(0), 2e3)
    assert response.pressure[0, -1] == data.max_pressure == 2e3
    assert_array_equal(data.pressure, response.pressure)
    assert_array_equal(data.values, response.values)
    with pytest.raises(InputError, match="level"):
        generate(1, 5, tmp_path / "b.h5", level="finest")


def test_progress_counts_rows_and_failures(tmp_path: Path) -> None:
    seen: list[Progress] = []
    make(tmp_path / "a.h5", progress=seen.append)
    assert [step.done for step in seen] == list(range(13))
    assert {step.total for step in seen} == {12}
    assert seen[0].rate == 0
    assert seen[0].seconds_left is None
    assert seen[-1].failed == 4  # every third path of the fake ends inverted
    assert seen[-1].seconds_left == 0
    assert seen[6].rate > 0
    assert seen[6].seconds_left == pytest.approx(6 / seen[6].rate)


def test_only_a_few_rows_are_in_flight(tmp_path: Path) -> None:
    class Watched(ThreadPoolExecutor):
        flying = most = 0

        def submit(self, *args: Any) -> Future[Any]:  # type: ignore[override]
            future = super().submit(*args)
            self.flying += 1
            self.most = max(self.most, self.flying)
            return future

    with Watched(2) as threads:

        def landed(_: Progress) -> None:
            threads.flying -= 1

        threads.flying = 1  # the first report comes before any row
        make(tmp_path / "a.h5", 30, executor=threads, workers=2, progress=landed)
    assert 2 <= threads.most <= 4


def test_a_hypercube_is_solved_in_parts(tmp_path: Path) -> None:
    whole = make(tmp_path / "whole.h5", sensitivities=5)
    part = make(tmp_path / "part.h5", first=7, sensitivities=5)
    assert (len(part), part.hypercube, whole.hypercube) == (7, 12, 0)
    assert Dataset.read(tmp_path / "part.h5").digest() == part.digest()
    assert_array_equal(part.inputs, whole.inputs[:7])
    solved = []

    def solve(task: Task) -> Row:
        solved.append(task.row)
        return solve_fake(task)

    extended = make(
        tmp_path / "again.h5",
        extend=tmp_path / "part.h5",
        sensitivities=5,
        solve=solve,
    )
    assert sorted(solved) == [7, 8, 9, 10, 11]
    assert extended.digest() == whole.digest()
    more = make(
        tmp_path / "more.h5", extend=tmp_path / "part.h5", first=9, sensitivities=5
    )
    assert (len(more), more.hypercube) == (9, 12)
    assert more.subset(range(7)).digest() == part.subset(range(7)).digest()
    # The finished part answers the same command again, and no other one.
    again = make(tmp_path / "part.h5", first=7, sensitivities=5, resume=True)
    assert again.digest() == part.digest()
    with pytest.raises(InputError, match="designs: 8 is not allowed; allowed: 7"):
        make(tmp_path / "part.h5", first=8, sensitivities=5, resume=True)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seed": 4}, "seed: 4 is not allowed; allowed: 3, as .* was begun with"),
        ({"count": 13}, "extend: .*7 of 12 designs.*the first of 13 designs"),
        ({"first": 6}, "extend: .*7 of 12 designs.* 6 at most"),
        ({"version": "other"}, "generator_version: 'other' is not"),
        ({"sensitivities": 3}, "sensitivities: 3 is not allowed; allowed: 0"),
        ({"max_pressure": 1e5}, "max_pressure: 100000 Pa"),
        ({"first": 13}, "first: 13 is not allowed"),
        ({"sensitivities": 9, "first": 8}, "sensitivities: 9 is not allowed"),
    ],
)
def test_other_rows_are_not_taken_over(
    tmp_path: Path, options: dict[str, Any], told: str
) -> None:
    make(tmp_path / "part.h5", first=7)
    with pytest.raises(InputError, match=told):
        make(tmp_path / "a.h5", extend=tmp_path / "part.h5", **options)
    assert alone(tmp_path / "part.h5")


# What a run refuses.


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"count": 0}, r"designs: 0 is not allowed; allowed: a whole number from 1"),
        ({"count": 2.5}, "designs: 2.5 is not"),
        ({"count": True}, "designs: True is not"),
        ({"seed": -1}, "seed: -1 is not"),
        ({"seed": 2**63}, "seed: 9223372036854775808 is not"),
        ({"workers": 0}, "workers: 0 is not"),
        ({"max_pressure": float("nan")}, "max_pressure: nan Pa is not"),
        ({"max_pressure": -5.0}, "max_pressure: -5 Pa is not"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "scheduler: .* no executor beside it"),
    ],
)
def test_settings_out_of_range(
    tmp_path: Path, options: dict[str, Any], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        make(tmp_path / "a.h5", **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_not_touched(tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    out.write_text("mine")
    with pytest.raises(InputError, match="a file that does not exist yet; --resume"):
        make(out)
    with pytest.raises(FileError, match="not an HDF5 file"):
        make(out, resume=True)
    assert out.read_text() == "mine"
    assert alone(out)


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written: No such file"):
        make(tmp_path / "none" / "a.h5")


# Effects.


def test_parameters_of_effects_are_further_columns(tmp_path: Path) -> None:
    space = sampled_space(("cure_mismatch", "self_weight"))
    assert space.names[: len(DESIGN_SPACE)] == DESIGN_SPACE.names
    further = space.names[len(DESIGN_SPACE) :]
    assert {name.split(".")[0] for name in further} == {"cure_mismatch", "self_weight"}
    out = tmp_path / "a.h5"
    data = make(out, effects=["self_weight", "cure_mismatch"])
    assert data.effects == ("cure_mismatch", "self_weight")
    assert data.variables == space.names
    assert_array_equal(data.inputs, space.sample(12, 3))
    parameters = Dataset.read(out).effect_parameters(5)
    flat = {f"{e}.{p}": v for e, ps in parameters.items() for p, v in ps.items()}
    assert flat == dict(zip(further, data.inputs[5, len(DESIGN_SPACE) :], strict=True))


def test_unknown_and_doubled_effects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(EffectError, match=r"'magic' is unknown; .*self_weight"):
        make(tmp_path / "a.h5", effects=["magic"])
    with pytest.raises(InputError, match="each effect once"):
        make(tmp_path / "a.h5", effects=["self_weight", "self_weight"])
