"""Two processes of torch.distributed give the numbers of one, with padded frames counted once."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import posecal

ROOT = Path(__file__).parents[2]
torch = pytest.importorskip("torch")
pytest.importorskip("torchmetrics")


@pytest.mark.slow
def test_two_processes_give_the_numbers_of_one(tmp_path: Path) -> None:
    from tests.helpers.two_ranks import Frames

    command = [sys.executable, "-m", "tests.helpers.two_ranks"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    ranks = [
        subprocess.Popen([*command, str(rank), "2", str(tmp_path)], cwd=ROOT, env=environment) for rank in range(2)
    ]
    assert [rank.wait(timeout=120) for rank in ranks] == [0, 0]
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    frames = Frames()
    clips = [f"clip {i // 10}" for i in range(len(frames))]
    one = posecal.evaluate(
        frames.hypotheses, frames.poses, unit="mm", axes="MNKD", labels={"sequence": np.array(clips)}
    )
    assert numbers["poses"] == len(frames)  # 61 frames for two processes: one is padded
    assert any("1 pose came more than once" in remark for remark in numbers["remarks"])
    for name, value in one.scalars().items():
        assert numbers[name] == pytest.approx(value, rel=1e-6), name
    for rank in range(2):  # the metric of torchmetrics gives all of them the same
        of_metric = json.loads((tmp_path / f"metric of {rank}.json").read_text())
        assert of_metric.pop("own poses") == 31
        assert of_metric == pytest.approx(one.scalars(), rel=1e-6)
