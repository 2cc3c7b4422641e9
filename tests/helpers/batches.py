"""Evaluations in batches and in one call, for tests that compare them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

import posecal
from posecal.report.report import Report

N, M, K = 7, 90, 5
JOINTS = ("Hip", "RHip", "RKnee", "LHip", "LKnee")

Arrays = dict[str, Any]


def batches(
    world: Arrays, sizes: list[int], *names: str
) -> Iterator[tuple[npt.NDArray[Any], npt.NDArray[Any], Arrays]]:
    """Cut a world into batches of these sizes, repeated."""
    start = number = 0
    while start < M:
        stop = min(start + sizes[number % len(sizes)], M)
        part = slice(start, stop)
        extra = {name: world[name][:, part] if name == "scores" else world[name][part] for name in names}
        yield world["hypotheses"][:, part], world["truth"][part], extra
        start, number = stop, number + 1


def in_batches(world: Arrays, sizes: list[int], *names: str, **options: Any) -> Report:
    evaluation = posecal.Evaluation(unit="mm", axes="NMKD", joints=JOINTS, **options)
    for hypotheses, truth, extra in batches(world, sizes, *names):
        evaluation.update(hypotheses, truth, **extra)
    return evaluation.compute()


def in_one_call(world: Arrays, *names: str, **options: Any) -> Report:
    labels = {name: world[name] for name in names if name not in {"where", "occluded", "scores"}}
    given = {name: world[name] for name in names if name in {"where", "occluded", "scores"}}
    data = posecal.PoseData(
        world["hypotheses"], world["truth"], unit="mm", axes="NMKD", joints=JOINTS, labels=labels, **given
    )
    return posecal.evaluate(data, **options)


def assert_same(one: Report, other: Report, rtol: float = 1e-12) -> None:
    assert one.signature == other.signature
    left, right = one.table, other.table
    assert left[["metric", "group", "joint", "poses"]].equals(right[["metric", "group", "joint", "poses"]])
    for column in ("value", "low", "high"):
        np.testing.assert_allclose(left[column], right[column], rtol=rtol, atol=1e-12)
