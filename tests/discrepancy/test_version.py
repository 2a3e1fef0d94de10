"""Model versions: a record that keeps, a folder that tells damage, workspaces."""

from __future__ import annotations

import json
import math
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.device import named_device
from datagen.effects import catalogue
from datagen.errors import EffectError, FileError, InputError, PbaError
from datagen.mesh import UPPER
from datagen.model import Model
from discrepancy.folder import effects_of
from discrepancy.ladder import Rung
from discrepancy.layout import BASELINE, MODEL, is_version
from discrepancy.version import ModelVersion
from discrepancy.workspace import CURRENT, LOCK, Workspace, locate, place
from surrogate.learn import _alone
from tests.discrepancy.versions import OWN, estimate, own_folder, own_version, version

# -- the record ----------------------------------------------------------------------


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    ladder = (*version().ladder[:3], Rung("noise floor", (), math.nan, math.nan, 1.0))
    made = version(ladder=ladder)
    written = made.save(tmp_path / "first")
    found = ModelVersion.load(tmp_path / "first")
    assert found.folder == written.folder == tmp_path / "first"
    assert found.version == made.version and len(made.version) == 12
    assert found.to_json() == made.to_json()
    assert np.array_equal(found.samples, made.samples)
    assert math.isnan(found.ladder[-1].heldout_error) and found.ladder[-1].high == 1
    assert [path.name for path in tmp_path.iterdir()] == ["first"]


def test_the_id_names_what_decides_the_answers() -> None:
    first = version()
    assert version(date="later", commit="abc", package="9").version == first.version
    renamed = tuple(replace(one, name="other.csv") for one in first.measurements)
    assert version(measurements=renamed, warnings=()).version == first.version
    for change in (
        {"mean": np.array([-0.0004])},
        {"samples": first.samples + 1e-12},
        {"parent": "0" * 12},
        {"seed": 4},
        {"sources": {"cure_mismatch": "0" * 64}},
        {"generator": "other"},
        {"measurements": (replace(first.measurements[0], devices=("S1",)),)},
        {"measurements": (replace(first.measurements[0], sha256="0" * 64),)},
    ):
        assert version(**change).version != first.version, change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"mean": np.zeros(2)}, "mean"),
        ({"covariance": np.array([[np.nan]])}, "covariance"),
        ({"samples": np.zeros((3, 2))}, "samples"),
        ({"effects": ()}, "effects"),
        ({"effects": ("mullins",)}, "cure_mismatch.difference"),
        ({"own": {"cure_mismatch": "../cure.py"}}, "../cure.py"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        version(**change)


def test_the_model_has_the_effects_at_their_means() -> None:
    made = version()
    model = made.forward()
    assert isinstance(model, Model) and model.level == "draft"
    growth = model.problem(named_device("S1")).growth
    wanted = Model(
        ("cure_mismatch",), "draft", {"cure_mismatch": {"difference": -0.0005}}
    )
    assert np.array_equal(growth, wanted.problem(named_device("S1")).growth)
    more = made.forward("standard", {"self_weight": {"density": 1000.0}})
    assert more.level == "standard" and more.effects == ("cure_mismatch", "self_weight")
    heavy = version(
        effects=("self_weight",),
        estimates=(estimate("self_weight.density", 900.0, 10.0),),
        mean=np.array([900.0]),
        sources={},
    )
    turned = heavy.forward(more={"self_weight": {"orientation": 3.0}})
    assert turned.parameters == {"self_weight": {"density": 900.0, "orientation": 3.0}}
    sample = made.parameters(made.samples[0])
    assert sample == {"cure_mismatch": {"difference": pytest.approx(-0.00051)}}


def test_what_changed_since_is_told() -> None:
    assert version().doubts() == ()
    old = version(generator="1", sources={"cure_mismatch": "0" * 64})
    first, second = old.doubts()
    assert "generator version 1" in first and "cure_mismatch was written" in second


# -- the folder ----------------------------------------------------------------------


def test_every_change_of_the_file_is_noticed(tmp_path: Path) -> None:
    version().save(tmp_path / "first")
    path = tmp_path / "first" / MODEL
    whole = json.loads(path.read_text())
    for name in whole:
        damaged = dict(whole)
        del damaged[name]
        path.write_text(json.dumps(damaged))
        with pytest.raises(FileError) as caught:
            ModelVersion.load(tmp_path / "first")
        assert str(caught.value).count("\n") == 0, name
    for name, value in (
        ("date", "2027"),
        ("seed", 4),
        ("mean", [-0.00051]),
        ("version", "0" * 12),
        ("samples", "none"),
        ("ladder", [{"rung": "baseline"}]),
        ("estimates", [{}]),
        ("measurements", 3),
    ):
        path.write_text(json.dumps(whole | {name: value}))
        with pytest.raises(FileError, match="damaged"):
            ModelVersion.load(tmp_path / "first")
    path.write_text(json.dumps(whole))
    assert ModelVersion.load(tmp_path / "first").seed == 3


def test_other_files_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"no model version: no model\.json in it"):
        ModelVersion.load(tmp_path)
    path = tmp_path / MODEL
    for text, says in (
        ("{", "not JSON"),
        ("[]", "is not a model version"),
        ('{"schema": "pba-ensemble"}', "is not a model version"),
        (
            '{"schema": "pba-model-version", "schema_version": 1}',
            "has schema version 1; this program reads 2",
        ),
    ):
        path.write_text(text)
        with pytest.raises(FileError, match=says):
            ModelVersion.load(tmp_path)


