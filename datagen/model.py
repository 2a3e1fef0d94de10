"""The finite-element model: a baseline and the names of its active effects."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path as FilePath

import numpy as np

from .continuation import PathFollower
from .device import DESIGN_FIELDS, DESIGN_SPACE, LIMITS, MAX_PRESSURE, Design
from .effects import Effect, catalogue
from .effects.acting import act
from .equilibrium import Workspace
from .errors import EffectError, InputError
from .levels import COARSER, mesh_level
from .mesh_error import estimate
from .problem import STAGES, Body, Problem, baseline
from .response import OUTPUT_NAMES, Path, Response
from .sensitivity import Direction, follows_path
from .solver import solve
from .space import Space
from .specimens import (
    Bulge,
    Tensile,
    bulge_body,
    solve_bulge,
    tensile_body,
    tensile_stress,
    with_effects,
)

Array = np.ndarray

GENERATOR_VERSION = "7"
"""Changes whenever the numbers that the model gives change."""


CONTINUOUS_FIELDS = tuple(
    name for name in DESIGN_FIELDS if LIMITS[name].scale != "integer"
)
"""Fields of a design that outputs can be differentiated by."""

FIELD_STEP, PARAMETER_STEP = 1e-5, 3e-6
"""Of a design field over its value, of an effect's parameter over its range."""

FOLLOWED_STEP = 1e-4
"""Of a parameter where derivatives follow the path, see `sensitivity.Sensitivity`: a
slender strip's residual changes by less than it is rounded along a smaller one."""

EXPLORED_STEPS = 8
"""Even load steps of `Model.explore`, besides those that the follower adds."""


