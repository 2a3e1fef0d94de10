"""From effects to a folder with a model, through kill -9 at every stage."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from datagen.dataset import Dataset
from datagen.device import named_device
from datagen.errors import InputError
from datagen.parts import parts_folder
from datagen.pool import GivenExecutor
from datagen.response import Path as LoadPath
from datagen.worker import Row, Task
from service.cli import main
from surrogate import learn as learning
from surrogate.budget import one_path
from surrogate.corrected import Corrected
from surrogate.ensemble import Ensemble
from surrogate.increment import PairTask
from surrogate.learn import FORMER, INCREMENT, PLAN, learn
from tests.datagen.fake_solver import Here
from tests.discrepancy.versions import version
from tests.surrogate.learn_process import PATHS, SEED, run
from tests.surrogate.pairs import QUICK, means

ROOT = Path(__file__).parents[2]
FILES = ("model.json", "weights.safetensors", "base/weights.safetensors", INCREMENT)


@pytest.fixture(scope="module")
def finished(
    ensemble: Ensemble, dataset: Dataset, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """What an uninterrupted run gives, and beside it its base and dataset."""
    folder = tmp_path_factory.mktemp("learn")
    ensemble.save(folder / "base")
    dataset.write(folder / "paths.h5")
    run(Ensemble.load(folder / "base"), dataset, folder / "whole")
    return folder


def killed(finished: Path, out: Path, stage: str, count: int) -> int:
    """Exit status of a run in a process of its own."""
    command = [sys.executable, "-m", "tests.surrogate.learn_process"]
    given = [finished / "base", finished / "paths.h5", out, stage, count]
    return subprocess.run(
        [*command, *map(str, given)],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=False,
        timeout=100,
    ).returncode


def test_kill_and_resume(finished: Path, tmp_path: Path) -> None:
    """Killed in the increment, the training and the writing; then the same model."""
    out = tmp_path / "model"
    work = tmp_path / "model.work"
    for stage, count in (
        ("increment", 9),
        ("change", 2),
        ("publish", 1),
        ("publish", 5),
    ):
        assert killed(finished, out, stage, count) == -signal.SIGKILL, stage
        assert not out.exists()
        if stage == "increment":
            rows = parts_folder(work / INCREMENT).glob("row-*.json")
            assert len(list(rows)) == 8  # the first report is of none
    base, dataset = (
        Ensemble.load(finished / "base"),
        Dataset.read(finished / "paths.h5"),
    )
    model = run(base, dataset, out)
    assert not work.exists()
    assert model.version == Corrected.load(finished / "whole").version
    for name in FILES:
        assert (out / name).read_bytes() == (finished / "whole" / name).read_bytes()


def test_what_is_in_the_folder(finished: Path, dataset: Dataset) -> None:
    model = Corrected.load(finished / "whole")
    increment = Dataset.read(finished / "whole" / INCREMENT)
    assert len(increment) == PATHS
    assert increment.base == dataset.digest()
    assert model.description["increment"] == increment.digest()
    assert model.effects == ("soft", "tilt")
    assert not (finished / "whole.work").exists()


def test_the_command_judges_a_versions_surrogate(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the paths that it was trained from, where no others are given."""
    made = version().save(tmp_path / "first")
    command = ["accuracy", made.version, "--workspace", str(tmp_path), "--json"]
    assert main(command) == 2
    assert "pba models train" in capsys.readouterr().err
    shutil.copytree(finished / "whole", tmp_path / "first" / "surrogate")
    model = Corrected.load(finished / "whole")
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads(json.dumps(model.description["accuracy"]))
    other = [*command[:2], str(finished / "paths.h5"), *command[2:]]
    assert main(other) == 2  # without the effects
    assert "effects" in capsys.readouterr().err
    assert main(["accuracy", str(finished / "base")]) == 2
    assert "DATASET" in capsys.readouterr().err


