"""Setup of a training: available keypoints, units and origin of the standardizer, initial weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.training_set import draw_graphs
from posecal_models.preparation import prepare
from posecal_models.training_folder import WEIGHTS

BASELINE = {
    "model": {"kind": "simple-baseline", "width": 8, "residuals": 0},
    "train": {"objective": "squared-error", "epochs": 1, "batch": 16, "steps_per_epoch": 2},
}
FLOW = {"model": {"kind": "cgnf", "size": "tiny"}, "train": {"epochs": 1, "batch": 4, "steps_per_epoch": 2}}


@pytest.fixture
def pairs(motion_file):
    """Poses with exact keypoints, the hip's first among them."""
    seen = MocapPoses(motion_file).project(views=1, every=5)
    hip = seen.keypoints.mean(1, keepdims=True)
    return replace(
        seen,
        keypoint_joints=("Hip", *seen.keypoint_joints),
        keypoints=np.concatenate([hip, seen.keypoints], axis=1),
        observed=np.pad(seen.observed, ((0, 0), (1, 0)), constant_values=True),
        sigma=np.pad(seen.sigma, ((0, 0), (1, 0))),
    )


def trained(pairs, folder, table, **model):
    pairs.save(folder / "pairs.npz")
    config = Config.from_table({**table, "model": {**table["model"], **model}})
    prepare(config, folder / "pairs.npz", folder / "run").run()
    return load_estimator(folder / "run" / WEIGHTS)


def test_a_file_of_pairs_keeps_the_hip_s_keypoint(pairs, tmp_path):
    pairs.save(tmp_path / "pairs.npz")
    with np.load(tmp_path / "pairs.npz") as file:
        np.testing.assert_array_equal(file["keypoints_2d"], pairs.keypoints)
        assert file["keypoints_observed"].all()
        assert not file["occluded"].any()


def test_a_baseline_reads_the_keypoints_that_the_data_hold(pairs, tmp_path):
    names = tuple("Tail" if name == "Spine" else name for name in pairs.keypoint_joints)
    estimator = trained(replace(pairs, keypoint_joints=names), tmp_path, BASELINE)
    assert estimator.keypoints == tuple(name for name in estimator.joints if name != "Spine")
    assert len(estimator.joints) == 16


def test_units_may_be_those_of_the_released_code(pairs, tmp_path):
    estimator = trained(pairs, tmp_path, FLOW, units="released")
    assert (float(estimator.standardizer.pose_scale), estimator.standardizer.origin) == (
        pytest.approx(1 / 0.0036),
        "observed",
    )


@pytest.mark.parametrize("table", [BASELINE, FLOW], ids=["baseline", "flow"])
def test_keypoints_may_be_read_relative_to_the_hip(pairs, tmp_path, table):
    """Then a person who moves in the image, hip and all, is the same; one whose hip alone moves is not."""
    estimator = trained(pairs, tmp_path, table, origin="root")
    assert estimator.keypoints == ("Hip", *estimator.joints)
    some = pairs.take(slice(0, 3)).in_order_of(keypoint_joints=estimator.keypoints)
    keypoints, observed = torch.from_numpy(some.keypoints), torch.from_numpy(some.observed)
    here, there, bent = (
        estimator(Context(keypoints + shift, observed)).mode()
        for shift in (torch.zeros(17, 2), torch.full((17, 2), 64.0), 64.0 * torch.eye(17)[:, :1].expand(17, 2))
    )
    assert torch.allclose(here, there, atol=0.05)
    assert not torch.allclose(here, bent, atol=0.5)


def test_data_without_a_hip_can_t_be_read_relative_to_it(motion_file, tmp_path):
    config = Config.from_table({**FLOW, "model": {**FLOW["model"], "origin": "root"}})
    with pytest.raises(PoseDataError, match=r"^keypoints: no Hip in 640 of 640 images, and the others are read"):
        prepare(config, motion_file, tmp_path / "run").run()


