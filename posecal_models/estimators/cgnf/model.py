"""The cGNF as an estimator: from keypoints in pixels to a distribution of poses in millimetres."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from posecal.errors import PoseDataError
from posecal_models.contract import Context, check_keypoints, check_truth, standard_normal
from posecal_models.data.standardizer import Origin, Standardizer
from posecal_models.estimators.cgnf.coupling import Scale
from posecal_models.estimators.cgnf.flow import ConditionedFlow, FlowSize, GraphFlow
from posecal_models.estimators.cgnf.graph import PoseGraph, human36m_graph
from posecal_models.estimators.cgnf.message_passing import EmbeddedContext

__all__ = ["CGNF", "FlowDistribution"]


class FlowDistribution:
    """The distribution of poses given the keypoints of M poses.

    Parameters
    ----------
    flow : ConditionedFlow
        The flow for these keypoints.
    standardizer : Standardizer
        The conversion between its units and mm.
    poses : int
        M.
    """

    def __init__(self, flow: ConditionedFlow, standardizer: Standardizer, poses: int) -> None:
        self._flow = flow
        self._standardizer = standardizer
        self._poses = poses

    def sample(self, n: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Tensor:
        """Draw n hypotheses of each pose; the temperature multiplies the latents, and 0 gives the mode."""
        mean = self._standardizer.pose_mean
        latents = standard_normal((self._poses, n, *mean.shape), mean, generator)
        return self._standardizer.millimetres(self._flow.inverse(latents * temperature)).transpose(0, 1)

    def log_prob(self, truth: Tensor) -> Tensor:
        r"""Compute the log density of poses.

        .. math:: \log p(x \mid c) = \sum_v \log \mathcal N(f(x, c)_v; 0, I) + \log |\det \nabla_x f| - K D \log s

        Raises
        ------
        PoseDataError
            Where the truth has another shape.

        Notes
        -----
        Differs from the published code: there the nodes' terms are averaged, in other units of length; the log density
        of a pose is their sum.
        """
        check_truth(truth, self._poses, *self._standardizer.pose_mean.shape)
        poses = self._standardizer.poses(truth)[:, None]
        return self._flow.log_prob_per_node(poses).sum((1, 2)) - self._standardizer.log_determinant

    def mode(self) -> Tensor:
        """Return the pose of the latent 0, (M, K, 3), mm: the paper's single best pose."""
        mean = self._standardizer.pose_mean
        return self._standardizer.millimetres(self._flow.inverse(mean.new_zeros(self._poses, 1, *mean.shape)))[:, 0]


class CGNF(nn.Module):
    """The conditional graph normalizing flow as an estimator of poses from any subset of keypoints.

    Parameters
    ----------
    size : FlowSize
        Blocks and features.
    graph : PoseGraph
        The joints; Human3.6M's 16 below the hip where not given.
    backward_weights, scale
        The paper's own map per direction and its exponential scale, or the released code's; see
        :class:`posecal_models.estimators.cgnf.coupling.CouplingBlock`.
    origin : str
        What keypoints are relative to, see :class:`posecal_models.data.standardizer.Standardizer`. With ``root`` a
        context holds the root's keypoint before those of the joints.
    dimensions : int
        D, coordinates of a joint.

    Notes
    -----
    Keypoint i sends its messages to joint i; a keypoint that is not observed changes nothing, whatever is stored for
    it. Without observed keypoints the distribution is the prior.

    Differs from the published code: joints are joined by name, and there are no unused parameters.

    References
    ----------
    Pierzchlewicz et al. 2022, arXiv:2210.11179.

    Examples
    --------
    >>> from posecal_models.estimators.cgnf.flow import SIZES
    >>> estimator = CGNF(SIZES["tiny"])
    >>> context = Context(torch.zeros(2, 16, 2), torch.ones(2, 16, dtype=torch.bool))
    >>> poses = estimator(context)
    >>> poses.sample(7).shape, poses.log_prob(torch.zeros(2, 16, 3)).shape
    (torch.Size([7, 2, 16, 3]), torch.Size([2]))
    """

    def __init__(
        self,
        size: FlowSize,
        graph: PoseGraph | None = None,
        *,
        backward_weights: bool = True,
        scale: Scale = "exp",
        origin: Origin = "observed",
        dimensions: int = 3,
    ) -> None:
        super().__init__()
        self.graph = human36m_graph() if graph is None else graph
        self.size = size
        self.flow = GraphFlow(self.graph, size, dimensions=dimensions, backward_weights=backward_weights, scale=scale)
        self.standardizer = Standardizer(len(self.graph.joints), dimensions=dimensions, origin=origin)

    @property
    def joints(self) -> tuple[str, ...]:
        """K names: the joints of the poses."""
        return self.graph.joints

    @property
    def keypoints(self) -> tuple[str, ...]:
        """K names: the keypoints of a context; the root's before them where they are relative to it."""
        return (self.graph.root, *self.joints) if self.standardizer.origin == "root" else self.joints

    def forward(self, context: Context) -> FlowDistribution:
        """Return the distribution of the poses with these keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Returns
        -------
        FlowDistribution
            Of M poses, mm.

        Raises
        ------
        PoseDataError
            As :meth:`check`.
        """
        return FlowDistribution(self.flow.condition(self.embed(context)), self.standardizer, len(context))

    def embed(self, context: Context) -> EmbeddedContext:
        """Embed the observed keypoints.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Returns
        -------
        EmbeddedContext
            Of M poses.

        Raises
        ------
        PoseDataError
            As :meth:`forward`.
        """
        self.check(context)
        keypoints, observed = self.standardizer.keypoints(context), context.observed
        if self.standardizer.origin == "root":
            keypoints, observed = keypoints[:, 1:], observed[:, 1:]
        return self.flow.embed(keypoints, observed)

    def check(self, context: Context) -> None:
        """Raise an error for keypoints that don't fit this estimator.

        Parameters
        ----------
        context : Context
            Keypoints of M poses, pixels.

        Raises
        ------
        PoseDataError
            Where there are more or fewer, or where they are read relative to the root's and that is not finite (not
            checked on a GPU, where it would need a synchronisation).
        """
        check_keypoints(context, self.keypoints)
        if self.standardizer.origin != "root" or context.observed.device.type != "cpu":
            return
        no_root = context.observed.any(1) & ~context.keypoints[:, 0].isfinite().all(-1)
        if no_root.any():
            raise PoseDataError(
                f"keypoints: no {self.graph.root} in {int(no_root.sum()):,} of {len(context):,} images, and the "
                "others are read relative to it; expected it in every image. Give it, or use weights that were "
                "trained without."
            )

    def prior(self, poses: int = 1) -> FlowDistribution:
        """Return the distribution of poses without any observed keypoint.

        Parameters
        ----------
        poses : int
            M, the number of poses.

        Returns
        -------
        FlowDistribution
            Of M poses, all alike.
        """
        return FlowDistribution(self.flow.condition(self.flow.empty_context()), self.standardizer, poses)
