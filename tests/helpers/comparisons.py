"""Models that are compared in tests, and their sums."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from tests.helpers.samplers import gaussian, pairs_of, sequences
from tests.helpers.sums import accumulate

Array = np.ndarray
M, S = 48, 8
LABELS = {"sequence": sequences(M, S)}
METRICS = "default, scores"


def totals_of(
    x: Array, y: Array, metrics: str = METRICS, labels: dict[str, Array] | None = None, **options: str
) -> Totals:
    protocol = Protocol().changed({"metrics": metrics, **options})
    return replace(accumulate(pairs_of(x, y, labels=labels or LABELS), protocol, threads=1), gallery=None)


X, Y = gaussian(0, 12, M, 4)
MODELS = {"right": X, "narrow": X.mean(axis=0) + 0.4 * (X - X.mean(axis=0)), "off": X + 80.0}
