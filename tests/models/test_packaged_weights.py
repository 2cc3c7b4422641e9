"""The weights and the captured motion that come with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import posecal
from posecal_models import cli
from posecal_models.checkpoint import load_estimator, named_weights, notes_of
from posecal_models.contract import Context
from posecal_models.data.detector import Detector
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.sample import sample_to_file

WEIGHTS = Path(__file__).parents[2] / "posecal_models" / "weights"


@pytest.fixture(scope="module")
def images() -> LiftingSet:
    """Every eighth frame of the captured motion in two cameras, with the detector's noise."""
    return Detector().detect_set(MocapPoses(cli._CAPTURED_MOTION).project(every=8, views=2))


def evaluation(name: str, images: LiftingSet, folder: Path, n: int) -> posecal.Report:
    images.save(folder / "gt.npz")
    sample_to_file(load_estimator(name), images.images, folder / f"{name}.npz", n=n)
    return posecal.evaluate(folder / f"{name}.npz", folder / "gt.npz", metrics=["default", "energy_score"])


def test_it_is_better_than_the_packaged_cgnf_on_people_that_neither_has_seen(images, tmp_path):
    reference = evaluation("reference", images, tmp_path, n=40)
    cgnf = evaluation("cgnf-small", images, tmp_path, n=10)
    assert reference["energy_score"] < 0.75 * cgnf["energy_score"]
    assert reference["min_mpjpe"] < 60
    assert 0.8 < reference["coverage_90"] <= 1


def test_its_hypotheses_have_legs_of_one_length(images):
    """Within a hypothesis left and right thigh differ by some centimetres, as joints of one body do."""
    model = load_estimator("reference")
    at = {name: k for k, name in enumerate(model.joints)}
    here = images.images.in_order_of(model.keypoints)
    context = Context(*map(torch.from_numpy, (here.keypoints, here.observed, here.sigma)))
    with torch.inference_mode():
        drawn = model(context).sample(20, generator=torch.Generator().manual_seed(0))
    left, right = (
        torch.linalg.vector_norm(drawn[:, :, at[f"{side}Knee"]] - drawn[:, :, at[f"{side}Hip"]], dim=-1)
        for side in "LR"
    )
    assert float((left - right).abs().median()) < 25
    assert 350 < float(left.median()) < 480


def test_the_captured_motion_is_of_people_that_are_held_out():
    config = notes_of("reference")["config"]["data"]
    held_out = {*config["test_subjects"]} - {*config["validation_subjects"]}
    mocap = MocapPoses(cli._CAPTURED_MOTION)
    assert set(mocap.subject.tolist()) <= held_out
    assert len(mocap.poses) == 320
    assert "mocap.cs.cmu.edu" in str(np.load(cli._CAPTURED_MOTION)["licence"])


@pytest.mark.parametrize(("name", "size"), [("cgnf-small", 5e6), ("reference", 10e6)])
def test_named_weights_are_small_and_have_their_card(name, size):
    assert named_weights() == ("cgnf-small", "reference")
    assert (WEIGHTS / f"{name}.safetensors").stat().st_size < size
    card = " ".join((WEIGHTS / f"{name}.md").read_text(encoding="utf-8").split())
    for words in (
        "The data used in this project was obtained from mocap.cs.cmu.edu.",
        "The database was created with funding from NSF EIA-0196217.",
        ", ".join(load_estimator(name).joints),
        "Cameras",
        "Limits",
    ):
        assert words in card


def test_the_small_cgnf_s_prior_stands_upright_and_varies():
    estimator = load_estimator("cgnf-small")
    assert isinstance(estimator, CGNF)
    assert notes_of("cgnf-small")["config"]["data"]["test_subjects"] == ["S3", "S6", "S49"]
    poses = estimator.prior(3).sample(20, generator=torch.Generator().manual_seed(0))
    assert poses.isfinite().all()
    # y points down: the head of a grown person is half a metre and more above the hip, the feet as much below it
    heights = dict(zip(estimator.joints, poses[..., 1].flatten(0, 1).median(0).values.tolist(), strict=True))
    assert -900 < heights["Head"] < -300
    assert 500 < heights["RFoot"] < 1100
    assert poses.std(0).mean() > 10
