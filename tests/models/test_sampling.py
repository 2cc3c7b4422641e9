"""Sampling into files: read by posecal, in constant memory, written atomically; and the contract of estimators."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.contract import Context, Estimator, PointEstimate, PoseDistribution
from posecal_models.data.detector import Detector
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.estimators.cgnf.flow import SIZES
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.gaussian_noise import GaussianDistribution, GaussianNoise
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.sample import draw, sample_to_file

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pairs(motion_file) -> LiftingSet:
    return Detector().detect_set(MocapPoses(motion_file).project(views=2, every=2))


@pytest.fixture(scope="module")
def estimator(pairs) -> CGNF:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = CGNF(SIZES["tiny"])
        for block in model.flow.couplings:
            block.second.pool.weight.data.normal_(0, 0.03)
    model.standardizer.fit(
        torch.from_numpy(pairs.poses), torch.from_numpy(pairs.keypoints), torch.from_numpy(pairs.observed)
    )
    return model.eval()


@pytest.mark.slow
def test_posecal_reads_what_was_sampled(pairs, estimator, tmp_path):
    pairs.save(tmp_path / "gt.npz")
    sample_to_file(estimator, KeypointSet.load(tmp_path / "gt.npz"), tmp_path / "hyps.npz", n=6)
    command = [sys.executable, "-m", "posecal", "evaluate", "hyps.npz", "gt.npz", "--format", "json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    rows = {row["metric"]: row["value"] for row in json.loads(done.stdout)["rows"] if row["joint"] is None}
    with np.load(tmp_path / "hyps.npz") as file:
        hypotheses = file["hypotheses"]
        assert hypotheses.shape == (len(pairs), 6, 17, 3)
        assert not hypotheses[:, :, 0].any()
        assert file["joints"].tolist() == ["Hip", *estimator.joints]
    errors = np.linalg.norm(hypotheses[:, :, 1:] - pairs.poses[:, None], axis=-1).sum(-1) / 17
    np.testing.assert_allclose(rows["min_mpjpe"], errors.min(1).mean(), rtol=1e-5)


def test_what_is_drawn_depends_on_the_seed(pairs, estimator, tmp_path):
    drawn = []
    for index, seed in enumerate((0, 0, 1)):
        sample_to_file(estimator, pairs.images, tmp_path / f"{index}.npz", n=2, seed=seed)
        with np.load(tmp_path / f"{index}.npz") as file:
            drawn.append(file["hypotheses"])
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2])[:, :, 1:].all()


def test_keypoints_are_joined_by_name(pairs, estimator, tmp_path):
    order = [3, 1, *range(4, 16), 0, 2]
    shuffled = KeypointSet(
        tuple(pairs.keypoint_joints[i] for i in order),
        pairs.keypoints[:, order],
        pairs.observed[:, order],
        pairs.sigma[:, order],
        pairs.frame_id,
    )
    for name, some in (("a", pairs.images), ("b", shuffled)):
        sample_to_file(estimator, some, tmp_path / f"{name}.npz", n=2)
    with np.load(tmp_path / "a.npz") as one, np.load(tmp_path / "b.npz") as two:
        np.testing.assert_array_equal(one["hypotheses"], two["hypotheses"])


@pytest.mark.slow
def test_memory_does_not_grow_with_the_poses(estimator, tmp_path):
    """100 MB of hypotheses more, in a process of its own: its peak grows by less than a quarter of that."""
    script = """
import resource, sys
import numpy as np, torch
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.sample import sample_to_file
torch.set_num_threads(1)
model = GaussianNoise(SimpleBaseline(width=8)).eval()
poses = int(sys.argv[1])
images = KeypointSet(model.keypoints, np.random.default_rng(0).normal(size=(poses, 16, 2)).astype(np.float32) * 60,
                     np.ones((poses, 16), bool), np.ones((poses, 16), np.float32), np.arange(poses).astype(str))
sample_to_file(model, images, sys.argv[2], n=200)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
    peaks = []
    for poses in (256, 2816):
        done = subprocess.run(
            [sys.executable, "-c", script, str(poses), str(tmp_path / "h.npz")],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        )
        peaks.append(int(done.stdout) * 1024)
    assert (tmp_path / "h.npz").stat().st_size > 2816 * 200 * 17 * 3 * 4
    assert peaks[1] - peaks[0] < 25e6


def test_the_mode_is_one_hypothesis(pairs, estimator, tmp_path):
    sample_to_file(estimator, pairs.images, tmp_path / "m.npz", n=200, mode=True)
    with np.load(tmp_path / "m.npz") as file:
        assert file["hypotheses"].shape[1] == 1


@torch.no_grad()
def test_a_low_temperature_draws_nearer_to_the_mode(pairs, estimator):
    some = pairs.take(slice(0, 4))
    context = Context(torch.from_numpy(some.keypoints), torch.from_numpy(some.observed))
    distribution = estimator(context)
    mode = distribution.mode()
    apart = [
        float((draw(distribution, 50, generator=torch.Generator().manual_seed(0), temperature=t) - mode).norm())
        for t in (0.0, 0.5, 1.0)
    ]
    assert apart[0] < 1e-2 < apart[1] < apart[2]


def test_a_point_estimator_is_sampled_too(pairs, tmp_path):
    baseline = SimpleBaseline(width=8).eval()
    sample_to_file(baseline, pairs.images, tmp_path / "s.npz", n=3)
    with np.load(tmp_path / "s.npz") as file:
        np.testing.assert_array_equal(file["hypotheses"][:, 0], file["hypotheses"][:, 2])


