"""Zero-shot experiments: the three models of the pendulum, and the pose world with its known posterior."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from posecal.errors import PoseDataError
from posecal_models import zero_shot
from posecal_models.cli import app


def test_only_the_first_model_is_trained_with_three_nodes():
    assert [max(map(len, sets)) for sets in zero_shot.PENDULUM_MODELS.values()] == [3, 1, 2]
    # of three nodes: none, three alone, three pairs
    assert len(zero_shot.PENDULUM_MODELS["cGNF, trained with at most two observed"]) == 1 + 3 + 3


@pytest.mark.slow
def test_the_pendulum_s_models_are_evaluated_with_all_nodes_observed():
    steps = []
    result = zero_shot.pendulum(steps=3, batch=20, samples=5, progress=steps.append)
    assert steps == list(range(1, 10))
    assert list(result.log_density) == list(result.samples) == list(zero_shot.PENDULUM_MODELS)
    assert all(np.isfinite([log_density.mean, log_density.median]).all() for log_density in result.log_density.values())
    assert {drawn.shape for drawn in result.samples.values()} == {(5, len(result.truth), 3, 2)}
    # rods of 1 m: from the fixed node at 0 each node is 1 m from the one before
    rods = np.diff(result.truth, axis=1, prepend=0)
    np.testing.assert_allclose(np.linalg.norm(rods, axis=-1), 1, rtol=1e-6)
    # and each is seen with a noise of 0.05 m in both directions
    assert 0.02 < (result.keypoints - result.truth).std() < 0.09


def test_poses_whose_latents_overflow_are_counted_and_count_as_impossible():
    some = zero_shot.LogDensity.of(torch.tensor([[1.0, torch.nan], [-4.0, 3.0], [2.0, -torch.inf]]))
    assert (some.mean, some.median, some.overflows, some.poses) == (-torch.inf, -1.5, 2, 6)
    assert str(some) == "median -1.5 nats, 2 of 6 poses below the range of double precision"
    assert str(zero_shot.LogDensity.of(torch.tensor([[1.0, 3.0], [2.0, 4.0]]))) == "2.50 ± 0.50 nats"
    assert str(zero_shot.LogDensity.of(torch.full((2, 1), torch.nan))) == (
        "2 of 2 poses below the range of double precision"
    )


@pytest.mark.slow
def test_no_model_has_a_higher_log_density_than_the_true_posterior():
    """The gap is a Kullback-Leibler divergence: not negative, but for the chance of 300 poses; training closes it."""
    few, more = (zero_shot.pose_world(steps=steps, batch=50, poses=300) for steps in (5, 60))
    assert set(few[0].gaps) == {"cGNF", "amortised posterior"}
    assert [(row.observed, row.trained) for row in few] == [(0, True), (4, True), (8, True), (12, False), (16, False)]
    for before, after in zip(few, more, strict=True):
        for name, (gap, standard_error) in after.gaps.items():
            assert gap > -4 * standard_error
            assert gap < before.gaps[name][0]


@pytest.mark.slow
def test_the_amortised_posterior_is_near_the_true_one_for_every_number_of_keypoints(monkeypatch):
    """Also for numbers that its training never has; the cGNF is not trained here."""
    fit = zero_shot.fit
    steps = {zero_shot.CGNF: 1, zero_shot.AmortizedPosterior: 150}
    monkeypatch.setattr(
        zero_shot, "fit", lambda model, draw, **how: fit(model, draw, **{**how, "steps": steps[type(model)]})
    )
    for row in zero_shot.pose_world(poses=500, batch=100):
        gap, standard_error = row.gaps["amortised posterior"]
        assert gap < (1.0 if row.trained else 2.0) - 3 * standard_error, row.observed


def test_more_keypoints_raise_the_density_of_the_true_posterior():
    true = [row.true_log_density for row in zero_shot.pose_world(steps=1, batch=20, poses=200)]
    assert (np.diff(true) > 0).all()


def test_a_loss_that_is_not_finite_stops_it():
    calls = []

    def draw(generator: torch.Generator) -> zero_shot.Batch:
        calls.append(1)
        poses = torch.randn(4, 3, 2, generator=generator)
        return poses * (1 if len(calls) == 1 else torch.nan), poses, torch.ones(4, 3, dtype=torch.bool)

    estimator = zero_shot.CGNF(zero_shot._SIZE, zero_shot._CHAIN, origin="none", dimensions=2)
    with pytest.raises(PoseDataError, match=r"the loss is nan at step 0\. Lower the learning rate"):
        zero_shot.fit(estimator, draw, steps=2)


def test_without_the_toy_world_it_says_what_to_do(monkeypatch):
    known = builtins.__import__
    monkeypatch.setattr("importlib.import_module", lambda name: known("nowhere." + name))
    with pytest.raises(PoseDataError, match=r"toy\.pendulum can't be imported; expected the folder toy"):
        zero_shot.pendulum(steps=1)


@pytest.mark.slow
def test_the_command_prints_a_line_for_each_model_and_draws_the_figure(tmp_path):
    picture = tmp_path / "pendulum.png"
    done = CliRunner().invoke(app, ["zero-shot", "pendulum", "--steps", "2", "-o", str(picture)])
    assert done.exit_code == 0
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == list(zero_shot.PENDULUM_MODELS)
    assert picture.read_bytes().startswith(b"\x89PNG")
