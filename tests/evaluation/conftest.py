"""Poses that are evaluated in batches."""

import numpy as np
import pytest

from tests.helpers.batches import Arrays, K, M, N


@pytest.fixture
def world() -> Arrays:
    """Poses of nine sequences of ten frames, with labels, a mask, scores and occlusion."""
    random = np.random.default_rng(7)
    truth = random.normal(0, 300, (M, K, 3))
    truth[:, 0] = 0
    hypotheses = truth + random.normal(0, 60, (N, M, K, 3)) * random.uniform(0.3, 1.5, (1, M, 1, 1))
    hypotheses[:, :, 0] = 0
    where = random.random((M, K)) < 0.9
    where[:, 0] = True
    return {
        "hypotheses": hypotheses.astype(np.float32),
        "truth": truth,
        "where": where,
        "occluded": random.random((M, K)) < 0.3,
        "scores": random.random((N, M)),
        "sequence": np.repeat([f"clip {s}" for s in range(9)], 10),
        "action": np.repeat(["walk", "sit", "run"], 30),
        "phase": np.tile(["a", "b"], 45),
    }
