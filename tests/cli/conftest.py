"""Every test of the command line works in a folder of its own that shows the same small files."""

from pathlib import Path

import numpy as np
import pytest

import posecal
from tests.helpers.samplers import gaussian, sequences
from tests.helpers.shell import MODELS_JOINTS, MODELS_SHAPE, gt_members, hyps_members


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with hyps.npz, gt.npz and result.npz. Tests work elsewhere and only read it."""
    folder = tmp_path_factory.mktemp("files")
    np.savez(folder / "hyps.npz", **hyps_members())
    np.savez(folder / "gt.npz", **gt_members())
    posecal.evaluate(folder / "hyps.npz", folder / "gt.npz").save(folder / "result.npz")
    return folder


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with right.npz, narrow.npz and fewer.npz, hypotheses of three models, and true.npz."""
    folder = tmp_path_factory.mktemp("models")
    N, M, K = MODELS_SHAPE
    x, y = gaussian(0, N, M, K, dtype="f4")
    narrow = x.mean(axis=0) + 0.4 * (x - x.mean(axis=0))
    about = {"unit": "mm", "joints": MODELS_JOINTS, "frame_id": np.array([f"f{m:02}" for m in range(M)])}
    for name, hypotheses in (("right", x), ("narrow", narrow), ("fewer", x[:5])):
        np.savez(folder / f"{name}.npz", hypotheses=hypotheses, axes="NMKD", **about)
    np.savez(folder / "true.npz", truth=y, axes="MKD", sequence=sequences(M, 12), **about)
    return folder


@pytest.fixture(autouse=True)
def _elsewhere(files: Path, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder with links to the files."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    for path in (*files.iterdir(), *models.iterdir()):
        (tmp_path / path.name).symlink_to(path)
