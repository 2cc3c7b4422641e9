"""Training configuration, read from TOML.

A configuration has three tables, ``[model]``, ``[data]`` and ``[train]``; settings that are not given have the defaults
below. Named configurations are in the folder ``configs`` beside this file.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from posecal.errors import PoseDataError, PoseFileError, did_you_mean, raise_all, refuse_unreadable
from posecal_models.config_tables import from_table
from posecal_models.data.detector import Detector
from posecal_models.limits import LARGEST_SEED, Limit, check_limits

__all__ = ["Config", "DataConfig", "ModelConfig", "TrainConfig", "named_configs"]

_FOLDER = Path(__file__).parent / "configs"

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


@dataclass(frozen=True)
class Config:
    """Complete configuration of a training.

    Attributes
    ----------
    model, data, train
        The three tables.

    Examples
    --------
    >>> Config.from_table({"model": {"size": "tiny"}}).model.size
    'tiny'
    >>> Config.from_table({"model": {"sise": "tiny"}})
    Traceback (most recent call last):
    posecal.errors.PoseDataError: config: model.sise is not known. Did you mean size?
    """

    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        if self.model.kind in ("simple-baseline", "mixture-density", "cvae") and self.train.batch == 1:
            raise PoseDataError(
                f"train.batch: 1 of a {self.model.kind}; expected 2 or more. Its batch norm needs the variance of a "
                "batch."
            )
        if self.model.units == "released" and self.model.kind in ("mixture-density", "cvae", "inn"):
            raise PoseDataError(f"model.units: released of a {self.model.kind}; expected fitted. Leave it out.")
        if self.model.kind == "cvae" and self.model.width < 4:
            raise PoseDataError(
                f"model.width: {self.model.width} of a cvae; expected 4 or more. A quarter of them are latents."
            )
        if self.model.kind == "inn" and self.train.hypotheses == 1:
            raise PoseDataError("train.hypotheses: 1 of an inn; expected 2 or more. Its losses need their spread.")
        if self.train.cuda_graph and self.model.kind != "cgnf":
            raise PoseDataError(
                f"train.cuda_graph: true of a {self.model.kind}; expected a cgnf, whose steps are thousands of short "
                "kernels. Leave it out."
            )

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Config:
        """Build a configuration from parsed TOML.

        Parameters
        ----------
        table : dict
            Nested tables.

        Returns
        -------
        Config
            With defaults for settings that are not given.

        Raises
        ------
        PoseDataError
            Where a name is unknown or a value is invalid; all problems in one error.
        """
        problems: list[str] = []
        config = from_table(cls, table, "", problems)
        raise_all(problems)
        if config is None:
            raise PoseDataError("config: can't be read.")
        return config

    @classmethod
    def load(cls, name: str) -> Config:
        """Read a named configuration or a TOML file.

        Parameters
        ----------
        name : str
            One of :func:`named_configs`, or a path.

        Returns
        -------
        Config
            The configuration.

        Raises
        ------
        PoseFileError, PoseDataError
            Where the file is missing or not valid.
        """
        path = _FOLDER / f"{name}.toml" if name in named_configs() else Path(name)
        try:
            content = path.read_bytes()
        except OSError as problem:
            raise PoseFileError(
                f"{name}: no such configuration ({problem.strerror}). {did_you_mean(name, named_configs())}"
            ) from problem
        with refuse_unreadable(path, "not valid TOML ({})."):  # also a number of thousands of digits, in messages
            return cls.from_table(tomllib.loads(content.decode("utf-8")))

    def with_changes(self, changes: Sequence[str]) -> Config:
        """Override single settings.

        Parameters
        ----------
        changes : sequence of str
            Each ``table.name=value`` with the value as in TOML; quotes around text may be left out.

        Returns
        -------
        Config
            With these settings.

        Raises
        ------
        PoseDataError
            Where a change can't be parsed or a value is invalid.

        Examples
        --------
        >>> Config().with_changes(["model.scale=exp", "train.epochs=3"]).train.epochs
        3
        """
        table = self.table()
        for change in changes:
            name, equals, value = change.partition("=")
            *tables, last = name.strip().split(".")
            inner: Any = table
            for part in tables:
                inner = inner.get(part) if isinstance(inner, dict) else None
            if not equals or not tables or not isinstance(inner, dict):
                raise PoseDataError(f"--set {change}: expected table.name=value, such as train.epochs=20.")
            try:
                inner[last] = tomllib.loads(f"value = {value}")["value"]
            except ValueError:
                inner[last] = value.strip()
        return Config.from_table(table)

    def table(self) -> dict[str, Any]:
        """Return the configuration as nested dictionaries of plain values."""
        return dataclasses.asdict(self)


def named_configs() -> tuple[str, ...]:
    """Name the configurations that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))
