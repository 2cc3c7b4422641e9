"""Settings of a training: those of the estimator, the data and the optimisation, each with its default and limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from posecal.errors import PoseDataError
from posecal_models.data.detector import Detector
from posecal_models.limits import LARGEST_SEED, Limit, check_limits

__all__ = ["DataConfig", "ModelConfig", "TrainConfig"]

_Count = Annotated[int, Limit(1)]
_CountOrNone = Annotated[int, Limit(0)]
_NotNegative = Annotated[float, Limit(0)]
_Share = Annotated[float, Limit(0, 1, "a share between 0 and 1")]
_Positive = Annotated[float, Limit(math.ulp(0.0), words="a positive number")]
_Decay = Annotated[float, Limit(0, math.nextafter(1, 0), "0 or more and below 1")]
_Seed = Annotated[int, Limit(0, LARGEST_SEED, "0 or more")]


@dataclass(frozen=True)
class ModelConfig:
    """Settings of the estimator.

    Attributes
    ----------
    kind : str
        ``cgnf``, ``simple-baseline``, ``gaussian-noise``, ``mixture-density``, ``cvae``, ``inn`` or
        ``amortized-posterior``.
    size : str
        Size of a cGNF: ``tiny``, ``mini``, ``small``, ``large``, ``xlarge``.
    backward_weights, scale
        Options of a cGNF, see :class:`posecal_models.estimators.cgnf.flow.GraphFlow`.
    origin : str
        Origin of the keypoints: ``observed`` (the mean of the observed ones), ``root`` (the hip's keypoint, which the
        data must then hold) or ``none``.
    units : str
        Constants of the standardizer: ``fitted`` to the training set, or those of the ``released`` code.
    width, residuals, dropout
        Options of a SimpleBaseline, a mixture density network and a CVAE; width also of an INN, width and residuals of
        an amortised posterior.
    components : int
        Gaussians of a mixture density network or an amortised posterior.
    dimensions, position, splines
        Options of an amortised posterior, see
        :class:`posecal_models.estimators.amortized_posterior.AmortizedPosterior`.
    variant : str
        Variant of a mixture density network, a CVAE or an INN: ``released`` is that of its authors' code, ``repaired``
        mends its loss, see :mod:`posecal_models.published_losses` and :mod:`posecal_models.adversarial`.
    start : str
        Initial weights, named or a file, with their standardizer; random initialisation where not given.
    mean : str
        Mean of a Gaussian noise model: the weights file of its SimpleBaseline.
    spread : str
        Standard deviations of a Gaussian noise model: one σ per ``joint`` or per ``coordinate``.
    """

    kind: Literal[
        "cgnf", "simple-baseline", "gaussian-noise", "mixture-density", "cvae", "inn", "amortized-posterior"
    ] = "cgnf"
    size: Literal["tiny", "mini", "small", "large", "xlarge"] = "small"
    backward_weights: bool = True
    scale: Literal["sigmoid", "exp"] = "exp"
    origin: Literal["observed", "root", "none"] = "observed"
    units: Literal["fitted", "released"] = "fitted"
    width: _Count = 1024
    residuals: _CountOrNone = 2
    dropout: Annotated[float, Limit(0, math.nextafter(1, 0), "0 or more and below 1")] = 0.5
    components: _Count = 5
    dimensions: _CountOrNone = 0
    position: bool = True
    splines: _CountOrNone = 0
    variant: Literal["repaired", "released"] = "repaired"
    start: str = ""
    mean: str = ""
    spread: Literal["joint", "coordinate"] = "joint"

    def __post_init__(self) -> None:
        check_limits(self, "model")


@dataclass(frozen=True)
class DataConfig:
    """Settings of the training data.

    Attributes
    ----------
    test_subjects : tuple of str
        Held out for test.
    validation_subjects : tuple of str
        Held out for validation; their loss controls the learning rate and selects the weights that are saved.
    views : int
        Virtual cameras around each clip of motion capture. 0: each pose has a new camera in every batch, see
        :class:`posecal_models.data.fresh_views.FreshViews`, and those for validation have four.
    every : int
        Frame step of motion capture: every n-th frame is used.
    body_variation : float
        Variation of bone lengths in training, see :meth:`posecal_models.data.mocap.MocapPoses.project`.
    mirror : bool
        Whether half of the images are mirror images; with new cameras.
    limb_exchange : float
        Probability of a pose to have the legs or an arm of another; with new cameras.
    missing_share : float
        Share of the images of which keypoints are removed, each with a probability that is uniform between 0 and 1; not
        of a cGNF, which has augmentations of its own.
    validation_poses : int
        Number of poses of the validation subjects, evenly spaced.
    camera_seed : int
        Seed of the positions of the virtual cameras.
    detector : Detector
        Noise model of keypoints in virtual cameras.
    """

    test_subjects: tuple[str, ...] = ()
    validation_subjects: tuple[str, ...] = ()
    views: _CountOrNone = 4
    every: _Count = 1
    body_variation: Annotated[float, Limit(0, 1)] = 0.0
    mirror: bool = False
    limb_exchange: _Share = 0.0
    missing_share: _Share = 0.0
    validation_poses: _Count = 1000
    camera_seed: _Seed = 0
    detector: Detector = field(default_factory=Detector)

    def __post_init__(self) -> None:
        check_limits(self, "data")
        if self.views and (self.mirror or self.limb_exchange):
            raise PoseDataError(
                f"data.mirror, data.limb_exchange: given with data.views = {self.views}; expected 0, a new camera for "
                "each pose of a batch."
            )
        if both := sorted(set(self.test_subjects) & set(self.validation_subjects)):
            raise PoseDataError(
                f"data.test_subjects and data.validation_subjects: both name {', '.join(both)}; expected different "
                "subjects. Subjects that select the weights are no test of them."
            )


@dataclass(frozen=True)
class TrainConfig:
    """Settings of the optimisation.

    Attributes
    ----------
    objective : str
        ``likelihood``; for a Gaussian noise model also ``min-mpjpe``; for a SimpleBaseline ``squared-error``; for a
        mixture density network, a CVAE or an INN ``published``, by ``model.variant``.
    sample_weight : float
        λ: weight of the error of a cGNF's mode, per mm.
    sample_loss : str
        ``joints``, or ``pairs`` as released.
    loss_per : str
        Whether a cGNF's log densities are per ``pose`` or, as released, per ``node``.
    hypotheses : int
        N of the objective ``min-mpjpe`` and of an INN's losses; draws of a CVAE's latents.
    batch : int
        Poses per batch, over all processes.
    graphs_per_pose : int
        For a cGNF: sets of observed keypoints of each pose in a batch, the paper's five in turn. With 5 each pose has
        all of them in one batch, and its prior is computed once.
    augmentation : str
        ``paper`` or ``released``, see :func:`posecal_models.data.masks.mask_keypoints`.
    truth_noise : float
        Standard deviation of noise on the true poses under a likelihood, mm. With it no direction of the poses is
        degenerate.
    learning_rate : float
        Initial learning rate of Adam.
    weight_decay : float
        Decoupled weight decay of Adam.
    average : float
        Decay of the moving average of the weights, which is validated and saved; 0: the weights themselves.
    selection : str
        What selects the weights and drives the schedule: the ``loss`` of the validation poses, or the ``energy-score``
        of 50 hypotheses of each, mm.
    schedule : str
        ``plateau``: times 0.1 when the loss has not fallen for ``patience`` epochs, stop at the third time.
        ``exponential``: times 0.96 every 100,000 steps; ``continuous``: the same, a little at every step. ``cosine``:
        falls to 0 at the last step. ``halved``: halves for the last 5 of 155 parts.
    patience : int
        Epochs without improvement before the learning rate drops.
    epochs : int
        Maximum number of epochs.
    steps_per_epoch : int
        0: one pass over all poses.
    precision : str
        Of the matrices in the weights file, ``single`` or ``half``; training is in single precision.
    clip : float
        Maximum norm of the gradient.
    clip_by : str
        Whether ``clip`` is that ``norm``, or the largest ``value`` of each number of the gradient.
    beta1, beta2 : float
        Adam's decay of the means of gradients and of their squares.
    cuda_graph : bool
        Whether a GPU records a step of a cGNF once and replays it, see :mod:`posecal_models.cuda_graph`.
    seed : int
        Random seed.
    checkpoint_seconds : float
        Time between two checkpoints.
    """

    objective: Literal["likelihood", "min-mpjpe", "squared-error", "published"] = "likelihood"
    sample_weight: _NotNegative = 0.0
    sample_loss: Literal["joints", "pairs"] = "joints"
    loss_per: Literal["pose", "node"] = "pose"
    hypotheses: _Count = 200
    batch: _Count = 40
    graphs_per_pose: _Count = 5
    augmentation: Literal["paper", "released"] = "paper"
    truth_noise: _NotNegative = 0.0
    learning_rate: _Positive = 1e-3
    weight_decay: _NotNegative = 0.0
    average: _Decay = 0.0
    selection: Literal["loss", "energy-score"] = "loss"
    schedule: Literal["plateau", "exponential", "continuous", "cosine", "halved"] = "plateau"
    patience: _CountOrNone = 10
    epochs: _Count = 200
    steps_per_epoch: Annotated[int, Limit(0, words="0 (all poses) or more")] = 0
    precision: Literal["single", "half"] = "single"
    clip: _Positive = 1.0
    clip_by: Literal["norm", "value"] = "norm"
    beta1: _Decay = 0.9
    beta2: _Decay = 0.999
    cuda_graph: bool = False
    seed: _Seed = 0
    checkpoint_seconds: _NotNegative = 60.0

    def __post_init__(self) -> None:
        check_limits(self, "train")