@pytest.mark.parametrize("augmentation", ["paper", "released"])
def test_the_root_is_never_hidden(augmentation):
    context = Context(torch.zeros(50, 17, 2), torch.ones(50, 17, dtype=torch.bool))
    settings = {"graphs_per_pose": 5, "first": 0, "augmentation": augmentation}
    generator = torch.Generator().manual_seed(0)
    graphs, _ = draw_graphs(context, torch.zeros(50, 16, 3), **settings, generator=generator, root=True)
    assert graphs.observed[:, 0].all()
    shares = graphs.observed[:, 1:].float().mean(1).view(50, 5).mean(0)
    np.testing.assert_allclose(shares, [1, 3 / 16, 6 / 16, 10 / 16, 13 / 16])


def test_a_baseline_needs_some_keypoint(pairs, tmp_path):
    nothing = replace(pairs, keypoints=np.full_like(pairs.keypoints, np.nan), observed=np.zeros_like(pairs.observed))
    with pytest.raises(PoseDataError, match=r"^keypoints: no image has any of RHip, .*; expected some of them in each"):
        trained(nothing, tmp_path, BASELINE)


def test_a_baseline_is_not_read_relative_to_another_joint_than_the_hip(motion_file, tmp_path):
    config = Config.from_table({**BASELINE, "model": {**BASELINE["model"], "origin": "root"}})
    with pytest.raises(PoseDataError, match=r"^keypoints: no image has the Hip's, and model\.origin = root reads"):
        prepare(config, motion_file, tmp_path / "run")


def test_a_baseline_of_fewer_keypoints_can_be_started_from(pairs, tmp_path):
    names = tuple("Tail" if name == "Spine" else name for name in pairs.keypoint_joints)
    first = trained(replace(pairs, keypoint_joints=names), tmp_path, BASELINE)
    start = {**BASELINE["model"], "start": str(tmp_path / "run" / WEIGHTS)}
    again = prepare(Config.from_table({**BASELINE, "model": start}), tmp_path / "pairs.npz", tmp_path / "again")
    assert again.estimator.keypoints == first.keypoints


def test_a_gaussian_is_not_started_around_another_mean(pairs, tmp_path):
    table = {"model": {"kind": "gaussian-noise"}, "train": BASELINE["train"] | {"objective": "likelihood"}}
    for name, seed in (("one", 0), ("two", 1)):
        pairs.save(tmp_path / "pairs.npz")
        config = {**BASELINE, "train": BASELINE["train"] | {"seed": seed}}
        prepare(Config.from_table(config), tmp_path / "pairs.npz", tmp_path / name).run()
    one, two = (str(tmp_path / name / WEIGHTS) for name in ("one", "two"))
    table["model"]["mean"] = one
    prepare(Config.from_table(table), tmp_path / "pairs.npz", tmp_path / "noise").run()
    table["model"]["start"] = str(tmp_path / "noise" / WEIGHTS)
    prepare(Config.from_table(table), tmp_path / "pairs.npz", tmp_path / "same")
    table["model"]["mean"] = two
    with pytest.raises(PoseDataError, match=r"differs from the configuration in the weights of the mean"):
        prepare(Config.from_table(table), tmp_path / "pairs.npz", tmp_path / "other")


@pytest.mark.parametrize("model", [{}, {"units": "released"}])
def test_normalised_keypoints_are_never_trained_on(pairs, tmp_path, model):
    pairs = replace(pairs, keypoints=pairs.keypoints / 500 - 1)
    with pytest.raises(PoseDataError, match="They look normalised already: give pixels"):
        trained(pairs, tmp_path, FLOW, **model)


def test_keypoints_that_can_t_be_read_are_refused_before_any_step(pairs, tmp_path):
    pairs.keypoints[7, 3] = np.nan
    with pytest.raises(PoseDataError, match=r"1 of .* are not finite; SimpleBaseline reads every keypoint"):
        trained(replace(pairs, observed=pairs.observed & np.isfinite(pairs.keypoints).all(-1)), tmp_path, BASELINE)
    assert not (tmp_path / "run").exists()


def test_a_published_model_reads_the_hip_s_keypoint_where_there_is_one(pairs, tmp_path):
    pairs.save(tmp_path / "pairs.npz")
    config = Config.load("mdn").with_changes(["model.width=8", "train.steps_per_epoch=1", "train.epochs=1"])
    estimator = prepare(config, tmp_path / "pairs.npz", tmp_path / "run").estimator
    assert estimator.keypoints[0] == "Hip"
    assert "Neck/Nose" not in estimator.keypoints
