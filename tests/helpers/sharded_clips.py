"""Clips of predicted motion after observed poses, cut into shards of whole clips."""

from __future__ import annotations

from typing import Any

import numpy as np

import posecal
from tests.helpers.random_worlds import skewed
from tests.helpers.sharded import JOINTS, Array

N, C, T, K = 6, 16, 5, len(JOINTS)
X, Y = (values.astype("f4") for values in skewed(2, N, C * T, K))
HYPOTHESES, TRUTH = X.reshape(N, C, T, K, 3), Y.reshape(C, T, K, 3)
OBSERVED = np.random.default_rng(0).normal(0, 60, (C, K, 3))
RECORDING = np.array([f"rec {c // 3}" for c in range(C)])
HOW: dict[str, Any] = {"unit": "mm", "axes": "NMTKD", "joints": JOINTS, "fps": 25}
OPTIONS: dict[str, Any] = {"metrics": "all", "by": ["horizon", "action"], "reference": "climatology"}
OPTIONS |= {"protocol": posecal.Protocol(mm_threshold=350)}
CUTS = {"uneven": [slice(0, 1), slice(1, 7), slice(7, 16)], "strided": [slice(start, None, 3) for start in range(3)]}


def clips(part: slice | Array, **labels: Any) -> posecal.PoseData:
    given = {"action": np.where(np.arange(C) % 2, "walk", "sit"), **labels}
    given = {name: values[part] for name, values in given.items()}
    more = {"labels": given, "observed": OBSERVED[part]}
    return posecal.PoseData(HYPOTHESES[:, part], TRUTH[part], **HOW, **more)
