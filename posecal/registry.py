"""All metrics: those of posecal, those that the user registers, and the choice among them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace as changed
from functools import cache, lru_cache, partial

from posecal.calibration.error import calibration_metrics
from posecal.calibration.intervals import interval_metrics
from posecal.calibration.rank_tests import PreRank, rank_test_metrics
from posecal.data.skeleton import JOINT_SETS
from posecal.engine import needs
from posecal.engine.measure import EFFECTIVE_NUMBER, HAS_SPREAD, SUM_OF_TRUE_POSES
from posecal.engine.metric import Curve, Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.errors import PoseDataError, did_you_mean, option, raise_all
from posecal.metrics.best_of import ROUND_SIZES, subset_curve, subset_metrics
from posecal.metrics.brier import brier_metrics
from posecal.metrics.cps import cps_curve, cps_metrics
from posecal.metrics.likelihood import LIKELIHOODS, lack_of_likelihood, likelihood_metrics, moments_statistic
from posecal.metrics.limbs import limb_metrics
from posecal.metrics.mpjpe import mpjpe_metrics
from posecal.metrics.multimodal import motion_metrics
from posecal.metrics.occlusion import occlusion_metrics_of
from posecal.metrics.pck import pck_curve, pck_metrics
from posecal.metrics.proper import score_metrics
from posecal.metrics.root_position import root_metrics
from posecal.metrics.sharpness import number_metrics, sharpness_metrics
from posecal.metrics.skill import skill_metrics
from posecal.metrics.uncertainty import uncertainty_metrics
from posecal.metrics.velocity import velocity_metrics
from posecal.metrics.vertices import vertex_metrics
from posecal.metrics.world import world_metrics

GROUPS = ("default", "rank_tests", "scores", "all")
"""Words that stand for several metrics."""

_BESIDE_TESTS = ("null", "null_95", "p", "p_adjusted", "floor", "floor_95")
"""Endings of the names of numbers that a report gives beside calibration errors and rank tests."""

_REGISTERED: dict[str, Metric] = {}


def register(metric: Metric, /, *, replace: bool = False) -> Metric:
    """Add a metric to every report that is made from now on.

    Parameters
    ----------
    metric : Metric
        Its name must be new; see :meth:`posecal.Metric.from_function`.
    replace : bool
        Whether a metric that was registered under this name gives way.

    Returns
    -------
    Metric
        The same.

    Raises
    ------
    PoseDataError
        For what is no metric, for a name that is reserved or that of another registered one, and for a name that
        can't be a column's.

    Examples
    --------
    >>> import numpy as np, posecal
    >>> def depth_error(hypotheses, truth):
    ...     return np.abs(hypotheses - truth)[..., 2].mean(axis=(0, 2))
    >>> metric = register(Metric.from_function(depth_error, definition="mean |z error|"))
    >>> report = posecal.evaluate(np.ones((5, 4, 2, 3)), np.zeros((4, 2, 3)), axes="NMKD", unit="mm")
    >>> report["depth_error"]
    1.0
    >>> unregister("depth_error")
    """
    if not isinstance(metric, Metric):
        raise PoseDataError(f"metric: {type(metric).__name__}; expected a Metric, such as Metric.from_function gives.")
    if metric.name in reserved_names():
        raise PoseDataError(f"metric: {metric.name} is one of posecal's own names; expected another.")
    if not metric.name.isidentifier():
        raise PoseDataError(f"metric: {metric.name!r}; expected a name of letters, digits and underscores.")
    if metric.name in _REGISTERED and not replace:
        raise PoseDataError(f"metric: {metric.name} is registered already; pass replace=True to replace it.")
    _REGISTERED[metric.name] = metric
    return metric


def unregister(name: str, /) -> None:
    """Remove a metric that was registered.

    Parameters
    ----------
    name : str
        Its name.

    Raises
    ------
    PoseDataError
        Where no metric of this name is registered.
    """
    if name not in _REGISTERED:
        raise PoseDataError(f"metric: {name!r} is not registered. {did_you_mean(name, _REGISTERED)}")
    del _REGISTERED[name]


def registered_metrics() -> tuple[Metric, ...]:
    """Give the metrics that the user registered, in that order."""
    return tuple(_REGISTERED.values())


def registered_as(what: object) -> Metric | None:
    """Give the registered metric that this is, or that was made of this function; None where there is none."""
    return next((metric for metric in _REGISTERED.values() if metric is what or metric.function is what), None)


def known_metrics(
    protocol: Protocol, spec: DataSpec, preranks: Mapping[str, PreRank] | None = None, own: Sequence[Metric] = ()
) -> dict[str, Metric]:
    """Every metric whose needs the data meet.

    Parameters
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.
    preranks : mapping of callables, optional
        The user's own pre-ranks, where their functions are available.
    own : sequence of Metric
        The user's own metrics.

    Returns
    -------
    dict
        Metrics by name, in the order of a report. With one hypothesis there is no calibration and no spread.

    Raises
    ------
    PoseDataError
        For options that don't fit the spec.
    """
    listed = _all_metrics(protocol, spec, preranks, own) if preranks or own else _plain_metrics(protocol, spec)
    scope, metrics = Scope(protocol, spec), {m.name: m for m in listed}
    return {name: needs.in_unit(m, spec) for name, m in metrics.items() if not needs.unmet(m, scope)}


def _all_metrics(
    protocol: Protocol, spec: DataSpec, preranks: Mapping[str, PreRank] | None, own: Sequence[Metric]
) -> list[Metric]:
    """Every metric, also those whose needs the data don't meet, in mm."""
    scope = Scope(protocol, spec)
    found = [*mpjpe_metrics(scope), *vertex_metrics(scope), *subset_metrics(scope), *pck_metrics(scope)]
    found += [*cps_metrics(scope), *velocity_metrics(scope), *world_metrics(scope), *limb_metrics(scope)]
    found += [*root_metrics(scope), *motion_metrics(scope)]
    if spec.n_hypotheses > 1:
        found += [*calibration_metrics(scope), *interval_metrics(scope), *rank_test_metrics(scope, preranks)]
        found += [*score_metrics(scope), *brier_metrics(scope), *skill_metrics(scope)]
        found += [*number_metrics(scope), *sharpness_metrics(scope), *uncertainty_metrics(scope)]
    found += likelihood_metrics(scope)
    found += [_with_functions(metric) for metric in own]
    if protocol.average != "poses":
        found = [changed(metric, definition=f"{metric.definition}; {_averaged(metric, protocol)}") for metric in found]
    return found


