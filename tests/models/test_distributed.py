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
    first, second = (of(folder, rank)[kind] for rank in range(2))
    loss = one.pop("loss")
    np.testing.assert_allclose((first.pop("loss") + second.pop("loss")) / 2, loss, rtol=1e-5)
    for two in (first, second):
        assert sorted(two) == sorted(one)
        for name, tensor in one.items():
            scale = 1e-6 * float(tensor.abs().max() + 1)
            np.testing.assert_allclose(two[name], tensor, rtol=1e-4, atol=scale, err_msg=name)


@pytest.mark.slow
def test_two_processes_end_with_the_same_weights_and_learning_rates(folder):
    first, second = (of(folder, rank)["to the end"] for rank in range(2))
    assert sorted(first) == sorted(second)
    for name, tensor in first.items():
        if "running" not in name:  # on CPUs each process's own; the main process's are saved
            assert torch.equal(tensor, second[name]), name
    assert len(first["progress"][:, 1].unique()) > 1, "the learning rate never fell; the test is void"


def test_a_batch_that_processes_can_t_share_equally_is_refused(motion_file, tmp_path):
    config = Config.from_table({"train": {"batch": 8}})
    with pytest.raises(PoseDataError, match=r"train\.batch: 8 for 3 processes; expected a multiple of 3"):
        prepare(config, motion_file, tmp_path / "run", processes=ProcessGroup(0, 3))
    assert not (tmp_path / "run").exists()


def test_a_recorded_step_of_several_processes_is_refused(motion_file, tmp_path):
    config = Config.from_table({"train": {"cuda_graph": True}})
    with pytest.raises(PoseDataError, match=r"train\.cuda_graph: true for 2 processes; expected one"):
        prepare(config, motion_file, tmp_path / "run", processes=ProcessGroup(0, 2))


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