@dataclass(frozen=True)
class Model:
    """The device as the finite elements see it; meets the `Forward` protocol.

    Parameters
    ----------
    effects : tuple of str
        Names of the active effects, from the catalogue.
    level : str
        Mesh level: ``draft``, ``standard`` or ``fine``.
    parameters : mapping of str to mapping of str to float, SI
        Values of the effects' parameters; those not given are at their off value.
    effects_dir : Path, optional
        Folder with a user's own effects.
    backend : str, optional
        Linear solver, ``pardiso`` or ``superlu``; the fastest there is by default.

    Raises
    ------
    EffectError
        When an effect or one of its parameters is unknown.
    InputError
        When the level is unknown or a value is outside its range.
    """

    effects: tuple[str, ...] = ()
    level: str = "standard"
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects_dir: FilePath | None = None
    backend: str | None = None

    def __post_init__(self) -> None:
        mesh_level(self.level)
        asked = self.effects or self.parameters or self.effects_dir
        known = catalogue(self.effects_dir) if asked else {}
        for name in (*self.effects, *self.parameters):
            if name not in known:
                raise EffectError(
                    f"effect: {name!r} is unknown; allowed: "
                    f"{', '.join(catalogue(self.effects_dir))}"
                )
        for name in self.parameters:
            if name not in self.effects:
                raise InputError("parameters", name, "names of active effects")
        # Within a stage by name: what is active decides, not how it was written down.
        active = sorted(
            (known[name] for name in self.effects),
            key=lambda e: (STAGES.index(e.stage), e.name),
        )
        values = {e.name: e.check(self.parameters.get(e.name, {})) for e in active}
        object.__setattr__(self, "_active", tuple(active))
        object.__setattr__(self, "_values", values)

    @property
    def active(self) -> tuple[Effect, ...]:
        """Active effects in the order in which they act."""
        active: tuple[Effect, ...] = self.__dict__["_active"]
        return active

    @property
    def space(self) -> Space:
        """Design variables, and ``effect.parameter`` of each active effect."""
        more = tuple(
            replace(parameter, name=f"{one.name}.{parameter.name}")
            for one in self.active
            for parameter in one.parameters
        )
        return Space(DESIGN_SPACE.parameters + more)

    @property
    def outputs(self) -> tuple[str, ...]:
        return OUTPUT_NAMES

    @cached_property
    def _workspace(self) -> Workspace:
        return Workspace(self.backend)

    @cached_property
    def _coarser_workspace(self) -> Workspace:
        return Workspace(self.backend)

    def problem(self, design: Design) -> Problem:
        """The boundary-value problem of a design with the active effects in it."""
        return self._on(self._base(design))

    def _base(self, design: Design) -> Problem:
        """The baseline of a design; the last one is kept, and its arrays shared."""
        kept: tuple[Design, Problem] | None = self.__dict__.get("_kept")
        if kept is None or kept[0] != design:
            kept = (design, baseline(design, mesh_level(self.level)))
            self.__dict__["_kept"] = kept
        return kept[1]

    def _on(
        self, problem: Problem, values: Mapping[str, dict[str, float]] | None = None
    ) -> Problem:
        """A baseline with the active effects in it, at other `values` where given."""
        values = values or self.__dict__["_values"]
        for one in self.active:
            problem = act(one, problem, values[one.name])
        return problem

    def directions(
        self, design: Design, wanted: Sequence[str] | None = None
    ) -> list[Direction]:
        """Each continuous design field and active effect's parameter, a step ahead.

        The other fields stay: with a longer balloon the tip margin is shorter.

        Parameters
        ----------
        design : Design
        wanted : sequence of str, optional
            Names of the fields and ``effect.parameter`` to differentiate by; all by
            default.

        Raises
        ------
        InputError
            When a name is unknown.
        """
        known = [*CONTINUOUS_FIELDS]
        known += [
            f"{one.name}.{p.name}"
            for one in self.active
            for p in one.parameters
            if p.scale != "integer"
        ]
        wanted = known if wanted is None else wanted
        for name in wanted:
            if name not in known:
                raise InputError("sensitivities", name, ", ".join(known))
        values: dict[str, dict[str, float]] = self.__dict__["_values"]

        base, level = self._base(design), mesh_level(self.level)
        part = FOLLOWED_STEP if follows_path(self._on(base)) else PARAMETER_STEP

        def of_field(name: str, value: float) -> Problem:
            moved = design.with_values(**{name: value})
            return self._on(baseline(moved, level, base))

        def of_parameter(effect: Effect, name: str, value: float) -> Problem:
            moved = effect.check({**values[effect.name], name: value})
            return self._on(base, {**values, effect.name: moved})

        found = []
        for name in CONTINUOUS_FIELDS:
            if name not in wanted:
                continue
            value = float(getattr(design, name))
            at = partial(of_field, name)
            found.append(_direction(name, value, FIELD_STEP * value, at))
        for one in self.active:
            for parameter in one.parameters:
                if f"{one.name}.{parameter.name}" not in wanted:
                    continue
                value = values[one.name][parameter.name]
                step = part * (parameter.upper - parameter.lower)
                name = f"{one.name}.{parameter.name}"
                at = partial(of_parameter, one, parameter.name)
                found.append(_direction(name, value, step, at))
        return found

    def _directions(
        self, design: Design, sensitivities: bool | Sequence[str]
    ) -> list[Direction]:
        if isinstance(sensitivities, bool):
            return self.directions(design) if sensitivities else []
        return self.directions(design, sensitivities)

    def __call__(
        self,
        designs: Sequence[Design],
        paths: Sequence[Path],
        sensitivities: bool | Sequence[str] = False,
        mesh_error: bool = False,
    ) -> Response:
        """Solve each design along its own path.

        Parameters
        ----------
        designs, paths : sequences of equal length n
            Paths may have different numbers of load steps; NaN pads the result.
        sensitivities : bool or sequence of str
            Differentiate every value by the design's continuous fields and the active
            effects' parameters, or by those named.
        mesh_error : bool
            Bound the discretisation error of every value and of the limit pressure, by
            solving each path on a coarser mesh, too; see `mesh_error`.

        Returns
        -------
        Response
            `info` holds ``unknowns`` (the largest) and ``seconds`` (in all), and
            ``mesh_error_seconds``, which come on top.
        """
        if len(designs) != len(paths):
            raise InputError("paths", len(paths), f"one path a design, {len(designs)}")
        self._check_level(mesh_error)
        responses = []
        for design, path in zip(designs, paths, strict=True):
            response = solve(
                self.problem(design),
                path,
                self._workspace,
                directions=self._directions(design, sensitivities),
            )
            if mesh_error:
                response = self._with_error(design, path, response)
            responses.append(response)
        return stack(responses)

    def _check_level(self, mesh_error: bool) -> None:
        """Refuse a bound that is not calibrated before anything is solved."""
        if mesh_error and self.level not in COARSER:
            raise InputError("mesh_error", self.level, f"levels {', '.join(COARSER)}")

    def _with_error(self, design: Design, path: Path, response: Response) -> Response:
        """A response of one device with its `mesh_error`."""
        began = time.perf_counter()
        coarser = self._on(baseline(design, COARSER[self.level]))
        error, limit = estimate(
            coarser, path, response, self.level, self._coarser_workspace
        )
        spent = {"mesh_error_seconds": time.perf_counter() - began}
        return replace(
            response,
            mesh_error=error,
            limit_pressure_error=limit,
            info=response.info | spent,
        )

    def explore(
        self,
        design: Design,
        pressure: float | Array = MAX_PRESSURE,
        sensitivities: bool = False,
        beyond: bool = False,
        mesh_error: bool = False,
    ) -> Response:
        """Every equilibrium on the way: load steps, and the follower's between.

        Parameters
        ----------
        design : Design
        pressure : float or (s,) array, Pa
            Gauge pressure at which the path ends unless it turns before, reached in
            even load steps; or the load steps.
        sensitivities : bool
            As in a call.
        beyond : bool
            Go on past a limit point until the strip has turned by 120 degrees; the
            pressure then falls along the path.
        mesh_error : bool
            As in a call; NaN from a limit point on.

        Returns
        -------
        Response
            Of one device; the last step is the last load step or the limit point, or
            what was reached beyond it.
        """
        self._check_level(mesh_error)
        if np.ndim(pressure) == 0:
            pressure = np.linspace(0.0, float(pressure), EXPLORED_STEPS + 1)[1:]
        path = Path(np.asarray(pressure))
        directions = self.directions(design) if sensitivities else ()
        response = solve(
            self.problem(design),
            path,
            self._workspace,
            explore=True,
            directions=directions,
            beyond=beyond,
        )
        return self._with_error(design, path, response) if mesh_error else response

    def deformed(self, design: Design, pressure: float) -> tuple[Problem, Array]:
        """The problem and its (n, 3) deformed nodes, m, at one gauge pressure, Pa.

        Raises
        ------
        InputError
            When the path ends before that pressure.
        """
        problem = self.problem(design)
        follower = PathFollower(problem, self._workspace)
        outcome = follower.run(np.array([pressure]))
        if outcome.status != "completed":
            raise InputError(
                "pressure_kPa", pressure / 1e3, f"less: {outcome.message}", "kPa"
            )
        return problem, follower.point.x

    def _with_effects(self, body: Body) -> Body:
        values = self.__dict__["_values"]
        return with_effects(body, [(one, values[one.name]) for one in self.active])

    def bulge(self, specimen: Bulge, path: Path) -> Response:
        """Deflection of a membrane over a hole, with the active effects that act on it.

        Parameters
        ----------
        specimen : Bulge
        path : Path

        Returns
        -------
        Response
            Of one specimen, see `specimens.solve_bulge`.
        """
        body = self._with_effects(bulge_body(specimen, mesh_level(self.level)))
        return solve_bulge(body, path, self._workspace)

    def tensile(
        self, specimen: Tensile, stretch: Array, time: Array | None = None
    ) -> Array:
        """Nominal stress (s,), Pa, with the active effects that act on a specimen.

        The specimen is incompressible: at the stretches of a tensile test the finite
        bulk modulus of the baseline law would let its volume grow by half, which no
        rubber does; at those of a device the two differ by one percent.

        Parameters
        ----------
        specimen : Tensile
        stretch : (s,) array
            In the order in which it is applied.
        time : (s,) array, s, optional
            Of each stretch, for laws with history.
        """
        body = self._with_effects(tensile_body(specimen))
        return tensile_stress(
            body.laws[int(body.mesh.layer[0])],
            float(body.shear_modulus[0]),
            stretch,
            specimen.mode,
            time=time,
        )


