"""The surrogate of a version: ranges, samples, who answers, and what refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from datagen.device import DESIGN_SPACE
from datagen.effects import catalogue
from datagen.errors import InputError
from datagen.response import Path as LoadPath
from datagen.space import Space
from discrepancy.folder import read
from discrepancy.version import Estimate, Measured, ModelVersion
from discrepancy.workspace import Workspace
from service.app import KINDS, Settings, create_app
from service.bench import plain
from service.current import Switch
from service.surrogates import (
    SAMPLES,
    AdoptedSurrogate,
    about,
    declared,
    learned,
    lines,
    load,
    train,
)
from surrogate.corrected import Corrected
from surrogate.ensemble import reference_model
from surrogate.equivalent import same_device
from surrogate.learn import INCREMENT
from surrogate.shift import no_shift
from tests.discrepancy.made import measured
from tests.discrepancy.versions import version
from tests.service.fakes import FakeSurrogate
from tests.service.test_models import ASKED


def weight() -> Estimate:
    return Estimate(
        name="self_weight.density",
        unit="kg/m3",
        value=1000.0,
        std=20.0,
        low=960.0,
        high=1040.0,
        lower=900.0,
        upper=1300.0,
        plausibility="plausible",
        source="made up",
    )


def test_ranges_hold_the_fit_and_samples_are_its_posterior() -> None:
    made = version()
    ranges, samples = learned(made, declared(made, None))
    lower, upper = ranges["cure_mismatch.difference"]
    assert lower < made.mean[0] < upper
    assert samples.shape[1] == 1 and 2 <= len(samples) <= SAMPLES
    assert set(samples[:, 0]) <= set(made.samples[:, 0])


def test_what_is_not_inferred_stays_at_off() -> None:
    """Orientation is the measurement's; predictions are made for a strip that lies."""
    made = version(
        effects=("self_weight",),
        estimates=(weight(),),
        mean=np.array([1000.0]),
        covariance=np.array([[400.0]]),
        samples=1000.0 + np.linspace(-30, 30, 7)[:, None],
        sources={},
    )
    parameters = declared(made, None)
    ranges, samples = learned(made, parameters)
    assert list(parameters) == ["self_weight.density", "self_weight.orientation"]
    off = catalogue()["self_weight"].space["orientation"].off
    assert set(samples[:, 1]) == {off}
    low, high = ranges["self_weight.orientation"]
    assert low <= off <= high and high - low < 0.2


@pytest.mark.parametrize("effect", ["viscoelasticity", "mullins"])
def test_effects_with_a_memory_have_no_surrogate(effect: str, tmp_path: Path) -> None:
    one = catalogue()[effect].parameters
    estimates = tuple(
        Estimate(
            name=f"{effect}.{p.name}",
            unit=p.unit,
            value=0.5 * (p.lower + p.upper),
            std=0.01 * (p.upper - p.lower),
            low=p.lower,
            high=p.upper,
            lower=p.lower,
            upper=p.upper,
            plausibility="plausible",
            source=p.source,
        )
        for p in one
    )
    mean = np.array([e.value for e in estimates])
    made = version(
        effects=(effect,),
        estimates=estimates,
        mean=mean,
        covariance=np.diag([e.std**2 for e in estimates]),
        samples=np.tile(mean, (5, 1)),
        sources={},
    ).save(tmp_path / "made")
    with pytest.raises(InputError, match=effect):
        train(made, paths=16)
    assert made.surrogate is None


def refitted(
    home: Workspace, std: float = 1e-6, **changes: Any
) -> tuple[ModelVersion, ModelVersion]:
    """A version with a surrogate, and one on top of it that was fitted again."""
    first = home.find("first").version
    assert first is not None and first.folder is not None
    learned_over(-0.001, 0.0, first.folder / "surrogate")
    samples = -0.0004 + std * np.linspace(-1, 1, 9)[:, None]
    given = {"parent": first.version, "samples": samples} | changes
    second = version(-0.0004, **given).save(home.folder / "second")
    return first, second


def learned_over(lower: float, upper: float, folder: Path) -> None:
    """A surrogate of a stated range that was never trained: it is not asked here."""
    base = reference_model()
    difference = replace(
        catalogue()["cure_mismatch"].space["difference"],
        name="cure_mismatch.difference",
        lower=lower,
        upper=upper,
    )
    Corrected(
        base=base,
        space=Space((*DESIGN_SPACE, difference)),
        effects=("cure_mismatch",),
        equivalent=same_device(1),
        shift=no_shift(np.zeros((1, 3)), 1, 2),
        change=base.expansion,
        calibration=base.calibration,
        description={"paths": 16, "base": base.version, "level": "standard"},
        samples=np.array([[-0.0005]]),
    ).save(folder)
    (folder / INCREMENT).write_bytes(b"paths")


def test_a_refitted_version_takes_its_parents(home: Workspace) -> None:
    first, second = refitted(home)
    made = train(second)
    assert made.version == second.version and second.surrogate is not None
    np.testing.assert_array_equal(made.corrected.samples, second.samples)
    assert about(made)["handed_on"] == first.version
    assert any(first.version in line for line in lines(made))
    assert train(second).corrected.version == made.corrected.version
    with pytest.raises(InputError, match=f"--restart.*{first.version} serves here"):
        train(second, paths=16)


class Begun(Exception):
    """Training began."""


