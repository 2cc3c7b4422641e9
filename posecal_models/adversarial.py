"""Training losses of Wehrbein et al.'s invertible network, with their critic, and their repair."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from posecal.data.skeleton import Skeleton
from posecal.errors import PoseDataError
from posecal_models.contract import Context, standard_normal
from posecal_models.estimators.inn import INN, PoseUnits
from posecal_models.moments import load_moments, moments
from posecal_models.objective import Objective
from posecal_models.published_losses import best_error

__all__ = ["Critic", "InvertibleLosses", "energy_score", "kernel_discrepancy"]

CRITIC_STEPS = 5
"""Steps of the critic before each step of the estimator; each takes two parts of the batch, the estimator one."""

_PARTS = 2 * CRITIC_STEPS + 1
_BEST = 5
_CRITIC_WIDTHS = 100, 1000
_METRES_PER_HEATMAP_PIXEL = 0.005
_UNCERTAIN = 2.1


class Critic(nn.Module):
    """Wehrbein et al.'s critic of poses: one number for each, larger for true ones.

    One path reads coordinates, the other the inner products of all bones (the kinematic chain space).

    Parameters
    ----------
    joints : tuple of str
        K joints of the pose, without the root.
    units : PoseUnits
        From the network's units to metres.
    """

    def __init__(self, joints: tuple[str, ...], units: PoseUnits) -> None:
        super().__init__()
        self._metres = units.metres
        self._parents = [max(0, parent) for parent in Skeleton(("Hip", *joints)).parents[1:]]
        count = len(joints)
        narrow, wide = _CRITIC_WIDTHS
        self.coordinates = nn.ModuleList(nn.Linear(n, narrow) for n in (3 * count, narrow, narrow, narrow))
        self.bones = nn.ModuleList(nn.Linear(n, wide) for n in (count * count, wide, wide))
        self.last = nn.Sequential(nn.Linear(narrow + wide, narrow), nn.LeakyReLU(), nn.Linear(narrow, 1))

    def forward(self, poses: Tensor) -> Tensor:
        """Judge poses (M, 3 K) in the network's units: (M,)."""
        leaky = functional.leaky_relu
        one, two, three, four = self.coordinates
        first = leaky(one(poses))
        of_coordinates = four(leaky(three(leaky(two(first))) + first))
        metres = functional.pad(self._metres(poses), (0, 0, 1, 0))
        bones = metres[:, 1:] - metres[:, self._parents]
        one, two, three = self.bones
        first = one((bones @ bones.transpose(1, 2)).flatten(1))
        of_bones = three(leaky(two(leaky(first)))) + first
        return cast(Tensor, self.last(torch.cat([of_coordinates, of_bones], dim=-1)))[:, 0]