def _direction(
    name: str, value: float, step: float, problem_at: Callable[[float], Problem]
) -> Direction:
    """A step ahead, or back at the end of what is allowed or fits.

    Raises
    ------
    InputError
        When there is no room either way.
    """
    for signed in (step, -step):
        with suppress(InputError):
            return Direction(name, signed, problem_at(value + signed))
    room = f"a value with room for a step of {step:.2g} to one side at least"
    raise InputError(f"derivative by {name}", value, room)


def stack(responses: Sequence[Response]) -> Response:
    """One response of several devices, NaN where a path has fewer steps."""
    steps = max(r.pressure.shape[1] for r in responses)

    def pad(array: Array, fill: object) -> Array:
        widths = [(0, 0), (0, steps - array.shape[1])] + [(0, 0)] * (array.ndim - 2)
        padded: Array = np.pad(array, widths, constant_values=fill)  # type: ignore[call-overload]
        return padded

    slopes = [pad(r.jacobian, np.nan) for r in responses if r.jacobian is not None]
    errors = [pad(r.mesh_error, np.nan) for r in responses if r.mesh_error is not None]
    limits = [
        r.limit_pressure_error for r in responses if r.limit_pressure_error is not None
    ]
    met = [
        r.self_contact_pressure
        for r in responses
        if r.self_contact_pressure is not None
    ]
    info = {
        "unknowns": max(r.info.get("unknowns", 0) for r in responses),
        "seconds": sum(r.info.get("seconds", 0.0) for r in responses),
    }
    if errors:
        spent = (r.info.get("mesh_error_seconds", 0.0) for r in responses)
        info["mesh_error_seconds"] = sum(spent)
    return Response(
        outputs=responses[0].outputs,
        pressure=np.concatenate([pad(r.pressure, np.nan) for r in responses]),
        values=np.concatenate([pad(r.values, np.nan) for r in responses]),
        std=np.concatenate([pad(r.std, np.nan) for r in responses]),
        status=np.concatenate([pad(r.status, "") for r in responses]),
        path_status=tuple(s for r in responses for s in r.path_status),
        limit_pressure=np.concatenate([r.limit_pressure for r in responses]),
        message=tuple(m for r in responses for m in r.message),
        parameters=responses[0].parameters,
        jacobian=np.concatenate(slopes) if slopes else None,
        mesh_error=np.concatenate(errors) if errors else None,
        limit_pressure_error=np.concatenate(limits) if limits else None,
        self_contact_pressure=np.concatenate(met) if met else None,
        info=info,
    )