@lru_cache(maxsize=8)
def _plain_metrics(protocol: Protocol, spec: DataSpec) -> tuple[Metric, ...]:
    """Every metric of posecal's own; a report asks for them more than once."""
    return tuple(_all_metrics(protocol, spec, None, ()))


def left_out(protocol: Protocol, spec: DataSpec) -> str:
    """Say which metrics of the report the data can't have, and what they need; nothing where there is none."""
    return needs.left_out(_plain_metrics(protocol, spec), Scope(protocol, spec), protocol.wanted)


def _with_functions(metric: Metric) -> Metric:
    """Give a metric that was loaded without its functions as it is registered, where both are described alike."""
    registered = _REGISTERED.get(metric.name, metric)
    return registered if metric.lacks_functions and registered.description == metric.description else metric


def _averaged(metric: Metric, protocol: Protocol) -> str:
    """Say what is averaged over groups: curves before an error is read off them, else the groups' numbers."""
    is_curve = metric.family in {"calibration", "rank_tests"}
    what = "read off the mean of the curves" if is_curve else "the mean of its values"
    return f"{what} for each {protocol.average}"


def metrics_of(
    protocol: Protocol,
    spec: DataSpec,
    preranks: Mapping[str, PreRank] | None = None,
    own: Sequence[Metric] = (),
) -> dict[str, Metric]:
    """Choose the metrics that a protocol asks for.

    Parameters
    ----------
    protocol : Protocol
        The options; ``metrics`` names what is reported: names, and the words of :data:`GROUPS`. ``default`` are the
        headlines, and whatever comes free with them because it shares their statistics.
    spec, preranks, own
        As for :func:`known_metrics`.

    Returns
    -------
    dict
        Metrics by name, in the order of a report.

    Raises
    ------
    PoseDataError
        For an unknown name, or a metric that needs what the spec lacks; all such names at once.
    """
    known = known_metrics(protocol, spec, preranks, own)
    words = protocol.wanted
    families = {metric.family for metric in known.values()}
    possible = {*known, "default", "all", *families.intersection(GROUPS)}
    raise_all(f"metrics: {word} {_lacks(word, protocol, spec, known)}" for word in words if word not in possible)
    free = {m.statistic.name for m in known.values() if m.headline} | {"errors_by_n", "inside_reference", "radii"}
    return {
        name: metric
        for name, metric in known.items()
        if protocol.asks_for(name, metric.family) or ("default" in words and metric.statistic.name in free)
    }


