"""Samplers whose quality is known, and reports of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from posecal.data.pose_data import PoseData
from posecal.engine.protocol import Protocol
from posecal.report.report import Report
from tests.helpers.sums import accumulate

Array = npt.NDArray[np.floating]

WIDTHS = np.array([20.0, 35.0, 60.0])
"""Standard deviation along each axis, mm."""


def gaussian(
    seed: int,
    N: int,
    M: int,
    K: int,
    *,
    spread: float | npt.ArrayLike = 1.0,
    bias: npt.ArrayLike = 0.0,
    dtype: str = "f8",
) -> tuple[Array, Array]:
    """Hypotheses (N, M, K, 3) and truths (M, K, 3) of one law, but for a factor of the spread and a bias, mm."""
    random = np.random.default_rng(seed)
    centre = random.normal(40, 300, (M, K, 3))
    truth = centre + WIDTHS * random.standard_normal((M, K, 3))
    factor = np.broadcast_to(spread, (K,))[:, None]
    hypotheses = centre + factor * WIDTHS * random.standard_normal((N, M, K, 3)) + bias
    return hypotheses.astype(dtype), truth.astype(dtype)


def sequences(M: int, S: int) -> npt.NDArray[np.str_]:
    """Labels of S sequences of as many of the M poses each, as far as that goes."""
    return np.array([f"s{number:03}" for number in np.arange(M) * S // M])


def pairs_of(
    x: Array,
    y: Array,
    *,
    labels: Mapping[str, npt.ArrayLike] | None = None,
    joints: Sequence[str] | None = None,
    root_joint: str | None = "none",
    occluded: npt.NDArray[np.bool_] | None = None,
    where: npt.NDArray[np.bool_] | None = None,
    log_prob: Array | None = None,
) -> PoseData:
    """Matched poses in mm."""
    return PoseData(
        x,
        y,
        where=where,
        joints=joints,
        root_joint=root_joint,
        labels=labels,
        occluded=occluded,
        log_prob=log_prob,
        unit="mm",
        axes="NMKD",
    )


def report_of(pairs: PoseData, metrics: str = "default", *, by: Sequence[str] = (), **options: str) -> Report:
    """Evaluate."""
    return Report(accumulate(pairs, Protocol().changed({"metrics": metrics, **options}), by=by, threads=1), by)
