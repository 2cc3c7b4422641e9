"""Coupling splines of the amortised posterior: the identity before training, and a density and samples that agree."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator, save_estimator
from posecal_models.contract import Context
from posecal_models.estimators.amortized_posterior import AmortizedPosterior

NAMES = ("one", "two")


def images(M: int) -> tuple[torch.Tensor, Context]:
    generator = torch.Generator().manual_seed(0)
    poses = 100 * torch.randn((M, 2, 3), generator=generator)
    keypoints = 500 + 0.2 * poses[..., :2] + 3 * torch.randn((M, 2, 2), generator=generator)
    return poses, Context(keypoints, torch.ones(M, 2, dtype=torch.bool), torch.full((M, 2), 3.0))


def estimator(splines: int, *, trained: bool = False) -> AmortizedPosterior:
    torch.manual_seed(0)
    built = AmortizedPosterior(NAMES, NAMES, width=16, residuals=1, components=2, splines=splines)
    built.fit(*images(500))
    if trained and built.splines is not None:
        for parameter in built.splines.parameters():
            torch.nn.init.normal_(parameter, std=0.06)
    return built.eval()


def test_splines_need_zuko(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zuko.flows", None)
    with pytest.raises(
        PoseDataError, match=r"model\.splines: zuko is not installed\. pip install 'posecal\[splines\]'"
    ):
        estimator(1)


@torch.inference_mode()
def test_they_are_the_identity_before_training() -> None:
    pytest.importorskip("zuko")
    truth, context = images(5)
    plain, splined = (estimator(splines)(context) for splines in (0, 2))
    torch.testing.assert_close(splined.log_prob(truth), plain.log_prob(truth), atol=1e-3, rtol=0)
    plain, splined = (found.sample(3, generator=torch.Generator().manual_seed(1)) for found in (plain, splined))
    torch.testing.assert_close(splined, plain, atol=0.05, rtol=0)


@torch.inference_mode()
def test_samples_have_the_density() -> None:
    """The mean of p/q over samples of q is 1 for any density p, if q is the density of the samples."""
    pytest.importorskip("zuko")
    _, one = images(1)
    context = one[torch.zeros(20_000, dtype=torch.long)]
    p, q = estimator(0)(context), estimator(2, trained=True)(context)
    drawn = q.sample(1, generator=torch.Generator().manual_seed(1))[0]
    log_ratio = p.log_prob(drawn) - q.log_prob(drawn)
    assert log_ratio.std() > 0.3  # another density
    ratio = log_ratio.exp()
    assert abs(ratio.mean() - 1) < 4.5 * ratio.std() / len(ratio) ** 0.5 < 0.1


@torch.inference_mode()
def test_weights_are_saved_with_them(tmp_path: Path) -> None:
    pytest.importorskip("zuko")
    model, (truth, context) = estimator(2, trained=True), images(5)
    save_estimator(tmp_path / "weights.safetensors", model)
    found = load_estimator(tmp_path / "weights.safetensors")
    torch.testing.assert_close(found(context).log_prob(truth), model(context).log_prob(truth), atol=0, rtol=0)
