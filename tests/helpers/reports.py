"""Small reports with everything in them: twelve sequences of three actions, occluded joints, N = 12."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from posecal.demo import World, make_world, sample
from posecal.evaluation import evaluate
from posecal.report.report import Report

N, SEQUENCES, FRAMES = 12, 12, 3
HOW: dict[str, Any] = {"axes": "NMKD", "unit": "mm"}


@cache
def world() -> World:
    """M = 36 poses of 17 joints."""
    return make_world(SEQUENCES, FRAMES, seed=5)


@cache
def report_of(spread: float = 1.0, *, metrics: str = "default", by: tuple[str, ...] = (), n: int = N) -> Report:
    """The report of a sampler of this relative spread. Not to be changed: others read it too."""
    here = world()
    return evaluate(
        sample(here, n, spread),
        here.truth,
        joints="h36m-17",
        labels={"sequence": here.sequence, "action": here.action},
        occluded=here.occluded,
        by=by,
        metrics=metrics,
        axes="NMKD",
        unit="mm",
        threads=1,
    )


def grouped_report() -> Report:
    """The report of an honest sampler, by action and occlusion."""
    return report_of(by=("action", "occlusion"))


def unlabelled(n: int = 3, poses: int = 5) -> Report:
    """A report of joints without names and poses without labels."""
    random = np.random.default_rng(8)
    truth = random.normal(0, 300, (poses, 4, 3))
    return evaluate(truth + random.normal(0, 40, (n, poses, 4, 3)), truth, axes="NMKD", unit="mm", threads=1)
