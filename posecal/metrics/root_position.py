"""Error of the root's own position in the frame of the data, before it is subtracted from the joints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.root import origin
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import Scope


def root_errors(block: Block) -> FloatArray:
    """Smallest and mean distance of the hypotheses' root from the true one, (B, 2), mm; NaN without a root."""
    if block.root is None:
        return np.full((len(block.truth), 2), np.nan)
    hypotheses, truth = block.stored
    apart = origin(hypotheses, block.root) - origin(truth, block.root)  # of one root, or of each joint's
    distances = np.linalg.norm(apart, axis=-1).mean(axis=-1)
    mean = distances.mean(axis=0) if block.weights is None else block.mean_of_each(distances.T)
    found = np.stack([distances.min(axis=0), mean], axis=1, dtype=np.float64)
    return np.where(block.where.any(axis=1, keepdims=True), found, np.nan)


def root_metrics(scope: Scope) -> Iterator[Metric]:
    """Root error (MRPE), of the best hypothesis and the mean."""
    if scope.spec.root is None:
        return
    n, statistic = scope.spec.n_hypotheses, Statistic("root_errors", root_errors)
    poses = "poses" if scope.protocol.where == "all" else f"poses with {scope.protocol.where} joints"
    for index, (name, label, words) in enumerate(
        (("min_root_error", "root error (best of N)", "smallest"), ("root_error", "root error", "mean"))
    ):
        yield Metric(
            name=name,
            label=label,
            unit="mm",
            direction="lower",
            family="accuracy",
            brief=f"{words} of N={n}, the root's own position",
            definition=f"mean over {poses} of the {words} of the distances of the root of the N={n} hypotheses from "
            "the true root, as the positions are stored",
            statistic=statistic,
            finish=entry(index),
            needs=("positions",),
            range="0 at best, and for data that are relative to the root already",
            bounds=POSITIVE,
            reading="The error of where a person is, in the frame of the data; other errors are of the pose.",
            source="Moon et al., arXiv:1907.11346 (MRPE)",
        )
