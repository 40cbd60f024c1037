"""The step that a run takes."""

from __future__ import annotations

import math

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.schema import Case
from phantomnode.solver.timestep import StepEstimate


def run_step(case: Case, estimate: StepEstimate) -> float:
    """The step of the run, s: an even part of its length, at most the stable or the given step.

    Raises
    ------
    CaseError
        Where the given step is not stable, unless the case forces it.
    """
    wanted = estimate.dt if isinstance(case.time.step, str) else case.time.step
    limit = estimate.dt / case.time.safety
    if wanted > limit and not case.time.force:
        raise CaseError(
            f"time.step: {wanted:g} s is unstable; the stable step is {limit:.4g} s (elements "
            f'{2.0 / estimate.element_frequency:.4g} s, contact closed). Take step = "auto" or at most '
            f"{estimate.dt:.4g}, or force = true to run all the same"
        )
    return case.time.end / math.ceil(case.time.end / wanted * (1.0 - 1e-12))