def test_other_settings_are_refused(
    ensemble: Ensemble, dataset: Dataset, finished: Path, tmp_path: Path
) -> None:
    def again(out: Path, **changed: object) -> Corrected:
        settings: dict[str, object] = {
            "paths": PATHS,
            "seed": SEED,
            "executor": Here(),
            "resume": True,
            "settings": QUICK,
            "means": means("both"),
        }
        return learn(
            Ensemble.load(finished / "base"),
            dataset,
            ("tilt", "soft"),
            {},
            out,
            **(settings | changed),  # type: ignore[arg-type]
        )

    whole = finished / "whole"
    assert again(whole).version == Corrected.load(whole).version
    for changed, told in (
        ({"seed": 4}, "seed: 4 is not allowed; allowed: 3, as"),
        ({"paths": 30}, "paths: 30"),
        ({"near": [named_device()]}, "near"),
        ({"samples": np.array([[0.9, 0.1]])}, "samples"),
        ({"means": means("tilt")}, "ranges"),
        ({"resume": False}, "a folder that does not exist yet"),
    ):
        with pytest.raises(InputError, match=told):
            again(whole, **changed)
    begun = tmp_path / "m.work"
    begun.mkdir()
    (begun / PLAN).write_text(json.dumps({"seed": 1}))
    with pytest.raises(InputError, match=r"as .* was begun with"):
        again(tmp_path / "m")
    with pytest.raises(InputError, match="does not exist yet"):
        again(tmp_path / "m", resume=False)
    for changed, told in (
        ({"paths": 4}, "paths: 4 is not allowed; allowed: at least 16"),
        ({"minutes": 3.0}, "either paths or minutes"),
        ({"paths": None, "minutes": 0.0}, "minutes: 0 min"),
    ):
        with pytest.raises(InputError, match=told):
            again(tmp_path / "n", **changed)


def test_a_new_beginning(dataset: Dataset, finished: Path, tmp_path: Path) -> None:
    """Other settings: what was begun is discarded, what is there stays to the end."""

    def begin(out: Path, **changed: object) -> Corrected:
        settings: dict[str, object] = {
            "paths": 16,
            "executor": Here(),
            "settings": replace(QUICK, fit=replace(QUICK.fit, steps=50)),
            "means": means("tilt"),
            "resume": True,
        }
        base = Ensemble.load(finished / "base")
        return learn(base, dataset, ("tilt",), {}, out, **(settings | changed))  # type: ignore[arg-type]

    class Stop(Exception):
        pass

    def stop(stage: str, done: int, *_: object) -> None:
        if (stage, done) == ("increment", 4):
            raise Stop

    out, work = tmp_path / "m", tmp_path / "m.work"
    with pytest.raises(Stop):
        begin(out, report=stop)
    with pytest.raises(InputError, match=r"paths: 20 .* restart \(--restart\) begins"):
        begin(out, paths=20)
    with pytest.raises(Stop):
        begin(out, paths=20, restart="a", report=stop)
    assert len(list(parts_folder(work / INCREMENT).glob("row-*.json"))) == 4
    solved = []
    # The same beginning, as a job that is run again after a kill: it goes on.
    first = begin(
        out, paths=20, restart="a", report=lambda *now: solved.append(now[:2])
    )
    assert first.description["paths"] == 20 and not work.exists()
    assert min(done for stage, done in solved if stage == "increment") == 4
    assert begin(out, paths=20, restart="a").version == first.version
    with pytest.raises(Stop):
        begin(out, paths=17, restart="b", report=stop)
    assert Corrected.load(out).version == first.version
    assert begin(out, paths=17, restart="b").description["paths"] == 17
    assert Corrected.load(out).description["paths"] == 17 and not work.exists()
    # The command gives every beginning a name of its own: asked for once more it goes
    # on where it was stopped, and what is there serves until then.
    with pytest.raises(Stop):
        begin(out, paths=18, restart="c", report=stop)
    assert begin(out, paths=17).description["paths"] == 17
    solved.clear()
    last = begin(out, paths=18, restart="d", report=lambda *now: solved.append(now[:2]))
    assert last.description["paths"] == 18 and not work.exists()
    assert min(done for stage, done in solved if stage == "increment") == 4
    with pytest.raises(Stop):
        begin(out, paths=17, restart="e", report=stop)
    with pytest.raises(Stop):  # other settings: from the beginning
        begin(out, paths=16, restart="f", report=stop)
    plan = json.loads((work / PLAN).read_text())
    assert (plan["paths"], plan["restart"]) == (16, "f")
    with pytest.raises(Stop):
        begin(out, paths=16, restart="g", report=stop)
    assert json.loads((work / PLAN).read_text())["restart"] == "g"
    # Killed when it had made way and the new one was not in its place.
    os.replace(out, work / FORMER)
    assert begin(out, paths=18).version == last.version
    # Damage is no reason not to begin anew.
    shutil.rmtree(work)
    (out / "model.json").write_text("{")
    work.mkdir()
    (work / PLAN).write_text("[")
    assert begin(out, paths=16, restart="c").description["paths"] == 16


