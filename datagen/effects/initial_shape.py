"""A strip that is bent or tilted before anything loads it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem import Problem
from ..space import Parameter
from .door import effect

CLAMPED = "bench practice: PDMS strips peeled from a mould and clamped by hand; "


@effect(
    stage="initial shape",
    parameters=[
        Parameter(
            "curvature",
            unit="1/m",
            lower=-30.0,
            upper=30.0,
            off=0.0,
            prior="normal",
            source=CLAMPED + "30 /m lifts the tip of a strip of 6.5 mm by 0.6 mm",
        ),
        Parameter(
            "tilt",
            unit="rad",
            lower=-np.radians(5.0),
            upper=np.radians(5.0),
            off=0.0,
            prior="normal",
            source=CLAMPED + "up to 5 degrees between the clamp and the camera's frame",
        ),
    ],
)
def initial_shape(problem: Problem, curvature: float, tilt: float) -> Problem:
    """Stress-free nodes X + u0: an arc from the clamp, turned about its middle.

    The middle line s -> (sin(k s)/k, (1 - cos(k s))/k) has the curvature k and takes
    its normals along; all is then rotated by the tilt in the x-z plane.  Positive
    values lift the tip.  Instruments count from the straight device, so that outputs
    hold the offset at zero pressure.
    """
    straight = problem.nodes
    s, middle = straight[:, 0], problem.design.thickness / 2
    z = straight[:, 2] - middle
    turn = curvature * s
    # sinc is sin(pi t)/(pi t): finite where the curvature vanishes.
    along = s * np.sinc(turn / np.pi) - z * np.sin(turn)
    up = s * np.sin(turn / 2) * np.sinc(turn / (2 * np.pi)) + z * np.cos(turn)
    nodes = straight.copy()
    nodes[:, 0] = along * np.cos(tilt) - up * np.sin(tilt)
    nodes[:, 2] = middle + along * np.sin(tilt) + up * np.cos(tilt)
    return replace(problem, nodes=nodes, datum=problem.counted_from)