def check_names(protocol: Protocol, own: Collection[str] = ()) -> None:
    """Refuse names of metrics that no data could make known, and pre-ranks whose names are another number's.

    Parameters
    ----------
    protocol : Protocol
        The options.
    own : collection of str
        Names of the user's own pre-ranks.

    Raises
    ------
    PoseDataError
        For the names, all at once.
    """
    beside = {f"{name}_{ending}" for name in own for ending in _BESIDE_TESTS}
    raise_all(
        f"preranks: {name!r}; expected a name of letters, digits and underscores, of no other number."
        for name in own
        if not str(name).isidentifier() or name in reserved_names() | _REGISTERED.keys() | beside
    )
    known = sorted({*_known_anywhere(), *_REGISTERED, *GROUPS, *own})
    unknown = [word for word in protocol.wanted if word not in known]
    if unknown:
        raise PoseDataError(f"metrics: {', '.join(unknown)} not known. {did_you_mean(unknown[0], known)}")


@cache
def reserved_names() -> frozenset[str]:
    """Give the names that no metric and no pre-rank of the user's can have.

    Returns
    -------
    frozenset of str
        Those of posecal's metrics, of :data:`GROUPS`, and of the numbers beside metrics, such as ``ece_p``.
    """
    beside = {f"{name}_{ending}" for name in _known_anywhere() for ending in _BESIDE_TESTS}
    return frozenset({*_known_anywhere(), *GROUPS, *beside, "effective_poses", "squared_error"})


@cache
def _known_anywhere() -> frozenset[str]:
    """Names of the metrics of data that have everything."""
    person = DataSpec(ROUND_SIZES[-1], JOINT_SETS["h36m-17"], 0, ("sequence",), clip_length=25, has_observed=True)
    return frozenset(any_metrics(Protocol(), changed(person, has_scores=True, dimensions=48, reference="another")))


def any_metrics(protocol: Protocol, spec: DataSpec, own: Sequence[Metric] = ()) -> dict[str, Metric]:
    """Every metric of such data, of positions in the world, of vertices and of weighted hypotheses as well."""
    protocol = changed(protocol, metrics=f"{protocol.metrics}, pve, pa_pve")
    known = partial(known_metrics, protocol, own=own)
    return {**known(changed(spec, root=None)), **known(changed(spec, has_weights=True)), **known(spec)}


def unmeasured(name: str, protocol: Protocol, spec: DataSpec) -> str:
    """Say how to measure a metric that the data allow and that a protocol does not ask for; nothing for others."""
    metric = known_metrics(protocol, spec).get(name)
    if metric is None:
        return ""
    wanted = [*protocol.wanted, metric.family if metric.family in GROUPS else name]
    return f"was not measured. Evaluate with {option('metrics', ', '.join(wanted))}."