class InvertibleLosses(Objective):
    r"""The losses of an invertible network, in its units and metres.

    Of both variants: the L1 error of the keypoints that the pose is mapped to; 10 times the kernel discrepancy of
    latents and keypoints from normal latents and the detected ones; 4 times the L1 error of the pose that is mapped
    back with the detected keypoints.

    Of the ``released`` one: 4 times the L1 error of the mean of the 5 best of N hypotheses; 750 times the root of the
    squared difference of their covariance from an uncertain heatmap's, too large variances excepted; and the critic's
    judgement of one hypothesis. The critic takes 5 steps (Wasserstein distance with a gradient penalty of 10) before
    each step, each with two of the batch's 11 parts, one for true and one for made poses.

    Of the ``repaired`` one: the energy score of the N hypotheses, a proper score, in place of these three.

    Parameters
    ----------
    estimator : INN
        The estimator to train.
    hypotheses : int
        N.
    learning_rate : float
        Of the critic.
    seed : int
        Seed of the critic's initialisation.

    Notes
    -----
    Differs from the published code: there the weights are those of the last epoch; here they are those of the lowest
    minMPJPE of N hypotheses of the validation poses or, ``repaired``, of the lowest loss.
    """

    def __init__(self, estimator: INN, hypotheses: int = 200, *, learning_rate: float = 1e-4, seed: int = 0) -> None:
        super().__init__()
        self.estimator = estimator
        self.hypotheses = hypotheses
        self._columns = [estimator.joints.index(name) for name in estimator.conditioned]
        self.critic: Critic | None = None
        if estimator.variant == "repaired":
            return
        self.one_process = True
        parameter = next(estimator.parameters())
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.critic = Critic(estimator.joints, estimator.standardizer).to(parameter)
        self._optimizer = torch.optim.Adam(self.critic.parameters(), learning_rate, betas=(0.5, 0.9))

    def noise(self, truth: Tensor, generator: torch.Generator) -> Tensor:
        """Draw standard normal numbers, (N + 2, M, L): of hypotheses, of the discrepancy, and of the critic."""
        return standard_normal((self.hypotheses + 2, len(truth), self.estimator.latents), truth, generator)

    def before_step(self, context: Context, truth: Tensor, noise: Tensor | None, learning_rate: float) -> None:
        """Train the critic."""
        if self.critic is None or noise is None:
            return
        if len(truth) % _PARTS:
            raise PoseDataError(f"train.batch: {len(truth)} of an INN with a critic; expected a multiple of {_PARTS}.")
        size = len(truth) // _PARTS
        self._optimizer.param_groups[0]["lr"] = learning_rate
        for step in range(CRITIC_STEPS):
            real, other = (slice((2 * step + i) * size, (2 * step + i + 1) * size) for i in range(2))
            poses = self.estimator.standardizer.poses(truth[real])
            with torch.no_grad():
                made = self.estimator.inverse(noise[0, other], *self.estimator.inputs(context[other]))
            share = torch.special.ndtr(noise[-1, other, :1])  # uniform
            mixed = (share * poses + (1 - share) * made).requires_grad_()
            (gradient,) = torch.autograd.grad(self.critic(mixed).sum(), mixed, create_graph=True)
            penalty = (torch.linalg.vector_norm(gradient, dim=-1) - 1).square().mean()
            loss = self.critic(made).mean() - self.critic(poses).mean() + 10 * penalty
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()

    def state(self) -> dict[str, Tensor]:
        """Return the critic's weights and the moments of its optimizer."""
        if self.critic is None:
            return {}
        tensors = {f"weights.{name}": tensor for name, tensor in self.critic.state_dict().items()}
        return tensors | moments(self._optimizer, dict(self.critic.named_parameters()))

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Load what :meth:`state` returned."""
        if self.critic is None:
            return
        self.critic.load_state_dict({name: tensors[f"weights.{name}"] for name in self.critic.state_dict()})
        load_moments(self._optimizer, dict(self.critic.named_parameters()), tensors)

    def forward(self, context: Context, truth: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Compute the losses of a batch, or of the part of it that is not the critic's."""
        estimator, units = self.estimator, self.estimator.standardizer
        if self.critic is not None and estimator.training:
            rows = slice(2 * CRITIC_STEPS * (len(truth) // _PARTS), None)
            context, truth, noise = context[rows], truth[rows], noise[:, rows]
        poses = units.poses(truth)
        keypoints, condition = estimator.inputs(context)
        latents, projected = estimator.transform(poses, condition)
        back = estimator.inverse(latents.detach(), keypoints, condition)
        parts = torch.split(noise[: self.hypotheses], max(1, 2**14 // len(truth)))
        drawn = torch.cat([estimator.inverse(part, keypoints, condition) for part in parts])
        hypotheses, target = units.metres(drawn), units.metres(poses)
        losses = {
            "keypoints": (projected - keypoints).abs().mean(),
            "latents": kernel_discrepancy(
                torch.cat([latents, projected.detach()], dim=-1), torch.cat([noise[-2], keypoints], dim=-1)
            ),
            "back": (back - poses).abs().mean(),
        }
        loss = losses["keypoints"] + 10 * losses["latents"] + 4 * losses["back"]
        if self.critic is None:
            losses["energy"] = energy_score(hypotheses.flatten(2), target.flatten(1)).mean()
            return {"loss": loss + losses["energy"], **losses}
        losses["best"] = _error_of_best(hypotheses, target)
        losses["spread"] = self._spread(hypotheses[:, :, self._columns], context)
        losses["critic"] = -self.critic(drawn[0]).mean()
        loss = loss + 4 * losses["best"] + 750 * losses["spread"] + losses["critic"]
        if not estimator.training:
            losses["selection"] = 1000 * best_error(hypotheses, target).mean()
        return {"loss": loss, **losses}

    def _spread(self, hypotheses: Tensor, context: Context) -> Tensor:
        """Compare covariances in the image plane of hypotheses (N, M, 13, 3) in metres with those of heatmaps."""
        sigma = self.estimator.heatmap_sigma(context)
        variance = (_METRES_PER_HEATMAP_PIXEL * sigma).square()
        centred = (hypotheses - hypotheses.mean(0))[..., :2]
        x, y = centred.square().mean(0).unbind(-1)
        covariance = (centred[..., 0] * centred[..., 1]).mean(0)
        squares = functional.relu(variance - x).square() + functional.relu(variance - y).square() + covariance.square()
        return torch.mean((sigma > _UNCERTAIN) * (squares + 1e-16).sqrt())


def _error_of_best(hypotheses: Tensor, target: Tensor) -> Tensor:
    """Compute the L1 error, over the root's coordinates too, of the mean of the best 5 of (N, M, K, 3), metres."""
    errors = torch.linalg.vector_norm(hypotheses.detach() - target, dim=-1).mean(-1)
    best = errors.topk(min(_BEST, len(errors)), dim=0, largest=False).indices
    mean = torch.take_along_dim(hypotheses, best[..., None, None], dim=0).mean(0)
    joints = target.shape[1]
    return (mean - target).abs().mean() * joints / (joints + 1)


def kernel_discrepancy(one: Tensor, two: Tensor) -> Tensor:
    r"""Compute the maximum mean discrepancy of samples with inverse multiquadratic kernels.

    .. math:: \sum_a \overline{k_a(x, x')} + \overline{k_a(y, y')} - 2 \overline{k_a(x, y)}, \qquad
              k_a = \frac{a^2}{a^2 + \lVert x - y \rVert^2}, \quad a = 0.05, 0.2, 0.9

    Parameters
    ----------
    one, two : Tensor
        (M, D).

    Returns
    -------
    Tensor
        A scalar; 0 for equal samples.

    Examples
    --------
    >>> kernel_discrepancy(torch.zeros(1, 1), torch.ones(1, 1))  # 2 times 1 - 1 / 401, 1 - 1 / 26 and 1 - 81 / 181
    tensor(5.0231)
    """
    total = one.new_zeros(())
    for first, second, sign in ((one, one, 1), (two, two, 1), (one, two, -2)):
        squares = (first[:, None] - second).square().sum(-1)
        for scale in (0.05, 0.2, 0.9):
            total = total + sign * (scale**2 / (scale**2 + squares)).mean()
    return total


def energy_score(hypotheses: Tensor, truth: Tensor) -> Tensor:
    r"""Compute the energy score, a proper score of samples.

    .. math:: \frac1N \sum_n \lVert x_n - y \rVert - \frac{1}{2 N (N - 1)} \sum_{n, m} \lVert x_n - x_m \rVert

    Parameters
    ----------
    hypotheses : Tensor
        (N, M, D).
    truth : Tensor
        (M, D).

    Returns
    -------
    Tensor
        (M,), lower is better.

    Examples
    --------
    >>> energy_score(torch.tensor([[[0.0]], [[4.0]]]), torch.tensor([[1.0]]))  # (1 + 3) / 2 - (4 + 4) / 4
    tensor([0.])
    """
    count = len(hypotheses)
    errors: Tensor = torch.linalg.vector_norm(hypotheses - truth, dim=-1).mean(0)
    samples = hypotheses.transpose(0, 1)
    return errors - torch.cdist(samples, samples).sum((1, 2)) / (2 * count * (count - 1))
