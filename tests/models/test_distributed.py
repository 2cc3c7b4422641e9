"""Distributed training: the gradients of a single process for every objective, and identical processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.cli import main
from posecal_models.config import Config
from posecal_models.distributed import ProcessGroup
from posecal_models.preparation import prepare
from tests.models import two_processes

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(motion_file, tmp_path_factory) -> Path:
    """The folder of the results of two processes, started by ``torchrun``."""
    where = tmp_path_factory.mktemp("two")
    two_processes.save_mean(where)
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2", "--rdzv-backend=c10d"]
    command += ["--rdzv-endpoint=localhost:0", str(Path(two_processes.__file__)), str(motion_file), str(where)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return where


def of(folder: Path, rank: int) -> dict[str, dict[str, torch.Tensor]]:
    return torch.load(folder / f"of_{rank}.pt", weights_only=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(two_processes.KINDS))
def test_two_processes_compute_the_gradients_of_one(motion_file, folder, kind):
    one = two_processes.one_step(kind, str(motion_file), folder, ProcessGroup())
    for rank in range(2):
        two = of(folder, rank)[kind]
        assert sorted(two) == sorted(one)
        for name, tensor in one.items():
            scale = 1e-6 * float(tensor.abs().max() + 1)
            np.testing.assert_allclose(two[name], tensor, rtol=1e-4, atol=scale, err_msg=name)


@pytest.mark.slow
def test_two_processes_end_with_the_same_weights_and_learning_rates(folder):
    first, second = (of(folder, rank)["to the end"] for rank in range(2))
    assert sorted(first) == sorted(second)
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    assert len(first["progress"][:, 1].unique()) > 1, "the learning rate never fell; the test is void"


@pytest.mark.slow
def test_two_processes_train_as_one_does(motion_file, folder):
    one = two_processes.to_the_end(str(motion_file), folder, ProcessGroup())["progress"]
    two = of(folder, 0)["to the end"]["progress"]
    # Training losses; rounding grows from step to step. Validation may differ: a bias before a batch norm has no
    # gradient but rounding errors, which Adam makes as large as any, and the running means follow it.
    np.testing.assert_allclose(two[:6, :3], one[:6, :3], rtol=1e-3)


def test_every_process_has_its_rows_of_a_batch_that_does_not_divide():
    rows = [ProcessGroup(rank, 3).rows(8) for rank in range(3)]
    assert [row for shard in rows for row in range(8)[shard]] == list(range(8))


def test_fewer_poses_than_processes_are_refused(motion_file, tmp_path):
    config = Config.from_table({"train": {"batch": 2}})
    with pytest.raises(PoseDataError, match=r"train\.batch: 2 for 3 processes; expected a pose or more for each"):
        prepare(config, motion_file, tmp_path / "run", processes=ProcessGroup(0, 3))
    assert not (tmp_path / "run").exists()


def test_of_several_processes_on_a_machine_one_prints_the_error(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["posecal-models", "train", "cgnf-tinny", "--data", "motion.npz", "-o", "run"])
    errors = []
    for rank in ("0", "1"):
        monkeypatch.setenv("LOCAL_RANK", rank)
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 3
        errors.append(capsys.readouterr().err)
    assert errors[0].startswith("posecal-models: cgnf-tinny: no such configuration")
    assert errors[1] == ""
