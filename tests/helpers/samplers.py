"""Samplers whose quality is known, and reports of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from posecal.data.layout import MemoryArray
from posecal.data.match import Declarations, join
from posecal.data.pose_data import PoseData, StoredPoses
from posecal.engine.accumulate import accumulate
from posecal.engine.protocol import Protocol
from posecal.report.report import Report

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
) -> PoseData:
    """Poses as they come out of files."""
    names = None if joints is None else tuple(joints)
    truth = StoredPoses(
        "truth",
        MemoryArray(y),
        axes="MKD",
        unit="mm",
        joints=names,
        labels={name: np.asarray(values).astype(str) for name, values in (labels or {}).items()},
        marks={} if occluded is None else {"occluded": occluded},
    )
    hypotheses = StoredPoses("hypotheses", MemoryArray(x), axes="NMKD", unit="mm", joints=names)
    pairs = join(hypotheses, truth, Declarations(root_joint=root_joint))
    if where is not None:
        pairs = replace(pairs, where=where)
    return pairs


def report_of(pairs: PoseData, metrics: str = "default", *, by: Sequence[str] = (), **options: str) -> Report:
    """Evaluate."""
    return Report(accumulate(pairs, Protocol().changed({"metrics": metrics, **options}), by=by, threads=1), by)