def test_nothing_is_overwritten_and_nothing_left_half(tmp_path: Path) -> None:
    version().save(tmp_path / "first")
    with pytest.raises(FileError, match="exists already"):
        version(seed=5).save(tmp_path / "first")
    assert ModelVersion.load(tmp_path / "first").seed == 3
    (tmp_path / "empty").mkdir()
    version().save(tmp_path / "empty")
    assert is_version(tmp_path / "empty")
    with pytest.raises(FileError, match="parent folder"):
        version().save(tmp_path / "no" / "where")
    own = own_version(own_folder(tmp_path / "effects"))
    with pytest.raises(FileError, match="cannot be written"):
        own.save(tmp_path / "second", tmp_path / "nowhere")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"first", "empty", "effects"}


def test_own_effects_travel_with_it(tmp_path: Path) -> None:
    folder = own_folder(tmp_path / "effects")
    own_version(folder).save(tmp_path / "first", folder)
    (folder / "shrunk_roof.py").unlink()
    found = ModelVersion.load(tmp_path / "first")
    problem = found.forward().problem(named_device("S1"))
    assert problem.growth is not None
    roof = problem.growth[problem.mesh.layer == UPPER]
    assert np.allclose(roof, 0.9995 * np.eye(3))
    copy = tmp_path / "first" / "effects" / "shrunk_roof.py"
    copy.write_text(OWN + "\n")
    with pytest.raises(FileError, match="was changed after the adoption"):
        ModelVersion.load(tmp_path / "first")
    copy.unlink()
    with pytest.raises(FileError, match="shrunk_roof is written in it"):
        ModelVersion.load(tmp_path / "first")


def test_an_effect_that_is_edited_while_it_is_fitted_is_refused(tmp_path: Path) -> None:
    """What would be copied is not what was fitted."""
    folder = own_folder(tmp_path / "effects")
    fitted = own_version(folder)
    own_folder(folder, OWN + "\n# another\n")
    with pytest.raises(FileError, match="changed while it was fitted: adopt again"):
        fitted.save(tmp_path / "first", folder)
    assert not (tmp_path / "first").exists()


def test_an_effect_that_needs_a_file_beside_it_is_refused(tmp_path: Path) -> None:
    text = "from pathlib import Path\n\nPath(__file__).with_name('t').read_text()\n"
    folder = own_folder(tmp_path / "effects", OWN + text)
    (folder / "t").write_text("1")
    with pytest.raises(EffectError, match="FileNotFoundError"):
        own_version(folder).save(tmp_path / "first", folder)
    assert not (tmp_path / "first").exists()


def test_own_effects_of_two_folders_act_together(tmp_path: Path) -> None:
    folder = own_folder(tmp_path / "effects")
    parent = own_version(folder).save(tmp_path / "first", folder)
    other = tmp_path / "more"
    other.mkdir()
    (other / "stiff.py").write_text(OWN.replace("shrunk_roof", "stiff"))
    with effects_of(parent, other) as both:
        assert {"shrunk_roof", "stiff"} <= set(catalogue(both))
    with effects_of(parent, None) as alone:
        assert alone == tmp_path / "first" / "effects"
    (other / "shrunk_roof.py").write_text(OWN + "\n# refined\n")
    with (
        pytest.raises(EffectError, match="leave that version out"),
        effects_of(parent, other),
    ):
        pass


# -- workspaces ----------------------------------------------------------------------


