"""Poses that the files of other tools hold."""

import numpy as np
import pytest

from tests.helpers.tables import Array, K, M


@pytest.fixture
def poses() -> Array:
    return np.random.default_rng(0).normal(0, 300, (M, K, 3)).round(3)
