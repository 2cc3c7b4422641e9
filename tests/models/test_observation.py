"""Inputs of estimators: the detector's noise, augmentation, standardisation, training batches."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.data.detector import Detector
from posecal_models.data.masks import SHARES, mask_keypoints
from posecal_models.data.standardizer import Standardizer
from posecal_models.data.training_set import TrainingSet, seeded_generator
from posecal_models.estimators.cgnf.flow import SIZES
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.train import draw_graphs
from tests.models.random_flows import with_hip_keypoint
from tests.models.test_data_formats import lifting_set


def draws(poses: int = 4000) -> tuple[Context, torch.Tensor]:
    exact = torch.full((poses, 5, 2), 500.0)
    return Detector().detect(exact, torch.Generator().manual_seed(0)), exact


# --- detector ---------------------------------------------------------------------------------------------------


def test_the_share_of_hidden_keypoints_is_the_one_asked_for():
    context, _ = draws()
    many = context.observed.numel()
    hidden = int((~context.observed).sum())
    assert abs(hidden - 0.12 * many) < 4 * math.sqrt(many * 0.12 * 0.88)


def test_seen_keypoints_have_gaussian_noise_of_3_pixels():
    context, exact = draws()
    noise = (context.keypoints - exact)[context.observed].flatten().numpy()
    assert stats.kstest(noise, stats.norm(0, 3).cdf).pvalue > 1e-3


def test_hidden_keypoints_have_noise_of_25_pixels_with_heavy_tails():
    context, exact = draws(20_000)
    noise = (context.keypoints - exact)[~context.observed].flatten().numpy()
    # Student's t with 3 degrees of freedom has variance 3; scaled to a standard deviation of 25
    assert stats.kstest(noise, stats.t(3, scale=25 / math.sqrt(3)).cdf).pvalue > 1e-3


def test_the_two_directions_of_a_hidden_keypoint_share_their_tail():
    """The same chi-squared divides both, so that large errors come in both directions at once."""
    context, exact = draws(20_000)
    noise = (context.keypoints - exact)[~context.observed].abs()
    assert stats.spearmanr(noise[:, 0], noise[:, 1]).statistic > 0.1


def test_the_reported_sigma_marks_missing_keypoints():
    context, _ = draws()
    assert set(context.sigma.unique().tolist()) == {3.0, 25.0}
    assert torch.equal(context.observed, context.sigma <= 5)


def test_the_noise_depends_on_the_generator_alone():
    one, _ = draws()
    two, _ = draws()
    assert torch.equal(one.keypoints, two.keypoints)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hidden_share": 1.2}, r"detector\.hidden_share: 1\.2; expected a share"),
        ({"degrees_of_freedom": 2}, r"degrees_of_freedom: 2; expected 3 or more"),
    ],
)
def test_a_detector_refuses_numbers_out_of_range(options, words):
    with pytest.raises(PoseDataError, match=words):
        Detector(**options)


# --- augmentation -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", SHARES)
def test_the_paper_keeps_a_share_of_the_observed_keypoints(share):
    generator = torch.Generator().manual_seed(0)
    observed = torch.rand(500, 16, generator=generator) < 0.7
    masked = mask_keypoints(observed, torch.full((500,), share), generator)
    assert not (masked & ~observed).any()
    expected = torch.round(share * observed.sum(1)).clamp(min=1)
    np.testing.assert_array_equal(masked.sum(1), expected)


def test_the_released_code_removes_a_share_of_all_slots():
    generator = torch.Generator().manual_seed(0)
    everything, nothing = torch.ones(300, 16, dtype=torch.bool), torch.zeros(300, 16, dtype=torch.bool)
    masked = mask_keypoints(everything, torch.full((300,), 0.4), generator, kind="released")
    np.testing.assert_array_equal(masked.sum(1), 16 - round(0.6 * 16))
    assert not mask_keypoints(nothing, torch.full((300,), 0.4), generator, kind="released").any()


def test_every_keypoint_is_as_likely_to_stay():
    masked = mask_keypoints(
        torch.ones(8000, 16, dtype=torch.bool), torch.full((8000,), 0.25), torch.Generator().manual_seed(0)
    ).sum(0)
    # 4 of 16 stay: binomial with 8,000 trials of 1/4
    assert float((masked - 2000).abs().max()) < 4 * math.sqrt(8000 * 0.25 * 0.75)


def test_five_graphs_of_a_pose_are_all_and_the_four_shares():
    context = Context(torch.zeros(3, 15, 2), torch.ones(3, 15, dtype=torch.bool))
    truth = torch.arange(3.0)[:, None, None].expand(3, 15, 3)
    graphs, repeated = draw_graphs(
        context, truth, graphs_per_pose=5, first=7, augmentation="paper", generator=torch.Generator().manual_seed(0)
    )
    assert repeated[:, 0, 0].tolist() == [0.0] * 5 + [1.0] * 5 + [2.0] * 5
    assert [sorted(counts) for counts in graphs.observed.sum(1).view(3, 5).tolist()] == [[3, 6, 9, 12, 15]] * 3


def test_one_graph_of_a_pose_takes_the_five_kinds_in_turn():
    context = Context(torch.zeros(5, 15, 2), torch.ones(5, 15, dtype=torch.bool))
    for first in range(5):
        graphs, _ = draw_graphs(
            context,
            torch.zeros(5, 15, 3),
            graphs_per_pose=1,
            first=first,
            augmentation="paper",
            generator=torch.Generator().manual_seed(0),
        )
        assert sorted(graphs.observed.sum(1).tolist()) == [3, 6, 9, 12, 15]


# --- standardizer -----------------------------------------------------------------------------------------------


def test_standardised_training_data_have_mean_0_and_deviation_1():
    generator = torch.Generator().manual_seed(0)
    poses = 300 * torch.randn(500, 4, 3, generator=generator) + torch.arange(12.0).view(4, 3) * 50
    keypoints = 60 * torch.randn(500, 4, 2, generator=generator) + 700
    observed = torch.rand(500, 4, generator=generator) < 0.8
    standardizer = Standardizer(4)
    standardizer.fit(poses, keypoints, observed)
    x, c = standardizer.poses(poses), standardizer.keypoints(Context(keypoints, observed))
    np.testing.assert_allclose(x.mean(0), 0, atol=1e-5)
    np.testing.assert_allclose(x.square().mean(), 1, rtol=1e-5)
    np.testing.assert_allclose(c[observed].square().mean(), 1, rtol=1e-4)
    np.testing.assert_allclose(standardizer.millimetres(x), poses, atol=1e-3)


def test_the_position_in_the_image_does_not_change_standardised_keypoints():
    standardizer = Standardizer(4)
    keypoints = torch.randn(6, 4, 2, generator=torch.Generator().manual_seed(0)) * 60
    observed = torch.tensor([True, True, False, True]).expand(6, 4)
    one, two = (standardizer.keypoints(Context(keypoints + shift, observed)) for shift in (0.0, 400.0))
    np.testing.assert_allclose(one, two, atol=1e-4)


def test_the_log_determinant_turns_a_unitless_density_into_one_in_mm():
    standardizer = Standardizer(16)
    standardizer.pose_scale.fill_(100.0)
    np.testing.assert_allclose(standardizer.log_determinant, 48 * math.log(100), rtol=1e-6)


def test_the_released_constants_are_named():
    standardizer = Standardizer.released(16)
    np.testing.assert_allclose(standardizer.poses(torch.full((1, 16, 3), 1000.0)), 3.6, rtol=1e-6)
    keypoints = with_hip_keypoint(torch.full((1, 16, 2), 100.0), torch.ones(1, 16, dtype=torch.bool))
    np.testing.assert_allclose(standardizer.keypoints(keypoints)[:, 1:], 1.39, rtol=1e-5)


def test_weights_that_read_keypoints_relative_to_the_hip_need_it():
    estimator = CGNF(SIZES["tiny"], origin="root")
    assert estimator.keypoints == ("Hip", *estimator.joints)
    keypoints, observed = torch.randn(3, 17, 2), torch.ones(3, 17, dtype=torch.bool)
    observed[1] = False  # nothing at all is the prior
    assert estimator(Context(keypoints, observed)).log_prob(torch.zeros(3, 16, 3)).shape == (3,)
    observed[2, 0] = False  # but it is there
    assert estimator(Context(keypoints, observed)).log_prob(torch.zeros(3, 16, 3)).isfinite().all()
    keypoints[2, 0] = torch.nan
    with pytest.raises(PoseDataError, match=r"^keypoints: no Hip in 1 of 3 images, and the others are read relative"):
        estimator(Context(keypoints, observed))


def test_keypoints_that_are_normalised_already_are_refused():
    standardizer = Standardizer(4)
    keypoints = torch.randn(50, 4, 2, generator=torch.Generator().manual_seed(0)) * 60
    observed = torch.ones(50, 4, dtype=torch.bool)
    standardizer.fit(torch.randn(50, 4, 3), keypoints, observed)
    standardizer.check_keypoints(Context(keypoints, observed))
    with pytest.raises(PoseDataError, match=r"expected pixels\. They look normalised already"):
        standardizer.check_keypoints(Context(keypoints / 500, observed))
    keypoints[3, 1] = torch.nan
    with pytest.raises(PoseDataError, match=r"1 of 200 observed ones are not finite"):
        standardizer.check_keypoints(Context(keypoints, observed))


def test_poses_that_are_all_alike_are_refused():
    with pytest.raises(PoseDataError, match="all 5 are the same pose"):
        Standardizer(2).fit(torch.ones(5, 2, 3), torch.randn(5, 2, 2))


# --- batches ----------------------------------------------------------------------------------------------------


def test_batches_are_in_the_estimator_s_order_and_noise_is_drawn_anew():
    data = TrainingSet(lifting_set(), ("RFoot", "RHip"), ("RHip", "RFoot"), detector=Detector())
    rows = torch.tensor([2, 0])
    (one, truth), (two, _) = (data.batch(rows, seeded_generator(0, step)) for step in (1, 2))
    np.testing.assert_array_equal(truth, lifting_set().poses[[2, 0]][:, [2, 0]])
    assert not torch.equal(one.keypoints, two.keypoints)
    again, _ = data.batch(rows, seeded_generator(0, 1))
    assert torch.equal(one.keypoints, again.keypoints)


def test_without_a_detector_keypoints_are_taken_as_they_are():
    data = TrainingSet(lifting_set(), ("RFoot", "RHip"), ("RHip", "RFoot"))
    context, _ = data.batch(torch.tensor([1]), seeded_generator(0))
    np.testing.assert_array_equal(context.keypoints[0], lifting_set().keypoints[1][[1, 0]])


def test_poses_that_are_not_finite_are_refused():
    broken = lifting_set()
    broken.poses[2, 1, 0] = np.nan
    with pytest.raises(PoseDataError, match="1 of 4 poses are not finite"):
        TrainingSet(broken, broken.joints, broken.keypoint_joints)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((torch.zeros(3, 2), torch.ones(3, 2, dtype=torch.bool)), r"keypoints \(3, 2\): expected \(M, K, 2\)"),
        ((torch.zeros(3, 4, 2), torch.ones(3, 5, dtype=torch.bool)), r"observed \(3, 5\).*shape \(3, 4\)"),
        ((torch.zeros(3, 4, 2), torch.ones(3, 4)), r"observed \(3, 4\) torch\.float32: expected bool"),
    ],
)
def test_a_context_that_does_not_fit_is_refused(arguments, words):
    with pytest.raises(PoseDataError, match=words):
        Context(*arguments)