def lacks(name: str, protocol: Protocol, spec: DataSpec) -> str:
    """Say what the data lack that a metric or a curve needs; nothing where they lack nothing."""
    scope = Scope(protocol, spec)
    numbers: tuple[Metric | Curve, ...] = (*_plain_metrics(protocol, spec), *_all_curves(scope))
    for number in numbers:
        if number.name == name and (lacking := needs.unmet(number, scope)):
            data = f"; the data are {spec.unit or 'no unit'}, D = {spec.n_coordinates}" * (
                needs.NEEDS["observed poses"] not in lacking
            )
            return f"needs {' and '.join(lacking)}{data}."
    return ""


def _lacks(name: str, protocol: Protocol, spec: DataSpec, known: dict[str, Metric]) -> str:
    if lacking := lacks(name, protocol, spec):
        return lacking
    in_world = Scope(Protocol(), changed(spec, root=None, labels=("sequence",)))
    if name in {metric.name for metrics in (velocity_metrics, world_metrics) for metric in metrics(in_world)}:
        if "sequence" not in spec.labels:
            return "needs sequences. Store a label sequence in the truth's file."
        return f"needs positions in the world, not relative to a root; expected {option('root_joint', 'none')}."
    if name in {metric.name for metric in motion_metrics(Scope(Protocol(), changed(spec, clip_length=25)))}:
        return "needs clips. Declare axes with a T, such as NMTKD, or store a label clip in the truth's file."
    if not spec.has_scores and ("weighted_pose" in name or "mode_mpjpe" in name):
        mode = ", or set mode to an index" * ("mode_mpjpe" in name)
        return f"needs the model's scores. Store scores beside the hypotheses{mode}."
    if name in LIKELIHOODS:
        return lack_of_likelihood(spec)
    if spec.n_hypotheses < 2 and name in {*GROUPS, *known_metrics(Protocol(), changed(spec, n_hypotheses=2))}:
        return "needs at least 2 hypotheses; there is 1."
    return f"is not known. {did_you_mean(name, known)}"


def curves_of(protocol: Protocol, spec: DataSpec) -> dict[str, Curve]:
    """Give the curves that pictures are drawn from.

    Parameters
    ----------
    protocol : Protocol
        The options.
    spec : DataSpec
        What is measured.

    Returns
    -------
    dict
        Curves by name.
    """
    scope = Scope(protocol, spec)
    unit = f" [{spec.unit}]" if spec.unit else ""
    return {
        curve.name: changed(curve, axes=(curve.axes[0].replace(" [mm]", unit), curve.axes[1].replace(" [mm]", unit)))
        for curve in _all_curves(scope)
        if not needs.unmet(curve, scope)
    }


def _all_curves(scope: Scope) -> tuple[Curve, ...]:
    return subset_curve(scope), pck_curve(scope), cps_curve(scope)


def statistics_of(
    protocol: Protocol,
    spec: DataSpec,
    by: Sequence[str] = (),
    preranks: Mapping[str, PreRank] | None = None,
    own: Sequence[Metric] = (),
) -> tuple[Statistic, ...]:
    """Choose the statistics that the metrics of a protocol need, each once."""
    metrics = list(metrics_of(protocol, spec, preranks, own).values())
    if "occlusion" in by:
        metrics += [m for kind in occlusion_metrics_of(protocol, spec).values() for m in kind.values()]
    counts = [EFFECTIVE_NUMBER, HAS_SPREAD] * (spec.is_ragged or spec.has_weights)
    statistics = [SUM_OF_TRUE_POSES, *counts, *(statistic for metric in metrics for statistic in metric.statistics)]
    if any(metric.name in LIKELIHOODS for metric in metrics):
        statistics += filter(None, [moments_statistic(Scope(protocol, spec))])
    if {"default", "all"}.intersection(protocol.wanted):
        statistics += [curve.statistic for curve in curves_of(protocol, spec).values()]
    return tuple({statistic.name: statistic for statistic in statistics}.values())


def wants_reference(protocol: Protocol) -> bool:
    """Whether a number needs the reference of skill scores."""
    return any(word in {"all", "scores"} or word.endswith("_skill") for word in protocol.wanted)