def test_one_that_is_finished_serves_other_samples(
    finished: Path, tmp_path: Path
) -> None:
    """Inside its stated ranges; outside nothing is written."""
    whole = Corrected.load(finished / "whole")
    samples = np.array([[0.9, 0.1], [0.92, 0.08]])
    out = tmp_path / "m"
    made = learning.hand_on(finished / "whole", out, samples, "parent")
    assert made is not None and made.version == Corrected.load(out).version
    np.testing.assert_array_equal(made.samples, samples)
    assert made.parameters["soft"]["factor"] == pytest.approx(0.91)
    assert made.description[learning.HANDED_ON] == "parent"
    assert made.description["accuracy"] == whole.description["accuracy"]
    some, paths = [named_device()], [LoadPath(np.array([10e3, 20e3]))]
    np.testing.assert_array_equal(
        made.marginal(some, paths).high, whole.marginal(some, paths, samples).high
    )
    assert (out / INCREMENT).read_bytes() == (
        finished / "whole" / INCREMENT
    ).read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["m"]
    for far in ([[0.69, 0.1]], [[0.9, 0.1], [0.9, 0.21]]):
        there = tmp_path / "n"
        assert learning.hand_on(finished / "whole", there, np.array(far), "p") is None
        assert not there.exists()
    begun = tmp_path / "n.work"
    begun.mkdir()
    (begun / PLAN).write_text("{}")
    assert learning.hand_on(finished / "whole", tmp_path / "n", samples, "p") is None


def test_two_at_once_are_refused(
    dataset: Dataset, finished: Path, tmp_path: Path
) -> None:
    """The second would discard what the first has in its working folder."""
    base = Ensemble.load(finished / "base")
    out = tmp_path / "m"
    told = []

    def second(stage: str, done: int, total: int, left: float | None) -> None:
        with pytest.raises(InputError, match="no other training is running") as error:
            learn(
                base, dataset, ("tilt",), {}, out, restart="again", means=means("tilt")
            )
        told.append(str(error.value))
        with pytest.raises(InputError, match="no other training is running"):
            learning.hand_on(finished / "whole", out, np.array([[0.9, 0.1]]), "p")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(
            base,
            dataset,
            ("tilt",),
            {},
            out,
            paths=16,
            workers=1,
            executor=Here(),
            report=second,
            means=means("tilt"),
        )
    assert told
    assert (tmp_path / "m.work" / PLAN).exists()  # untouched by the second


def test_time_budget(
    monkeypatch: pytest.MonkeyPatch, dataset: Dataset, finished: Path, tmp_path: Path
) -> None:
    """One path is timed; the number that follows is kept for a resumed run."""
    timed = iter([8.0])
    monkeypatch.setattr(learning, "one_path", lambda *_: next(timed))
    base = Ensemble.load(finished / "base")
    stopped = []

    def stop(stage: str, done: int, total: int, left: float | None) -> None:
        stopped.append((stage, done, total))
        if len(stopped) == 5:
            raise KeyboardInterrupt

    settings: dict[str, object] = {
        "minutes": 5.0,
        "workers": 1,
        "executor": Here(),
        "settings": replace(QUICK, fit=replace(QUICK.fit, steps=50)),
        "means": means("tilt"),
    }
    out = tmp_path / "m"
    with pytest.raises(KeyboardInterrupt):
        learn(base, dataset, ("tilt",), {}, out, report=stop, **settings)  # type: ignore[arg-type]
    assert stopped[0] == ("increment", 0, 16)  # 0.6 x 300 s / (8 s x 1.39)
    model = learn(base, dataset, ("tilt",), {}, out, resume=True, **settings)  # type: ignore[arg-type]
    assert model.description["paths"] == 16
    monkeypatch.setattr(learning, "one_path", lambda *_: 60.0)
    with pytest.raises(InputError, match=r"at least 37\.1: a path takes 83 s"):
        learn(base, dataset, ("tilt",), {}, tmp_path / "n", **settings)  # type: ignore[arg-type]
    assert not (tmp_path / "n.work").exists()  # those minutes can be asked for now


def test_a_path_is_timed_beside_others_once_the_workers_run() -> None:
    """Two workers, two paths of the middle at once; their first steps come before."""
    names = ("divisions_x", "divisions_y")
    tasks = [
        PairTask(i, names, (float(x), 1.0), (), "draft", 1e5, pressure=(1e3, 1e5))
        for i, x in enumerate((3, 1, 6, 2))
    ]
    seen: list[tuple[int, int]] = []
    together = Barrier(2, timeout=10)

    def solve(task: Task) -> Row:
        assert isinstance(task, PairTask)
        seen.append((task.row, len(task.pressure)))
        together.wait()
        time.sleep(0.05)
        nothing = np.zeros(0)
        return Row(task.row, (), nothing, np.zeros((0, 0)), nothing, "completed", 0, "")

    with ThreadPoolExecutor(2) as executor:
        seconds = one_path(tasks, GivenExecutor(executor, 2), 2, solve)
    assert seconds > 0.05 * 3 / 4.5  # for one of 3 balloons, the mean, of 3 and 6
    assert sorted(seen[:2]) == [(0, 1), (2, 1)]
    assert sorted(seen[2:]) == [(0, 2), (2, 2)]
