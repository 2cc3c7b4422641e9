"""Small motion capture data and a small training, shared by the tests of the estimators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from posecal_models.data.synthetic import synthetic_motion


@pytest.fixture(scope="session", autouse=True)
def _one_thread():
    """Several test processes share few cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def motion_file(tmp_path_factory) -> Path:
    """Synthetic motion of four people, 20 frames of two clips each."""
    path = tmp_path_factory.mktemp("motion") / "motion.npz"
    np.savez(path, **synthetic_motion(subjects=4, clips=2, frames=20, seed=1))
    return path