@pytest.mark.parametrize(
    "changes",
    [
        {"std": 1e-3},
        {"generator": "0"},
        {"sources": {"cure_mismatch": "0" * 64}},
        {"parent": "0" * 12},
    ],
)
def test_a_parents_surrogate_that_does_not_hold(
    home: Workspace, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A posterior that leaves its ranges, or numbers that were made otherwise."""
    _, second = refitted(home, **changes)

    def begun(*_: object, **options: object) -> None:
        raise Begun

    monkeypatch.setattr("surrogate.learn.learn", begun)
    with pytest.raises(Begun):
        train(second)
    assert second.surrogate is None


def test_designs_that_were_measured_are_wanted_most(
    home: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = measured({})[0]
    twice = replace(whole.curves[0], run=2)
    files = (
        Measured.of(whole),
        Measured.of(replace(whole, curves=(twice,), source="more.csv")),
    )
    made = version(measurements=files).save(home.folder / "third")
    given: dict[str, Any] = {}

    def begun(*_: object, **options: Any) -> None:
        given.update(options)
        raise Begun

    monkeypatch.setattr("surrogate.learn.learn", begun)
    with pytest.raises(Begun):
        train(read(home.folder / "third"), paths=16, restart="a")
    assert given["near"] == tuple(one.design for one in whole.curves)
    assert given["restart"] == "a" and made.measurements == files


class Quick(FakeSurrogate):
    """What `AdoptedSurrogate` needs of a corrected surrogate."""

    def marginal(
        self, designs: list[object], paths: list[LoadPath], coverage: float = 0.9
    ) -> object:
        return self.predict(designs, paths, coverage)  # type: ignore[arg-type]


@pytest.fixture
def home(tmp_path: Path) -> Workspace:
    made = Workspace(tmp_path / "models")
    made.make()
    version().save(made.folder / "first")
    return made


def test_a_surrogate_answers_as_soon_as_it_is_there(
    home: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    home.use("first")
    switch = Switch(FakeSurrogate(), "reference", home)
    assert switch.now().model is None
    made = switch.now().version
    assert made is not None and made.folder is not None
    quick = AdoptedSurrogate(made.version, Quick())  # type: ignore[arg-type]
    monkeypatch.setattr("service.current.load", lambda one: quick)
    (made.folder / "surrogate").mkdir()
    assert switch.now().model is quick
    assert switch.now().model_version == made.version


def test_a_training_that_ends_meanwhile_fails_no_answer(
    home: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its working folder goes while the version is looked through."""
    home.use("first")
    switch = Switch(FakeSurrogate(), "reference", home)
    monkeypatch.setattr("service.current.load", lambda one: None)
    work = home.folder / "first" / "surrogate.work"

    def publish() -> None:
        for _ in range(100):
            (work / "rows" / "a").mkdir(parents=True)
            (work / "model").mkdir()
            shutil.rmtree(work)

    with ThreadPoolExecutor(1) as pool:
        publishing = pool.submit(publish)
        while not publishing.done():
            now = switch.now()
            assert (now.name, now.problem) == ("first", "")
        publishing.result()


def test_what_a_job_has_kept_of_a_surrogate_is_that_surrogate(home: Workspace) -> None:
    """By which a server tells that it is still the one."""
    first, _ = refitted(home)
    made = load(first)
    assert made is not None
    assert plain(about(made)) == json.loads(json.dumps(about(made)))


@pytest.fixture
def client(home: Workspace, tmp_path: Path) -> Iterator[TestClient]:
    settings = Settings(tmp_path / "state", workspace=home.folder, kinds=KINDS)
    app = create_app(settings, lambda _folder: FakeSurrogate())
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


def test_the_versions_surrogate_answers_over_http(
    client: TestClient, home: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = AdoptedSurrogate("fitted-1", Quick())  # type: ignore[arg-type]
    monkeypatch.setattr("service.current.load", lambda one: quick)
    client.put("/v1/models/current", json={"model": "first"})
    answer = client.post("/v1/predict", json=ASKED).json()
    assert (answer["source"], answer["effects"]) == ("surrogate", ["cure_mismatch"])
    assert answer["model_version"] == "fitted-1"


def test_training_asked_for_wrongly(client: TestClient) -> None:
    for body, word in (
        ({"minutes": -1}, "minutes"),
        ({"paths": 2.5}, "paths"),
        ({"hours": 1}, "hours"),
        ({"restart": "again"}, "restart"),
        ({"paths": 15}, "equal to 16"),
        ({"paths": 20, "minutes": 3.0}, "either paths or minutes"),
    ):
        answer = client.post("/v1/models/first/surrogate", json=body)
        assert answer.status_code == 422 and word in answer.text, answer.text
    assert client.post("/v1/models/none/surrogate", json={}).status_code == 404
    for name in ("baseline", "reference"):
        answer = client.post(f"/v1/models/{name}/surrogate", json={})
        assert answer.status_code == 422 and "adopted effects" in answer.text


def test_a_new_beginning_is_a_job_of_its_own(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same question is the same job, but to begin anew is meant each time."""
    body = {"minutes": 0.1}
    for other, same in (({}, True), ({"restart": True}, False)):
        ids = {
            client.post("/v1/models/first/surrogate", json=body | other).json()["id"]
            for _ in range(2)
        }
        assert (len(ids) == 1) is same
        for one in ids:
            client.delete(f"/v1/jobs/{one}")