@pytest.fixture
def home(tmp_path: Path) -> Workspace:
    """Three versions, the second on top of the first."""
    home = Workspace(tmp_path / "lab")
    home.make()
    first = version(date="2026-01-01").save(home.folder / "b")
    version(seed=4, parent=first.version, date="2026-01-02").save(home.folder / "a")
    version(seed=5, date="2026-01-03").save(home.folder / "c")
    return home


def test_versions_are_found_by_name_and_id(home: Workspace) -> None:
    assert [one.name for one in home.entries()] == ["b", "a", "c"]
    for one in home.entries():
        assert one.version is not None
        assert home.find(one.name).name == one.name
        assert home.find(one.version.version[:6]).name == one.name
    for text in ("d", "", "../lab/a", home.find("a").version.version[:3]):  # type: ignore[union-attr]
        with pytest.raises(InputError, match="allowed: baseline, b, a, c"):
            home.find(text)


def test_folders_with_one_id_are_one_model(home: Workspace) -> None:
    first = home.find("b").version
    assert first is not None
    version(date="2026-01-04", warnings=()).save(home.folder / "twin")
    twin = home.find(first.version)
    assert twin.version is not None and twin.version.version == first.version
    assert home.remove("b") == ()  # the parent of `a` is still there
    assert home.find(first.version).name == "twin"


def test_use_and_undo(home: Workspace) -> None:
    assert home.current() is None
    for name in ("a", "b", "b", "baseline", "c"):
        assert home.use(name) == name
    current = home.current()
    assert current is not None and current.name == "c"
    for name in ("baseline", "b", "a", "baseline"):
        assert home.undo() == name == home.current_name
    with pytest.raises(InputError, match="in use before"):
        home.undo()


def test_what_was_deleted_by_hand_is_no_dead_end(home: Workspace) -> None:
    identity = home.find("a").version
    assert identity is not None
    for name in ("c", "b", "a"):
        home.use(name)
    shutil.rmtree(home.folder / "b")
    assert home.undo() == "c"
    home.use("a")
    shutil.rmtree(home.folder / "a")
    # No other version whose id begins so answers in its place.
    stand_in = home.folder / identity.version[:6]
    version(seed=9).save(stand_in)
    with pytest.raises(FileError, match="a: was in use, and is no version any more"):
        home.current()
    assert home.undo() == "c"


def test_what_is_removed_by_its_id_is_named(home: Workspace) -> None:
    one = home.find("c").version
    assert one is not None
    assert home.remove(one.version) == ("its folder was c",)


def test_a_version_in_training_stays(home: Workspace) -> None:
    training = _alone(home.folder / "c" / "surrogate")
    with training, pytest.raises(InputError, match="not in training"):
        home.remove("c")
    home.remove("c")


def test_a_file_is_no_workspace(tmp_path: Path) -> None:
    (tmp_path / "lab").write_text("")
    home = Workspace(tmp_path / "lab")
    for act in (home.current, home.entries, lambda: home.find("a")):
        with pytest.raises(FileError, match="lab: is no folder, and so no workspace"):
            act()


def test_remove_keeps_what_is_needed(home: Workspace) -> None:
    for name in ("b", "c", "b", "a"):
        home.use(name)
    with pytest.raises(InputError, match="not in use"):
        home.remove("a")
    with pytest.raises(InputError, match=r"no parent \(of a\)"):
        home.remove("b")
    with pytest.raises(InputError, match="baseline always stays"):
        home.remove("baseline", force=True)
    assert home.remove("c") == ()
    assert home.undo() == "b"
    assert home.undo() == "baseline"
    home.use("b")
    assert home.remove("b", force=True) == (
        "it was in use; the baseline is in use now",
        "it was the parent of a",
    )
    assert home.current() is None
    left = sorted(path.name for path in home.folder.iterdir())
    assert left == [LOCK, "a", CURRENT]


def test_nothing_comes_into_use_that_is_not_ready(home: Workspace) -> None:
    def ready(one: ModelVersion) -> None:
        raise FileError(one.folder, "has a damaged surrogate")

    home.use("a")
    home.use("b")
    for act in (lambda: home.use("c", ready), lambda: home.undo(ready)):
        with pytest.raises(FileError, match="damaged surrogate"):
            act()
        assert home.current_name == "b"
    shutil.rmtree(home.folder / "a")
    assert home.undo() == "baseline"


