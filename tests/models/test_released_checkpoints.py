"""Checkpoints of the published cGNF: their conversion, and refusal of others."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import load_released
from posecal_models.estimators.cgnf.flow import FlowSize
from tests.models.random_flows import with_hip_keypoint

REFERENCE = Path(__file__).parents[1] / "fixtures" / "reference_models"


def released_state() -> dict[str, torch.Tensor]:
    with np.load(REFERENCE / "tiny_state.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


def test_a_released_checkpoint_loads_and_its_dead_tensors_are_listed(tmp_path):
    torch.save(released_state(), tmp_path / "model.pt")
    estimator, unused = load_released(tmp_path / "model.pt")
    assert estimator.size == FlowSize(blocks=2, hidden=8, context=4, embedding=16)
    assert {name.split("layers.", 1)[1].removesuffix(".weight").removesuffix(".bias") for name in unused} == {
        "0.layers.x<-x",
        "1.layers.x<-x",
        "1.layers.c",
        "1.layers.r",
        "0.attention",
        "1.attention",
    }
    with np.load(REFERENCE / "tiny_io.npz") as numbers:
        keypoints = torch.from_numpy(numbers["c"]) / 0.0139
        poses = torch.from_numpy(numbers["x"]) / 0.0036
        context = with_hip_keypoint(keypoints, torch.from_numpy(numbers["mask_part"]))
        # density in mm: that of the scaled pose, and 48 times the log of the scale
        expected = numbers["part/logp_pose"] + 48 * np.log(0.0036)
    np.testing.assert_allclose(estimator(context).log_prob(poses).detach(), expected, rtol=1e-5)


def test_a_hostile_checkpoint_is_refused_and_runs_nothing(tmp_path):
    class Runs:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "it ran"),)

    torch.save({"weight": Runs()}, tmp_path / "model.pt")
    with pytest.raises(PoseFileError, match=r"model\.pt: holds more than tensors"):
        load_released(tmp_path / "model.pt")
    assert not (tmp_path / "it ran").exists()


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        ({"conv.weight": torch.zeros(1)}, PoseDataError, r"1 tensor is not part of a cGNF \(conv\.weight\)"),
        ({"_embedding_net.adj": torch.zeros(2, 2)}, PoseFileError, "lacks 'blocks"),
        ([1, 2], PoseDataError, "holds no state_dict"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(tmp_path, content, error, words):
    torch.save(content, tmp_path / "model.pt")
    with pytest.raises(error, match=words):
        load_released(tmp_path / "model.pt")


def test_a_checkpoint_with_another_number_of_blocks_is_refused(tmp_path):
    torch.save(released_state(), tmp_path / "model.pt")
    with pytest.raises(PoseDataError, match=r"model\.pt: 2 blocks; expected 10"):
        load_released(tmp_path / "model.pt", blocks=10)


def test_a_pickle_that_is_no_checkpoint_is_refused(tmp_path):
    (tmp_path / "model.pt").write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises((PoseFileError, PoseDataError), match=r"model\.pt"):
        load_released(tmp_path / "model.pt")
