"""Zero-shot experiments: the models of the pendulum, and the pose world with its known posterior."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from posecal.errors import PoseDataError
from posecal_models import pendulum, zero_shot
from posecal_models.cli import app
from posecal_models.contract import Context


def test_only_the_first_model_is_trained_with_three_nodes():
    assert [max(map(len, model.sets)) for model in pendulum.MODELS.values()] == [3, 1, 2, 2, 2]
    # of three nodes: none, three alone, three pairs
    assert len(pendulum.MODELS["cGNF, trained with at most two observed"].sets) == 1 + 3 + 3


@pytest.mark.slow
def test_the_pendulum_s_models_are_evaluated_with_all_nodes_observed():
    steps = []
    result = pendulum.pendulum(steps=3, batch=250, samples=3, progress=steps.append)
    assert steps == list(range(1, 13))
    *trained, linear = pendulum.MODELS
    assert list(result.log_density) == list(result.energy_score) == [*trained, linear, pendulum.OBSERVATIONS]
    assert list(result.samples) == trained
    assert all(np.isfinite([log_density.mean, log_density.median]).all() for log_density in result.log_density.values())
    assert {drawn.shape for drawn in result.samples.values()} == {(3, len(result.truth), 3, 2)}
    # rods of 1 m: from the fixed node at 0 each node is 1 m from the one before
    rods = np.diff(result.truth, axis=1, prepend=0)
    np.testing.assert_allclose(np.linalg.norm(rods, axis=-1), 1, rtol=1e-6)
    # and each is seen with a noise of 0.05 m in both directions
    assert 0.02 < (result.keypoints - result.truth).std() < 0.09
    # -6 (log 0.05 + log(2 π) / 2) - E[z²] / 2 of six normal numbers; nearly so from at most two nodes at a time
    alone, by_parts = result.log_density[pendulum.OBSERVATIONS], result.log_density[linear]
    assert alone.mean == pytest.approx(-6 * (np.log(0.05) + np.log(2 * np.pi) / 2) - 3, abs=5 * alone.standard_error)
    assert by_parts.mean == pytest.approx(alone.mean, abs=0.15)
    assert result.energy_score[linear] == pytest.approx(result.energy_score[pendulum.OBSERVATIONS], rel=0.1)


def test_what_is_not_observed_of_a_pendulum_is_missing():
    poses = torch.zeros(50, 3, 2)
    context = pendulum._observe(poses, ((0,), (1, 2)), torch.Generator().manual_seed(0))
    kinds = {tuple(row) for row in context.observed.tolist()}
    assert kinds == {(True, False, False), (False, True, True)}
    assert torch.equal(context.sigma > 0, context.observed)


def test_the_weights_are_those_of_the_lowest_energy_score(monkeypatch):
    """Scores fall twice and rise: the weights are those after the second tenth of the steps."""
    scores, seen = iter([3.0, 2.0, 1.0, 4.0, 5.0, 6.0]), []

    def score(estimator, validation):
        seen.append(estimator.first.weight.detach().clone())
        return next(scores)

    monkeypatch.setattr(zero_shot, "_validation_score", score)
    names = ("x1", "x2", "x3")
    estimator = zero_shot.AmortizedPosterior(names, names, origin="none", width=8, residuals=0, joint_dimensions=2)

    def draw(generator: torch.Generator) -> zero_shot.Batch:
        poses = torch.randn(20, 3, 2, generator=generator)
        return poses, Context(poses, torch.ones(20, 3, dtype=torch.bool))

    zero_shot.fit(estimator, draw, steps=5, validation=draw(torch.Generator()))
    assert len(seen) == 6
    assert torch.equal(estimator.first.weight, seen[2])
    assert not torch.equal(seen[2], seen[3])


def test_poses_whose_latents_overflow_are_counted_and_count_as_impossible():
    some = pendulum.LogDensity.of(torch.tensor([[1.0, torch.nan], [-4.0, 3.0], [2.0, -torch.inf]]))
    assert (some.mean, some.median, some.overflows, some.poses) == (-torch.inf, -1.5, 2, 6)
    assert str(some) == "median -1.5 nats, 2 of 6 poses below the range of double precision"
    assert str(pendulum.LogDensity.of(torch.tensor([[1.0, 3.0], [2.0, 4.0]]))) == "2.50 ± 0.50 nats"
    assert str(pendulum.LogDensity.of(torch.full((2, 1), torch.nan))) == (
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
        return poses * (1 if len(calls) == 1 else torch.nan), Context(poses, torch.ones(4, 3, dtype=torch.bool))

    estimator = zero_shot.CGNF(pendulum._SIZE, pendulum._CHAIN, origin="none", dimensions=2)
    with pytest.raises(PoseDataError, match=r"the loss is nan at step 0\. Lower the learning rate"):
        zero_shot.fit(estimator, draw, steps=2)


def test_without_the_toy_world_it_says_what_to_do(monkeypatch):
    known = builtins.__import__
    monkeypatch.setattr("importlib.import_module", lambda name: known("nowhere." + name))
    with pytest.raises(PoseDataError, match=r"toy\.pendulum can't be imported; expected the folder toy"):
        pendulum.pendulum(steps=1)


def test_the_command_prints_a_line_for_each_model_and_draws_the_figure(tmp_path, monkeypatch):
    nats = pendulum.LogDensity.of(torch.tensor([[1.0, 3.0], [2.0, 4.0]]))
    poses = np.ones((2, 3, 2), np.float32)
    result = pendulum.Pendulum({"a": nats, "b": nats}, {"a": 81.26, "b": np.nan}, poses, poses, {"a": poses[None]})
    monkeypatch.setattr(pendulum, "pendulum", lambda **_: result)
    picture = tmp_path / "pendulum.png"
    done = CliRunner().invoke(app, ["zero-shot", "pendulum", "--steps", "2", "-o", str(picture)])
    assert done.exit_code == 0
    assert done.stdout.splitlines()[1:] == ["a: 2.50 ± 0.50 nats, 81.26 mm", "b: 2.50 ± 0.50 nats, nan mm"]
    assert picture.read_bytes().startswith(b"\x89PNG")
