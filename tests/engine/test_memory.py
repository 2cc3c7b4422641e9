"""A file is never in memory as a whole: many times as much takes hardly more, in any order of the axes."""

from pathlib import Path

import pytest

from posecal.data.pose_data import PoseData
from posecal.engine import chunks
from tests.benchmarks.memory import KINDS, peak, poses_of, write


@pytest.fixture(scope="module")
def little(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The peak for 2 MB: Python, its packages and the report."""
    files = write(tmp_path_factory.mktemp("little"), 0.002, "NMKD")
    return peak("evaluate", *files, "--metrics=min_mpjpe,ece", "--threads=1")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_is_read_some_poses_at_a_time(kind: str, little: float, tmp_path: Path) -> None:
    """Of 300 MB, 32 MB are read at a time; as much again may be in the making, with blocks and sums."""
    files = write(tmp_path, 0.3, kind)
    assert peak("evaluate", *files, "--metrics=min_mpjpe", "--threads=1") < little + 3 * 32 + 40


def test_no_window_of_a_file_is_larger_than_it_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fast half of the same: of 10 MB, what is read at a time is below 1 MB, whatever the order of the axes."""
    monkeypatch.setattr(chunks, "WINDOW_BYTES", 1_000_000)
    for kind in ("NMKD", "MNKD"):
        hypotheses, truth = write(tmp_path, 0.01, kind)
        read = [chunk.hypotheses.nbytes for chunk in chunks.read_chunks(PoseData(hypotheses, truth))]
        assert sum(read) == 200 * poses_of(0.01) * 17 * 3 * 4
        assert max(read) <= 1_000_000


def test_the_files_are_as_large_as_they_should_be(tmp_path: Path) -> None:
    hypotheses, _ = write(tmp_path, 0.01, "MNKD")
    assert abs(hypotheses.stat().st_size - 0.01e9) < 0.01 * 0.01e9 + 200 * 17 * 3 * 4
    assert poses_of(4) == 98_039  # 4·10⁹ / (200 · 17 · 3 · 4)
