"""Primary metrics of a comparison, and p-values adjusted for the number of metrics and of pairs of models.

Of some 50 metrics, some differ at p < 0.05 in every other comparison of two equally good models. So a comparison
rests on few *primary* metrics, which are chosen beforehand, and all others must pass a test that counts every metric.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from posecal.engine.presets import as_protocol
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, did_you_mean, raise_all
from posecal.registry import check_names, unmeasured
from posecal.stats.resampling import holm

PRIMARY = ("energy_score", "ece")
"""Primary metrics by default: a proper score, and calibration."""

INSTEAD = "min_mpjpe"
"""Primary where the energy score was not measured."""


def names_of(primary: object) -> tuple[str, ...]:
    """Give the names of primary metrics, which may be one text with commas; none where none were chosen.

    Raises
    ------
    PoseDataError
        For what is no text.

    Examples
    --------
    >>> names_of("crps, ece"), names_of(["crps"]), names_of(None)
    (('crps', 'ece'), ('crps',), ())
    """
    parts = [primary] if isinstance(primary, str) else () if primary is None else primary
    if not isinstance(parts, Sequence) or not all(isinstance(part, str) for part in parts):
        raise PoseDataError(f"primary: {primary!r}; expected names of metrics.")
    names = [name.strip() for part in parts for name in part.split(",")]
    return tuple(dict.fromkeys(filter(None, names)))


def check_known(primary: Sequence[str]) -> None:
    """Refuse names of primary metrics that no data could have, before any are measured.

    Raises
    ------
    PoseDataError
        For the names, all at once.
    """
    try:
        check_names(as_protocol(None, primary or None))
    except PoseDataError as error:
        raise PoseDataError(f"primary{error.message.removeprefix('metrics')}") from None


def check_primary(primary: Sequence[str], metrics: Collection[str], totals: Totals) -> None:
    """Refuse primary metrics that are not among those of a comparison.

    Parameters
    ----------
    primary : sequence of str
        Names that were chosen.
    metrics : collection of str
        Names of all metrics of the comparison.
    totals : Totals
        One model's sums.

    Raises
    ------
    PoseDataError
        For all such names at once.
    """
    raise_all(
        f"primary: {name} {unmeasured(name, totals.protocol, totals.spec) or _not_among(name, metrics)}"
        for name in primary
        if name not in metrics
    )


def _not_among(name: str, metrics: Collection[str]) -> str:
    return f"is not in the comparison. {did_you_mean(name, metrics)}"


def default_primary(metrics: Collection[str]) -> tuple[str, ...]:
    """Choose primary metrics: the energy score and the ECE; without that score, minMPJPE in its place.

    Parameters
    ----------
    metrics : collection of str
        Names of all metrics.

    Returns
    -------
    tuple of str
        All names where none of the three is among them.

    Examples
    --------
    >>> default_primary(["mpjpe", "min_mpjpe", "ece"]), default_primary(["mpjpe", "pck"])
    (('min_mpjpe', 'ece'), ('mpjpe', 'pck'))
    """
    wanted = PRIMARY if PRIMARY[0] in metrics else (INSTEAD, *PRIMARY[1:])
    return tuple(name for name in wanted if name in metrics) or tuple(metrics)


def adjust(p: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    r"""Adjust the p-values of several metrics, each of several pairs of models, for their number (Holm).

    .. math:: \tilde p_{(i)} = \max_{j \le i} \min\big( 1, (n - j + 1)\, p_{(j)} \big)

    Parameters
    ----------
    p : mapping of sequences of float
        By metric: the p-value of each pair; NaN where there is no test.

    Returns
    -------
    dict of lists of float
        The adjusted ones, alike.

    See Also
    --------
    posecal.stats.resampling.holm

    Examples
    --------
    Four tests; the smallest p-value counts four times, the next one three times.

    >>> adjust({"ece": [0.01, 0.5], "crps": [0.02, 1.0]})
    {'ece': [0.04, 1.0], 'crps': [0.06, 1.0]}
    """
    adjusted = iter(holm([value for values in p.values() for value in values]))
    return {name: [next(adjusted) for _ in values] for name, values in p.items()}
