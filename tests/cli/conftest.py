"""Every test of the command line works in a folder of its own that shows the same small files."""

from pathlib import Path

import numpy as np
import pytest

import posecal
from tests.helpers.shell import gt_members, hyps_members


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with hyps.npz, gt.npz and result.npz. Tests work elsewhere and only read it."""
    folder = tmp_path_factory.mktemp("files")
    np.savez(folder / "hyps.npz", **hyps_members())
    np.savez(folder / "gt.npz", **gt_members())
    posecal.evaluate(folder / "hyps.npz", folder / "gt.npz").save(folder / "result.npz")
    return folder


@pytest.fixture(autouse=True)
def _elsewhere(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder with links to the files."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)
