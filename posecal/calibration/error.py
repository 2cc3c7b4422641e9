"""Calibration errors: the ECE of arrays, and the metrics that are read off calibration curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.calibration.curve import (
    OVER_JOINTS,
    SUMMARIES,
    calibration_curve,
    ece_over_joints,
    inside_table,
    is_resolved,
    joint_ece,
    signed_area,
)
from posecal.calibration.expected import ece_range, expected_curve
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition
from posecal.calibration.standardized import standardized_errors_of
from posecal.data.arrays import FloatArray, checked_choice
from posecal.engine.bounds import SHARE
from posecal.engine.finish import ReadOff, entry, per_joint
from posecal.engine.metric import Deviation, Metric, Statistic
from posecal.engine.protocol import OverJoints
from posecal.engine.scope import Scope


def ece(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    *,
    definition: Definition = "exchangeable",
    over: OverJoints = "median",
    where: npt.ArrayLike | None = None,
    root: int | None = None,
    weights: npt.ArrayLike | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> float:
    r"""Expected calibration error: mean distance of the calibration curve from the diagonal.

    .. math:: \mathrm{ECE} = \frac{1}{Q} \sum_q \left| \operatorname{median}_k \omega_k(q) - q \right|

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses, any unit; of angles give it.
    truth : array (M, K, D)
        True poses, the same unit.
    definition : str
        ``exchangeable``, ``paper`` or ``reference``; see :mod:`posecal.calibration.ranks`.
    over : str
        ``median``: ECE of the median curve (the paper's); ``mean``: mean of the joints' ECEs; ``worst``: the
        largest of them; ``pooled``: ECE of the pooled curve, for occluded joints.
    where : bool array (M, K) or (M,), optional
        The joints that count.
    root : int, optional
        The joint to subtract from every pose first; it is left out.
    weights : array (N, M), optional
        The weight of each hypothesis, of sum 1 for each pose, 0 where absent; (M, N) where ``axes`` has M first.
    axes : str, optional
        The layout of the hypotheses, such as ``MNKD``; needed where the shapes leave it open.
    unit : str or float, optional
        ``deg`` or ``rad`` where both are angles, whose distances are the shorter way round; any other is the same.

    Returns
    -------
    float
        The ECE, 0 to about 0.5; lower is better; NaN where nothing counts. The paper also writes it as a
        percentage of 0.5.

    Raises
    ------
    PoseDataError
        For shapes, dtypes, values or names that don't fit.

    Notes
    -----
    A perfect sampler shows more than 0 at finite M; see :func:`posecal.perfect_sampler`.
    Differs from the published code: none with ``definition="reference"``.

    See Also
    --------
    calibration_curve : The curve itself, with its signed area and coverage.
    posecal.perfect_sampler : The ECE that a perfect sampler would show.

    References
    ----------
    Pierzchlewicz et al., arXiv:2210.11179, section 3.1; Naeini, Cooper and Hauskrecht, AAAI 2015 (the name).

    Examples
    --------
    The truth lies outside all hypotheses: ω(q) = 0 below q = 1, where it is 1.

    >>> import numpy as np
    >>> round(ece(np.zeros((4, 3, 1, 3)), np.ones((3, 1, 3)), definition="paper"), 3)
    0.452
    """
    checked_choice(over, "over", OVER_JOINTS)
    curve = calibration_curve(
        hypotheses, truth, definition=definition, where=where, root=root, weights=weights, axes=axes, unit=unit
    )
    return curve.ece(over)


# --- metrics --------------------------------------------------------------------------------------------------

_OVER: dict[OverJoints, tuple[str, str, Deviation]] = {
    "median": ("the median over", "median of", Deviation(None, -1, "median")),
    "mean": ("the mean over", "mean of", Deviation(None, -1, "mean")),
    "worst": ("the worst of", "worst of", Deviation(None, -1, "worst")),
    "pooled": ("per pose the mean over", "pooled over", Deviation(-1)),
}
"""Each summary over joints in words and in a few words, and how it is made of a table: K joints, and the pooled one."""

COVERAGES = (50, 80, 90, 95)
"""Levels at which coverage is reported, in percent."""

_CALIBRATION = partial(Metric, unit="", family="calibration")
FEW_HYPOTHESES = 20
"""Of fewer hypotheses than this a perfect sampler's ECE (paper) is above 0.018, however many poses there are, and a
remark says which values an ECE can have."""

_ERROR = partial(
    _CALIBRATION,
    direction="lower",
    range="0 (the diagonal) to about 0.5 (a curve that never leaves the axis)",
    reading="Never 0 on finite data, not even for a perfect sampler: compare it with what a calibrated sampler would "
    "show by chance (…_null, …_null_95, …_p), never with an interval around itself. It does not say on which side a "
    "model errs (signed_area does), is blind to direction, shape and correlation (the rank tests are not), and a model "
    "that ignores the image can have a perfect one.",
    source="Pierzchlewicz et al., arXiv:2210.11179, section 3.1; Naeini et al., AAAI 2015",
)
_AREA = partial(
    _CALIBRATION,
    direction="zero",
    range="−0.5 (no truth in any ball) to 0.5 (every truth in the smallest)",
    bounds=(-0.5, 0.5),
    reading="Negative: the hypotheses are too narrow or off (overconfident). Positive: wider than need be "
    "(underconfident).",
    source="posecal",
)
_COVERAGE = partial(
    _CALIBRATION,
    direction="none",
    range="0 to 1; the level itself is best",
    bounds=SHARE,
    reading="What a user of the ball experiences: of the balls that hold 90 % of the hypotheses, so many hold the "
    "truth.",
    source="posecal; Kuleshov et al., arXiv:1807.00263 (the idea for regression)",
)


def _inside(scope: Scope, definition: Definition) -> Statistic:
    """How far inside each q-ball the truth lies, (K + 1, Q); the last row pools the joints of a pose."""
    compute = partial(inside_table, definition=definition, joints=scope.moving)
    return Statistic(f"inside_{definition}", compute, per_joint=True)


def _of_joints(function: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """Apply a function of curves to those of the joints, from tables (..., K + 1, Q) to (..., K)."""
    return lambda table: function(table[..., :-1, :])


def _extreme_area(curves: FloatArray, extreme: np.ufunc) -> FloatArray:
    return np.asarray(extreme.reduce(signed_area(curves), axis=-1))


def calibration_metrics(scope: Scope) -> Iterator[Metric]:
    """The ECE in its three definitions, and signed area and coverage of the exchangeable curve."""
    for definition in DEFINITIONS:
        yield from _errors(scope, definition)
    yield from _areas(scope)
    yield from _coverages(scope)


def _errors(scope: Scope, definition: Definition) -> Iterator[Metric]:
    statistic, joints, n = _inside(scope, definition), scope.counted(scope.moving), scope.spec.n_hypotheses
    over, plain = scope.protocol.summary_over_joints, definition == "exchangeable"
    low, high = ece_range(n, definition)
    few, reach = n < FEW_HYPOTHESES, f"{low:.2g} to {high:.2g} at N={n}"
    name, whose = ("ece", "") if plain else (f"ece_{definition}", f" ({definition})")
    summaries: tuple[tuple[str, str, OverJoints, str], ...] = (
        ("", "ECE", over, f"mean over q of |ω(q) − q|, ω: {_OVER[over][0]} {joints}"),
        ("_mean", "mean ECE of joints", "mean", f"mean over {joints} of the mean over q of |ω_k(q) − q|"),
        ("_worst", "ECE of the worst joint", "worst", f"largest over {joints} of the mean over q of |ω_k(q) − q|"),
    )
    for ending, label, how, meaning in summaries:
        yield _ERROR(
            name=name + ending,
            label=label + whose,
            brief=f"{definition}; {_OVER[how][1]} {scope.number(scope.moving)}",
            definition=f"{meaning}; {definition} definition, N={n}, {LEVELS.size} levels" + f"; can be {reach}" * few,
            statistic=statistic,
            finish=partial(ece_over_joints, over=how) if how == "mean" else ReadOff(SUMMARIES[how], joint_ece),
            by_joint=None if ending else (statistic, _of_joints(joint_ece)),
            headline=definition != "reference" and not ending,
            in_group_table=plain and not ending,
            in_joint_table=plain and not ending,
            deviation=replace(_OVER[how][2], errors=standardized_errors_of(scope)),
            offset=None if plain else expected_curve(n, definition) - LEVELS,
        )


def _areas(scope: Scope) -> Iterator[Metric]:
    statistic, joints, over = (
        _inside(scope, "exchangeable"),
        scope.counted(scope.moving),
        scope.protocol.summary_over_joints,
    )
    yield _AREA(
        name="signed_area",
        label="signed area",
        brief="− overconfident, + underconfident",
        definition=f"∫ (ω(q) − q) dq, exchangeable, ω: {_OVER[over][0]} {joints}; negative: overconfident, positive: "
        "underconfident",
        statistic=statistic,
        finish=ReadOff(SUMMARIES[over], signed_area),
        calibrated=0.0,
        by_joint=(statistic, _of_joints(signed_area)),
        headline=True,
        in_group_table=True,
        in_joint_table=True,
    )
    for name, words, extreme in (("min", "smallest", np.fmin), ("max", "largest", np.fmax)):
        yield _AREA(
            name=f"signed_area_{name}",
            label=f"{words} signed area of joints",
            brief=f"{words} of {scope.number(scope.moving)}",
            definition=f"∫ (ω_k(q) − q) dq, exchangeable, the {words} over {joints}",
            statistic=statistic,
            finish=_of_joints(partial(_extreme_area, extreme=extreme)),
        )


def _no_number(curves: FloatArray) -> FloatArray:
    """NaN for each curve (..., Q)."""
    return np.full(curves.shape[:-1], np.nan)


SINCE = "; NaN, since "
"""Stands in the definition of a number before the reason that it has no value."""


def unresolved(n_hypotheses: float) -> str:
    """Say why coverage is not known at a level."""
    return f"{SINCE}no ball of N={n_hypotheses:.3g} hypotheses holds this share of them"


def unresolved_coverages(n_hypotheses: float) -> list[int]:
    """Give the percentages at which coverage is not reported."""
    return [percent for percent in COVERAGES if not is_resolved(percent / 100, n_hypotheses)]


def _coverages(scope: Scope) -> Iterator[Metric]:
    statistic, joints, over = (
        _inside(scope, "exchangeable"),
        scope.counted(scope.moving),
        scope.protocol.summary_over_joints,
    )
    n, several = scope.spec.n_in_balls, scope.spec.n_coordinates > 1  # of one, intervals stand for balls
    for percent in COVERAGES:
        known = is_resolved(percent / 100, n)
        index = percent * (LEVELS.size - 1) // 100
        yield _COVERAGE(
            name=f"coverage_{percent}",
            label=f"coverage at {percent} %",
            brief=f"best: {percent / 100:g}" if known else f"not known of N={n:.3g}",
            definition=f"share of truths inside the ball that holds {percent} % of the hypotheses, exchangeable, "
            f"{_OVER[over][0]} {joints}; best: {percent / 100:g}{'' if known else unresolved(n)}",
            statistic=statistic,
            finish=ReadOff(SUMMARIES[over], entry(index) if known else _no_number),
            calibrated=percent / 100,
            by_joint=(statistic, _of_joints(per_joint(index) if known else _no_number)),
            headline=several and known,
            in_group_table=several and known and percent == 90,
            in_joint_table=several and known and percent in {50, 90},
        )