def _changes(folder: Path, seed: int, start: Any) -> None:
    """Body of a process: puts one version after the other into use, removes some."""
    home, order = Workspace(folder), np.random.default_rng(seed)
    start.wait()
    for name in order.permutation([f"v{i}" for i in range(6)]):
        with suppress(InputError):
            home.use(str(name))
        with suppress(InputError):
            home.remove(str(name), force=bool(order.random() < 0.5))


def test_changes_at_a_time_lose_nothing(tmp_path: Path) -> None:
    home = Workspace(tmp_path)
    for i in range(8):
        version(seed=i).save(home.folder / f"v{i}")
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(home.use, [f"v{i}" for i in range(8)]))
    seen = {home.current_name} | {home.undo() for _ in range(8)}
    assert seen == {"baseline", *(f"v{i}" for i in range(8))}

    context = get_context("fork")
    start = context.Barrier(4)
    others = [
        context.Process(target=_changes, args=(tmp_path, seed, start))
        for seed in range(4)
    ]
    for one in others:
        one.start()
    for one in others:
        one.join()
        assert one.exitcode == 0
    left = {one.name for one in home.entries()}
    history = json.loads((tmp_path / CURRENT).read_text())
    assert {*history["before"], history["current"]} <= {"baseline", *left}


def test_a_damaged_version_is_listed_and_can_be_removed(home: Workspace) -> None:
    path = home.folder / "c" / MODEL
    path.write_text(path.read_text().replace('"seed": 5', '"seed": 6'))
    last = home.entries()[-1]
    assert (last.name, last.version) == ("c", None) and "damaged" in last.problem
    with pytest.raises(FileError, match="damaged"):
        home.use("c")
    home.remove("c")
    assert [one.name for one in home.entries()] == ["b", "a"]
    (home.folder / "a" / MODEL).write_text('{"schema": "pba-mo')
    assert [one.name for one in home.entries()] == ["b", "a"]
    with pytest.raises(FileError, match="damaged"):
        home.find("a")


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        '{"schema": "pba-workspace", "schema_version": 9}',
        '{"schema": "pba-workspace", "schema_version": 1, "current": 3, "before": []}',
        '{"schema": "pba-workspace", "schema_version": 1, "current": "../x", '
        '"before": []}',
    ],
)
def test_a_damaged_current_is_one_line(home: Workspace, text: str) -> None:
    (home.folder / CURRENT).write_text(text)
    for act in (home.current, home.undo):
        with pytest.raises(FileError) as caught:
            act()
        assert CURRENT in str(caught.value) and "\n" not in str(caught.value)
    if '"schema_version": 9' in text:  # a newer program's, which is not overwritten
        with pytest.raises(FileError, match="schema version 9"):
            home.use("a")
        return
    # Whatever is put into use repairs it.
    assert home.use("a") == home.current_name == "a"
    assert home.undo() == BASELINE
    (home.folder / CURRENT).write_text(text)
    assert home.use(BASELINE) == home.current_name == BASELINE


def test_where_a_version_goes(home: Workspace, tmp_path: Path) -> None:
    other = tmp_path / "other"
    assert place("new", home.folder) == (home.folder / "new", home)
    assert place(str(tmp_path / "m"), other) == (tmp_path / "m", None)
    new = home.folder / "new"  # beside versions, but not of the chosen workspace
    assert place(str(new), other) == (new, None)
    assert place(str(new), home.folder) == (new, home)
    for name in ("baseline", ".x", "a b", CURRENT, "", ".", 101 * "x"):
        with pytest.raises(InputError, match="--out"):
            place(name, home.folder)


def test_where_a_version_is(
    home: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert locate("a", home.folder) == home.folder / "a"
    assert locate(str(home.folder / "a"), tmp_path) == home.folder / "a"
    assert locate("a", tmp_path / "nothing") == Path("a")
    monkeypatch.setenv("PBA_WORKSPACE", str(home.folder))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()  # a folder of that name here is another thing
    assert locate("a") == home.folder / "a"
    assert locate("./a") == Path("a")
    (tmp_path / "d").mkdir()
    assert locate("d") == Path("d")
    (tmp_path / "d").rmdir()
    with pytest.raises(PbaError, match="baseline, b, a, c"):
        locate("d")


def test_a_version_of_another_kind_is_no_entry(home: Workspace) -> None:
    (home.folder / "ensemble").mkdir()
    (home.folder / "ensemble" / MODEL).write_text('{"schema": "pba-ensemble"}')
    (home.folder / ".hidden").mkdir()
    replace(version(), seed=9).save(home.folder / "d")
    assert [one.name for one in home.entries()] == ["b", "a", "d", "c"]
