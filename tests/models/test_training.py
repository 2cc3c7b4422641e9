"""Training: exact resuming, held-out subjects, and numbers that are not finite."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import load_estimator, read_tensors
from posecal_models.config import Config
from posecal_models.preparation import prepare

ROOT = Path(__file__).parents[2]

CGNF = {
    "model": {"kind": "cgnf", "size": "tiny"},
    "data": {"test_subjects": ["S4"], "validation_subjects": ["S3"], "views": 2},
    "train": {"epochs": 3, "batch": 8, "graphs_per_pose": 2, "schedule": "plateau", "patience": 0},
}
BASELINE = {
    "model": {"kind": "simple-baseline", "width": 16},
    "data": {"test_subjects": ["S4"], "validation_subjects": ["S3"], "views": 2},
    "train": {"objective": "squared-error", "epochs": 3, "batch": 16, "schedule": "cosine"},
}


def training(table, motion_file, folder, *, resume=False, **train):
    config = Config.from_table({**table, "train": {**table["train"], **train}})
    return prepare(config, motion_file, folder, resume=resume)


def final(run) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in run.estimator.state_dict().items()}


@pytest.mark.parametrize(
    ("table", "stop"),
    [*(pytest.param(CGNF, stop, marks=pytest.mark.slow) for stop in (1, 20, 35)), (BASELINE, 13)],
)
def test_a_training_that_was_stopped_goes_on_to_the_same_result(motion_file, tmp_path, table, stop):
    whole = training(table, motion_file, tmp_path / "whole")
    whole.run()
    first = training(table, motion_file, tmp_path / "parts")
    first.run(max_steps=stop)
    second = training(table, motion_file, tmp_path / "parts", resume=True)
    assert second.step == stop
    second.run()
    assert second.step_losses == whole.step_losses
    assert (tmp_path / "parts/losses.csv").read_text() == (tmp_path / "whole/losses.csv").read_text()
    for name, tensor in final(second).items():
        assert torch.equal(tensor, final(whole)[name]), name


@pytest.mark.slow
def test_a_training_survives_kill_9_at_any_moment(motion_file, tmp_path):
    """The command itself, killed twice while it computes or writes, and resumed."""
    settings = [
        "--set",
        "data.validation_subjects=['S3']",
        "--set",
        "data.views=2",
        "--set",
        "train.epochs=2",
        "--set",
        "train.batch=4",
    ]
    settings += ["--set", "train.graphs_per_pose=1", "--set", "train.checkpoint_seconds=0.1"]
    command = [sys.executable, "-m", "posecal_models.cli", "train", "cgnf-tiny", "--threads", "1"]
    command += ["--data", str(motion_file), *settings]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}

    subprocess.run([*command, "-o", str(tmp_path / "whole")], env=environment, check=True, capture_output=True)
    for attempt in range(2):
        process = subprocess.Popen(
            [*command, "-o", str(tmp_path / "parts"), "--resume"],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        checkpoint = tmp_path / "parts" / "checkpoint.safetensors"
        written = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns > written:
                time.sleep(0.03 * attempt)
                break
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
    subprocess.run(
        [*command, "-o", str(tmp_path / "parts"), "--resume"], env=environment, check=True, capture_output=True
    )

    assert not list((tmp_path / "parts").glob(".*"))[2:]  # at most what two kills could leave, and none is read
    whole, _ = read_tensors(tmp_path / "whole" / "checkpoint.safetensors")
    parts, _ = read_tensors(tmp_path / "parts" / "checkpoint.safetensors")
    assert sorted(whole) == sorted(parts)
    np.testing.assert_array_equal(parts["losses.steps"], whole["losses.steps"])
    for name, tensor in whole.items():
        np.testing.assert_array_equal(parts[name], tensor, err_msg=name)


def test_the_seed_decides_the_result(motion_file, tmp_path):
    losses = []
    for index, seed in enumerate((0, 0, 1)):
        run = training(CGNF, motion_file, tmp_path / str(index), seed=seed)
        run.run(max_steps=3)
        losses.append(run.step_losses)
    assert losses[0] == losses[1]
    assert losses[0] != losses[2]


@pytest.mark.slow
def test_the_loss_falls(motion_file, tmp_path):
    run = training(CGNF, motion_file, tmp_path / "a", epochs=6, schedule="cosine", learning_rate=3e-3)
    run.run()
    assert np.mean(run.step_losses[-10:]) < np.mean(run.step_losses[:10]) - 5


@pytest.mark.slow
def test_saving_changes_nothing_in_the_training(motion_file, tmp_path):
    run = training(CGNF, motion_file, tmp_path / "a")
    run.run(max_steps=run.steps_per_epoch + 3)
    before = final(run)
    run.save()
    assert all(torch.equal(tensor, before[name]) for name, tensor in final(run).items())


def test_a_loss_that_is_not_finite_stops_the_training_and_names_the_step(motion_file, tmp_path):
    run = training(CGNF, motion_file, tmp_path / "a")
    run.run(max_steps=2)
    run.data.poses[:] = math.nan
    before = (tmp_path / "a/checkpoint.safetensors").read_bytes()
    with pytest.raises(PoseDataError, match=r"at step 2 \(epoch 1\) loss is nan.*not finite in \d+ of \d+ tensors"):
        run.run()
    assert (tmp_path / "a/checkpoint.safetensors").read_bytes() == before


@pytest.mark.slow
def test_the_saved_weights_are_those_of_the_lowest_validation_loss(motion_file, tmp_path):
    run = training(CGNF, motion_file, tmp_path / "a", learning_rate=5e-3, schedule="cosine", epochs=4)
    run.run()
    rows = np.genfromtxt(tmp_path / "a/losses.csv", delimiter=",", names=True)
    saved = load_estimator(tmp_path / "a/weights.safetensors")
    run.estimator.load_state_dict(saved.state_dict())
    np.testing.assert_allclose(run._validate(), rows["validation_loss"].min(), rtol=1e-5)


def test_test_and_validation_subjects_are_not_trained_on(motion_file, tmp_path):
    run = training(CGNF, motion_file, tmp_path / "a")
    assert len(run.data) == 2 * 2 * 20 * 2  # 2 subjects left, 2 clips of 20 frames, 2 views
    assert len(run.validation) == 2 * 20 * 2


def test_a_folder_with_a_training_is_not_overwritten(motion_file, tmp_path):
    training(CGNF, motion_file, tmp_path / "a").run(max_steps=1)
    with pytest.raises(PoseFileError, match=r"holds a training already\. Pass --resume"):
        training(CGNF, motion_file, tmp_path / "a")


def test_a_checkpoint_of_another_configuration_is_refused(motion_file, tmp_path):
    training(CGNF, motion_file, tmp_path / "a").run(max_steps=1)
    with pytest.raises(PoseDataError, match=r"of another configuration \(train\.learning_rate differ"):
        training(CGNF, motion_file, tmp_path / "a", resume=True, learning_rate=0.5)


@pytest.mark.slow
def test_a_training_can_be_made_longer(motion_file, tmp_path):
    training(CGNF, motion_file, tmp_path / "a", epochs=1).run()
    run = training(CGNF, motion_file, tmp_path / "a", epochs=2, resume=True)
    assert not run.finished
    run.run()
    assert run.epoch == 2


def test_a_longer_cosine_falls_to_zero_at_its_new_end(motion_file, tmp_path):
    training(BASELINE, motion_file, tmp_path / "a", epochs=1).run()
    run = training(BASELINE, motion_file, tmp_path / "a", epochs=4, resume=True)
    run.run(max_steps=2 * run.steps_per_epoch)
    assert run.schedule.learning_rate == pytest.approx(0.5e-3)


@pytest.mark.slow
def test_a_training_may_start_from_weights(motion_file, tmp_path):
    training(CGNF, motion_file, tmp_path / "first", epochs=1).run()
    weights = str(tmp_path / "first" / "weights.safetensors")
    table = {**CGNF, "model": {**CGNF["model"], "start": weights}}
    run = training(table, motion_file, tmp_path / "second", epochs=1, learning_rate=1e-9)
    initial = final(run)
    for name, tensor in load_estimator(weights).state_dict().items():
        assert torch.equal(initial[name], tensor), name
    run.run()  # a step of next to nothing leaves them, the ActNorms too, where they were
    for name, tensor in final(run).items():
        np.testing.assert_allclose(tensor, initial[name], atol=1e-6, err_msg=name)
    other = {**table, "model": {**table["model"], "scale": "sigmoid"}}
    with pytest.raises(PoseDataError, match=r"model\.start: .* differs from the configuration in scale"):
        training(other, motion_file, tmp_path / "third")


def test_resuming_where_there_is_nothing_starts(motion_file, tmp_path):
    assert training(CGNF, motion_file, tmp_path / "a", resume=True).step == 0


def test_a_recording_needs_a_gpu(motion_file, tmp_path):
    with pytest.raises(PoseDataError, match=r"train\.cuda_graph: true with the device cpu; expected cuda"):
        training(CGNF, motion_file, tmp_path / "run", cuda_graph=True)
