r"""Training losses of the cGNF, with gradients in pieces that fit the processor's cache.

.. math:: L = \tfrac12 \left( L_{prior} + L_{post} \right) + \lambda L_{sample}

All terms are means over the batch: negative log densities in nats per pose (standardised), and the error of the mode in
mm. A batch may hold a pose with several sets of observed keypoints; its prior is then computed once.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Literal

import torch
from torch import Tensor

from posecal.errors import PoseDataError
from posecal_models.contract import Context
from posecal_models.estimators.cgnf.buffers import Workspace
from posecal_models.estimators.cgnf.model import CGNF

__all__ = ["FlowObjective", "mode_error"]

SampleLoss = Literal["joints", "pairs"]


def mode_error(mode: Tensor, truth: Tensor, *, kind: SampleLoss = "joints") -> Tensor:
    r"""Compute the mean joint error of a single pose.

    .. math:: \frac1K \sum_k \lVert \hat x_k - x_k \rVert

    Parameters
    ----------
    mode, truth : Tensor
        (..., K, 3), mm.
    kind : str
        ``joints``: over the joints. ``pairs``: over pairs of consecutive numbers, across joints, as released.

    Returns
    -------
    Tensor
        (...), mm; lower is better.

    Notes
    -----
    Differs from the published code: ``pairs`` is used there, about 0.78 of the mean joint error.

    Examples
    --------
    >>> mode_error(torch.tensor([[3.0, 0, 4], [0, 0, 0]]), torch.zeros(2, 3))  # (5 + 0) / 2
    tensor(2.5000)
    >>> mode_error(torch.tensor([[3.0, 0, 4], [0, 0, 0]]), torch.zeros(2, 3), kind="pairs")  # (3 + 4 + 0) / 3
    tensor(2.3333)
    """
    difference = mode - truth
    if kind == "pairs":
        difference = difference.flatten(-2).view(*difference.shape[:-2], -1, 2)
    return torch.mean(torch.linalg.vector_norm(difference, dim=-1), dim=-1)


class FlowObjective:
    """The training loss of a cGNF.

    Parameters
    ----------
    estimator : CGNF
        The estimator to train.
    sample_weight : float
        λ, the weight of the mode's error, per mm. 0: the mode is not computed.
    per_node : bool
        Whether log densities are divided by K, as in the released code, which changes the meaning of λ and clipping.
    sample_loss : str
        See :func:`mode_error`.
    graphs_at_once : int, optional
        Number of poses in one pass through the flow; chosen for the processor where not given.

    Raises
    ------
    PoseDataError
        Where λ is negative.
    """

    def __init__(
        self,
        estimator: CGNF,
        *,
        sample_weight: float = 0.0,
        per_node: bool = False,
        sample_loss: SampleLoss = "joints",
        graphs_at_once: int | None = None,
    ) -> None:
        if sample_weight < 0:
            raise PoseDataError(f"sample_weight: {sample_weight}; expected 0 or more.")
        self.estimator = estimator
        self.sample_weight = sample_weight
        self.per_node = per_node
        self.sample_loss: SampleLoss = sample_loss
        self.graphs_at_once = graphs_at_once
        self._workspace, self._mode_workspace = Workspace(), Workspace()

    def initialise(self, context: Context, truth: Tensor) -> None:
        """Set the ActNorms from a first batch.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.
        truth : Tensor
            (M, K, 3), mm.
        """
        flow, standardizer = self.estimator.flow, self.estimator.standardizer
        flow.initialise_actnorm(standardizer.poses(truth)[:, None], self.estimator.embed(context))

    def backward(
        self,
        context: Context,
        truth: Tensor,
        *,
        generator: torch.Generator | None = None,
        graphs_per_pose: int = 1,
    ) -> dict[str, Tensor]:
        """Compute the losses of a batch and add their gradients to the parameters.

        Parameters
        ----------
        context : Context
            Keypoints of M graphs, pixels.
        truth : Tensor
            (M, K, 3), mm. Graphs of one pose are consecutive.
        generator : torch.Generator, optional
            Not used: nothing is random.
        graphs_per_pose : int
            How many consecutive graphs have the same truth.

        Returns
        -------
        dict of str to Tensor
            ``loss`` (what is minimised), ``prior`` and ``posterior`` (nats per pose, standardised) and, where it is
            used, ``mode`` (mm); scalars without gradient; lower is better.
        """
        del generator
        flow, standardizer = self.estimator.flow, self.estimator.standardizer
        poses = standardizer.poses(truth)[:, None]
        half = 0.5 / (poses.shape[2] if self.per_node else 1)
        losses = {name: poses.new_zeros(()) for name in ("loss", "prior", "posterior")}
        if self.sample_weight:
            losses["mode"] = poses.new_zeros(())
        detached = _DetachedTensors()
        folded = detached.detach(flow.couplings.fold())
        embedded = detached.detach(self.estimator.embed(context))
        for part in self._pieces(len(poses)):
            share = len(poses[part]) / len(poses)
            conditioned = flow.condition(embedded.select(part), folded=folded, workspace=self._workspace)
            nats = -conditioned.log_prob_per_node(poses[part]).sum((1, 2)).mean()
            loss = half * nats
            if self.sample_weight:
                inverse = conditioned._replace(workspace=self._mode_workspace).inverse
                mode = standardizer.millimetres(inverse(torch.zeros_like(poses[part])))[:, 0]
                error = mode_error(mode, truth[part], kind=self.sample_loss).mean()
                loss = loss + self.sample_weight * error
                losses["mode"] += share * error.detach()
            torch.autograd.backward(share * loss)
            losses["posterior"] += share * nats.detach()
            losses["loss"] += share * loss.detach()
        distinct = poses[::graphs_per_pose]
        for part in self._pieces(len(distinct)):
            share = len(distinct[part]) / len(distinct)
            prior = flow.condition(flow.empty_context(), folded=folded, workspace=self._workspace)
            nats = -prior.log_prob_per_node(distinct[part]).sum((1, 2)).mean()
            torch.autograd.backward(share * half * nats)
            losses["prior"] += share * nats.detach()
            losses["loss"] += share * half * nats.detach()
        detached.backward()
        return losses

    @torch.no_grad()
    def evaluate(
        self, context: Context, truth: Tensor, *, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the losses of a batch without gradients.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.
        truth : Tensor
            (M, K, 3), mm.
        generator : torch.Generator, optional
            Not used: nothing is random.

        Returns
        -------
        dict of str to Tensor
            As from :meth:`backward`.
        """
        del generator
        flow, standardizer = self.estimator.flow, self.estimator.standardizer
        poses = standardizer.poses(truth)[:, None]
        half = 0.5 / (poses.shape[2] if self.per_node else 1)
        conditioned = flow.condition(self.estimator.embed(context))
        unconditioned = flow.condition(flow.empty_context(), folded=conditioned.folded)
        posterior = -conditioned.log_prob_per_node(poses).sum((1, 2)).mean()
        prior = -unconditioned.log_prob_per_node(poses).sum((1, 2)).mean()
        losses = {"loss": half * (posterior + prior), "prior": prior, "posterior": posterior}
        if self.sample_weight:
            mode = standardizer.millimetres(conditioned.inverse(torch.zeros_like(poses)))[:, 0]
            losses["mode"] = mode_error(mode, truth, kind=self.sample_loss).mean()
            losses["loss"] = losses["loss"] + self.sample_weight * losses["mode"]
        return losses

    def _pieces(self, poses: int) -> list[slice]:
        """Split a batch into pieces whose activations fit the processor's cache; a GPU takes all poses at once."""
        on_cpu = next(self.estimator.parameters()).device.type == "cpu"
        count = math.ceil(poses / (self.graphs_at_once or (64 if on_cpu else poses)))
        ends = [poses * i // count for i in range(count + 1)]
        return [slice(start, end) for start, end in pairwise(ends)]


class _DetachedTensors:
    """Detached copies of tensors, whose gradients of many pieces are accumulated and propagated in one pass."""

    def __init__(self) -> None:
        self._leaves: dict[int, tuple[Tensor, Tensor]] = {}

    def detach(self, value: Any) -> Any:
        """Return a tensor, or a tuple that holds tensors, with detached leaves in their place."""
        if isinstance(value, Tensor):
            if not value.requires_grad:
                return value
            return self._leaves.setdefault(id(value), (value, value.detach().requires_grad_()))[1]
        if not isinstance(value, tuple):
            return value
        parts = (self.detach(part) for part in value)
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)

    def backward(self) -> None:
        """Propagate the accumulated gradients to the weights."""
        pairs = [(tensor, leaf.grad) for tensor, leaf in self._leaves.values() if leaf.grad is not None]
        torch.autograd.backward([tensor for tensor, _ in pairs], [gradient for _, gradient in pairs])
