"""An adoption with the version it makes, for the command line and for jobs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from datagen.effects import catalogue
from datagen.errors import FileError, InputError
from datagen.model import GENERATOR_VERSION
from discrepancy.adopt import Adoption, joined, refuse
from discrepancy.adopt import adopt as fit
from discrepancy.folder import effects_of, vacant
from discrepancy.layout import BASELINE, is_version
from discrepancy.measurement import Measurements
from discrepancy.paths import Paths
from discrepancy.provenance import source_digest
from discrepancy.solves import Solver
from discrepancy.study import Study
from discrepancy.version import ModelVersion
from discrepancy.workspace import Workspace, locate, place

from .adoption import adoption_json


@dataclass(frozen=True, eq=False)
class Adopted:
    """Effects in the model, and the version that was written.

    Parameters
    ----------
    made : Adoption
    version : ModelVersion
        As it was saved.
    home : Workspace or None
        Where it is a version of; None for a folder elsewhere.
    in_use : bool
    lineage : tuple of str
        What it leaves behind of the version it is built on, one line each.
    page : str
        The report, one HTML file; empty where none was asked for.
    """

    made: Adoption
    version: ModelVersion
    home: Workspace | None
    in_use: bool
    lineage: tuple[str, ...]
    page: str

    @property
    def warnings(self) -> list[str]:
        return [
            *self.made.study.measurements.warnings,
            *self.made.warnings,
            *self.lineage,
        ]

    def to_json(self) -> dict[str, Any]:
        """The contract's object of ``pba adopt --json``."""
        return adoption_json(self.made, self.version) | {
            "workspace": str(self.home.folder) if self.home else None,
            "in_use": self.in_use,
            "surrogate": self.version.surrogate is not None,
            "warnings": self.warnings,
        }


def adopted(
    names: Sequence[str],
    measured: Sequence[Measurements],
    solving: AbstractContextManager[Solver],
    *,
    out: str,
    on: str = "",
    workspace: Path | None = None,
    effects_dir: Path | None = None,
    level: str = "standard",
    use: bool = True,
    report: bool = False,
    seed: int = 0,
) -> Adopted:
    """Put effects into the model, fitted to measurements, as a new version.

    The version may be there already where it was made in just this way: what was
    killed after it had written it is run once more, and goes on from there.

    Parameters
    ----------
    names : sequence of str
        Effects, in the ladder's order.
    measured : sequence of Measurements
        Each with its own runs.
    solving : context manager of Solver
        Entered when there is something to be solved.
    out : str
        Folder of the version, or its bare name in the workspace.
    on : str
        A version whose effects are kept and fitted together with these; none where it
        is empty or the baseline.
    workspace : Path, optional
        The default one where it is not given.
    effects_dir : Path, optional
        Of the user's own effects.
    level : str
        Mesh of the baseline.
    use : bool
        Whether to put it into use in its workspace.
    report : bool
        Whether to write the report's page.
    seed : int
        Of the samples.

    Raises
    ------
    EffectError, InputError, FileError
        When something is not allowed; nothing is written then.
    """
    everything = joined(measured)
    parent = None
    if on and on != BASELINE:
        parent = ModelVersion.load(locate(on, workspace, "on"))
    names = _all(names, parent)
    folder, home = place(out, workspace)
    if home is not None:
        home.make()
    lineage = _lineage(parent, measured)
    possible(names, measured, parent, effects_dir)
    written = made_before(folder, names, measured, parent, level, seed, effects_dir)
    if written is None:
        vacant(folder)
    with effects_of(parent, effects_dir) as own:
        with solving as solver:
            study = Study(
                everything, solver, level=level, effects=names, effects_dir=own
            )
            made = fit(study, names, seed)
            version = written or ModelVersion.of(
                made,
                parent=BASELINE if parent is None else parent.version,
                files=measured,
                date=datetime.now(UTC).isoformat(timespec="seconds"),
            )
            # Before it is saved: a version that is there is one that was reported.
            page = _page(study, made, version, lineage) if report else ""
        if written is None:
            version = version.save(folder, own)
    lineage += _inherited(version, parent)
    if home is not None and use:
        home.use(folder.name)
    return Adopted(made, version, home, home is not None and use, tuple(lineage), page)


def possible(
    names: Sequence[str],
    measured: Sequence[Measurements],
    parent: ModelVersion | None,
    effects_dir: Path | None = None,
) -> None:
    """Refuse, before anything is solved, what cannot be adopted.

    Raises
    ------
    EffectError, InputError
        As `discrepancy.adopt.refuse`.
    """
    with effects_of(parent, effects_dir) as own:
        known = catalogue(own)
        refuse(_all(names, parent), known, Paths(joined(measured), known, own))


def _inherited(version: ModelVersion, parent: ModelVersion | None) -> list[str]:
    """Give a version its parent's surrogate where that serves; what failed, a line."""
    from .surrogates import hand_on

    try:
        hand_on(version, parent)
    except (FileError, InputError) as error:  # the latter while it is being trained
        return [f"the parent's surrogate is not taken over: {error}"]
    return []


def made_before(
    folder: Path,
    names: Sequence[str],
    measured: Sequence[Measurements],
    parent: ModelVersion | None,
    level: str,
    seed: int,
    effects_dir: Path | None = None,
) -> ModelVersion | None:
    """The version that is in a folder, if it was made from just these; else None.

    Effects have to be written as they are now.

    Raises
    ------
    EffectError, FileError
        When a version in it is damaged, or an effect's file is missing.
    """
    if not is_version(folder):
        return None
    version = ModelVersion.load(folder)
    chosen = _all(names, parent)
    with effects_of(parent, effects_dir) as own:
        known = catalogue(own)
        sources = {n: source_digest(known[n]) for n in chosen if n in known}
    alike = (
        version.effects == tuple(chosen)
        and version.parent == (BASELINE if parent is None else parent.version)
        and version.generator == GENERATOR_VERSION
        and version.sources == sources
        and [one.sha256 for one in version.measurements]
        == [one.sha256 for one in measured]
        and (version.level, version.seed) == (level, seed)
        and version.tolerances == measured[0].tolerances
    )
    return version if alike else None


def _page(
    study: Study, made: Adoption, version: ModelVersion, lineage: Sequence[str]
) -> str:
    from discrepancy.adopt_report import adopt_report
    from discrepancy.sharpen import sharpen

    return adopt_report(made, version, sharpen(study, made.fit), lineage)


def _all(names: Sequence[str], parent: ModelVersion | None) -> list[str]:
    """The parent's effects, then the new ones; those named again are fitted again."""
    kept = [] if parent is None else list(parent.effects)
    return kept + [name for name in names if name not in kept]


def _lineage(
    parent: ModelVersion | None, measured: Sequence[Measurements]
) -> list[str]:
    """What a version leaves behind of the one it is built on, one line each."""
    if parent is None:
        return []
    given = {one.sha256 for one in measured}
    lost = [one.name for one in parent.measurements if one.sha256 not in given]
    if not lost:
        return []
    return [
        f"{', '.join(lost)}, which the parent was fitted to, is not among these files: "
        "everything is fitted to these alone"
    ]
