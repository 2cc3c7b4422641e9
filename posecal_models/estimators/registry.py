"""Construction of the reference estimators, from a configuration or from the description in a weights file."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from torch import nn

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError
from posecal_models.data.standardizer import Standardizer
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.cgnf.flow import SIZES, FlowSize
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cvae import CVAE
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.inn import INN
from posecal_models.estimators.mixture_density import MixtureDensityNetwork
from posecal_models.estimators.simple_baseline import HOURGLASS, SimpleBaseline
from posecal_models.settings import ModelConfig

__all__ = ["ReferenceEstimator", "baseline_keypoints", "build", "build_from_config", "describe", "parameter_count"]

ReferenceEstimator = CGNF | SimpleBaseline | GaussianNoise | MixtureDensityNetwork | CVAE | INN | AmortizedPosterior

_PUBLISHED = ("mixture-density", "cvae", "inn")
"""Models of other papers."""

_OptionedEstimator = MixtureDensityNetwork | CVAE | INN | AmortizedPosterior
_OPTIONS: dict[str, tuple[type[_OptionedEstimator], tuple[str, ...]]] = {
    "mixture-density": (
        MixtureDensityNetwork,
        ("components", "width", "residuals", "dropout", "origin", "variant"),
    ),
    "cvae": (CVAE, ("width", "residuals", "dropout", "origin", "variant")),
    "inn": (INN, ("width", "variant")),
    "amortized-posterior": (
        AmortizedPosterior,
        ("dimensions", "components", "width", "residuals", "position", "origin", "splines"),
    ),
}
"""Estimators whose options are settings of the same name."""


def build_from_config(
    config: ModelConfig, *, mean: SimpleBaseline | None = None, keypoints: tuple[str, ...] | None = None
) -> ReferenceEstimator:
    """Build an untrained estimator.

    Parameters
    ----------
    config : ModelConfig
        Settings of the estimator.
    mean : SimpleBaseline, optional
        The trained point estimator that a Gaussian noise model needs.
    keypoints : tuple of str, optional
        Keypoints of a SimpleBaseline; those of :func:`baseline_keypoints` where not given.

    Returns
    -------
    ReferenceEstimator
        With random initialisation.

    Raises
    ------
    PoseDataError
        Where a Gaussian noise model has no mean.
    """
    names = baseline_keypoints(config) if keypoints is None else keypoints
    if config.kind == "gaussian-noise":
        if mean is None:
            raise PoseDataError("model.mean: not given; expected the weights file of a trained SimpleBaseline.")
        return GaussianNoise(mean, spread=config.spread)
    if config.kind in _OPTIONS:
        optioned, options = _OPTIONS[config.kind]
        return optioned(keypoints=names, **{name: getattr(config, name) for name in options})
    estimator: CGNF | SimpleBaseline
    if config.kind == "cgnf":
        estimator = CGNF(
            SIZES[config.size],
            backward_weights=config.backward_weights,
            scale=config.scale,
            origin=config.origin,
        )
    else:
        estimator = SimpleBaseline(
            keypoints=names,
            width=config.width,
            residuals=config.residuals,
            dropout=config.dropout,
            origin=config.origin,
        )
    if config.units == "released":
        estimator.standardizer = Standardizer.released(len(estimator.joints), origin=config.origin)
    return estimator


def baseline_keypoints(config: ModelConfig) -> tuple[str, ...]:
    """Name the keypoints of an estimator that reads all of them.

    16, after the hip's where they are relative to it; those of the stacked hourglass network for the published models.
    """
    if config.kind in _PUBLISHED:
        return HOURGLASS
    return joint_set("h36m-17" if config.origin == "root" else "h36m-16")


def describe(estimator: ReferenceEstimator) -> dict[str, Any]:
    """Describe an estimator, so that :func:`build` can construct it again.

    Parameters
    ----------
    estimator : ReferenceEstimator
        A reference estimator.

    Returns
    -------
    dict
        Plain values.
    """
    if isinstance(estimator, CGNF):
        return {
            "kind": "cgnf",
            "size": asdict(estimator.size),
            "joints": list(estimator.graph.joints),
            "parents": list(estimator.graph.parents),
            "root": estimator.graph.root,
            "backward_weights": estimator.flow.backward_weights,
            "scale": estimator.flow.scale,
            "origin": estimator.standardizer.origin,
            "dimensions": estimator.flow.dimensions,
        }
    if isinstance(estimator, SimpleBaseline):
        return {
            "kind": "simple-baseline",
            "joints": list(estimator.joints),
            "keypoints": list(estimator.keypoints),
            "width": estimator.last.in_features,
            "residuals": len(estimator.residuals),
            "origin": estimator.standardizer.origin,
        }
    if isinstance(estimator, GaussianNoise):
        return {
            "kind": "gaussian-noise",
            "spread": "joint" if estimator.log_sigma.shape[1] == 1 else "coordinate",
            "mean": describe(estimator.mean),
        }
    kind = next(kind for kind, (optioned, _) in _OPTIONS.items() if isinstance(estimator, optioned))
    names = {"joints": list(estimator.joints), "keypoints": list(estimator.keypoints)}
    return {"kind": kind, **names, **estimator.options}


def build(description: dict[str, Any]) -> ReferenceEstimator:
    """Build an estimator from its description.

    Parameters
    ----------
    description : dict
        From :func:`describe`.

    Returns
    -------
    ReferenceEstimator
        With random initialisation.

    Raises
    ------
    PoseDataError
        Where the description is incomplete or of another estimator.
    """
    try:
        kind = description["kind"]
        if kind == "cgnf":
            graph = PoseGraph(tuple(description["joints"]), tuple(description["parents"]), description["root"])
            options = {name: description[name] for name in ("backward_weights", "scale", "origin")}
            options["dimensions"] = description.get("dimensions", 3)
            return CGNF(FlowSize(**description["size"]), graph, **options)
        if kind == "simple-baseline":
            options = {name: description[name] for name in ("width", "residuals", "origin")}
            return SimpleBaseline(tuple(description["joints"]), tuple(description["keypoints"]), **options)
        if kind in _OPTIONS:
            optioned, names = _OPTIONS[kind]
            complete = {"splines": 0, **description}  # of weights that were written before there were any
            options = {name: complete[name] for name in (*names, *({"joint_dimensions"} & description.keys()))}
            return optioned(tuple(description["joints"]), tuple(description["keypoints"]), **options)
        if kind == "gaussian-noise":
            mean = build(description["mean"])
            if isinstance(mean, SimpleBaseline):
                return GaussianNoise(mean, spread=description["spread"])
    except (KeyError, TypeError) as problem:
        raise PoseDataError(f"weights: incomplete or invalid description ({problem}).") from problem
    raise PoseDataError(
        f"weights: of {description.get('kind')!r}; expected cgnf, simple-baseline, "
        f"gaussian-noise or {', '.join(_OPTIONS)}."
    )


def parameter_count(estimator: nn.Module) -> int:
    """Count the parameters of an estimator, those of a frozen mean included."""
    return sum(parameter.numel() for parameter in estimator.parameters())