def test_missing_keypoints_of_a_cgnf_may_be_anything(pairs, estimator, tmp_path):
    broken = pairs.images
    broken = replace(broken, keypoints=np.where(broken.observed[..., None], broken.keypoints, np.nan))
    for name, some in (("a", pairs.images), ("b", broken)):
        sample_to_file(estimator, some, tmp_path / f"{name}.npz", n=2)
    with np.load(tmp_path / "a.npz") as one, np.load(tmp_path / "b.npz") as two:
        np.testing.assert_array_equal(one["hypotheses"], two["hypotheses"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda k: replace(k, keypoints=k.keypoints / 1000), "look normalised already"),
        (lambda k: replace(k, joints=tuple(f"marker {i}" for i in range(16))), "keypoints: none of RHip"),
        (lambda k: replace(k, keypoints=np.full_like(k.keypoints, np.nan)), "are not finite"),
    ],
)
def test_keypoints_that_do_not_suit_are_refused_and_nothing_is_written(pairs, estimator, tmp_path, change, words):
    with pytest.raises(PoseDataError, match=words):
        sample_to_file(estimator, change(pairs.images), tmp_path / "h.npz", n=2)
    assert not list(tmp_path.iterdir())


def test_poses_that_are_not_finite_are_refused_and_nothing_is_written(pairs, estimator, tmp_path):
    broken = CGNF(SIZES["tiny"])
    broken.load_state_dict(estimator.state_dict())
    broken.flow.couplings[0].shift.data.fill_(torch.nan)
    with pytest.raises(PoseDataError, match=r"hypotheses: 1\d\d of 128 drawn .* are not finite"):
        sample_to_file(broken.eval(), pairs.images, tmp_path / "h.npz", n=2)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_named(pairs, estimator, tmp_path):
    with pytest.raises(PoseFileError, match="nowhere"):
        sample_to_file(estimator, pairs.images, tmp_path / "nowhere" / "h.npz", n=2)


@pytest.mark.parametrize("kind", ["cgnf", "baseline", "gaussian"])
def test_every_estimator_keeps_the_contract(pairs, estimator, kind):
    baseline = SimpleBaseline(width=8).eval()
    model = {"cgnf": estimator, "baseline": baseline, "gaussian": GaussianNoise(baseline).eval()}[kind]
    assert isinstance(model, Estimator)
    some = pairs.take(slice(0, 3)).in_order_of(model.joints, model.keypoints)
    context = Context(torch.from_numpy(some.keypoints), torch.from_numpy(some.observed))
    distribution = model(context)
    assert isinstance(distribution, PoseDistribution)
    generator = torch.Generator()
    one, two = (distribution.sample(5, generator=generator.manual_seed(3)) for _ in range(2))
    assert one.shape == (5, 3, 16, 3)
    assert torch.equal(one, two)
    if not isinstance(distribution, PointEstimate):
        assert distribution.log_prob(torch.from_numpy(some.poses)).shape == (3,)


@pytest.mark.parametrize("kind", ["cgnf", "gaussian"])
@pytest.mark.parametrize("shape", [(5, 3, 16, 3), (1, 16, 3), (3, 1, 3), (3, 16, 1), (3, 16)])
def test_a_truth_of_another_shape_gives_no_number(estimator, kind, shape):
    model = {"cgnf": estimator, "gaussian": GaussianNoise(SimpleBaseline(width=8)).eval()}[kind]
    distribution = model(Context(torch.zeros(3, 16, 2), torch.ones(3, 16, dtype=torch.bool)))
    with pytest.raises(PoseDataError, match=r"^truth .*: expected \(M, K, D\) = \(3, 16, 3\)\.$"):
        distribution.log_prob(torch.zeros(shape))


def test_contexts_that_can_not_be_are_refused(estimator):
    seen = torch.ones(3, 17, dtype=torch.bool)
    with pytest.raises(PoseDataError, match=r"^keypoints \(3, 17, 5\): expected \(M, K, 2\)\.$"):
        Context(torch.zeros(3, 17, 5), seen)
    with pytest.raises(PoseDataError, match=r"^keypoints \(3, 17, 2\): expected \(M, 16, 2\), in the order of RHip, "):
        estimator(Context(torch.zeros(3, 17, 2), seen))
    unknown = torch.zeros(3, 17, 2)
    unknown[1, 4, 0] = torch.inf
    with pytest.raises(PoseDataError, match=r"1 of 51 observed ones are not finite \(first: image 1, keypoint 4\)"):
        Context(unknown, seen)


def test_an_estimator_that_reads_every_keypoint_refuses_a_file_that_lacks_one(pairs, tmp_path):
    some = replace(pairs.images, joints=("Tail", *pairs.images.joints[1:]))
    with pytest.raises(PoseDataError, match="are not finite; SimpleBaseline reads every keypoint"):
        sample_to_file(SimpleBaseline(width=8).eval(), some, tmp_path / "h.npz", n=2)
    assert list(tmp_path.iterdir()) == []


def test_a_distribution_without_temperature_says_so():
    class Plain:
        def sample(self, n, *, generator=None):
            return torch.zeros(n, 1, 1, 3)

        def log_prob(self, truth):
            return torch.zeros(1)

    with pytest.raises(PoseDataError, match="temperature: a Plain has none"):
        draw(Plain(), 2, temperature=0.5)
    with pytest.raises(PoseDataError, match="mode: a Plain has none"):
        draw(Plain(), 2, mode=True)


def test_a_gaussian_s_temperature_multiplies_its_sigma():
    distribution = GaussianDistribution(torch.zeros(1, 1, 3), torch.ones(1, 1))
    hot, cold = (
        distribution.sample(100, generator=torch.Generator().manual_seed(0), temperature=t) for t in (1.0, 0.25)
    )
    np.testing.assert_allclose(cold, 0.25 * hot, rtol=1e-6)
