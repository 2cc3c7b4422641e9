"""Intervals hold the true number about as often as they say, and never leave what is possible."""

import numpy as np
import pytest
from scipy import stats

from posecal.registry import metrics_of
from posecal.stats.uncertainty import interval
from tests.evidence.intervals import METRICS, covered, true_values
from tests.evidence.rejections import BAD, EFFECTS, comparison_p, p_values
from tests.helpers.clip_worlds import Design, data_sets

pytestmark = pytest.mark.slow

REPLICATES = 60


def fewest(share: float, replicates: int = REPLICATES) -> float:
    """The smallest share of replicates that chance leaves, in all but one of 10,000 cases."""
    return float(stats.binom(replicates, share).ppf(1e-4) / replicates)


@pytest.mark.parametrize("design", [Design(10), Design(6, half_in_one=True)], ids=str)
def test_intervals_cover_the_true_number(design: Design) -> None:
    truth = true_values(8000)
    for name, before, now, _ in covered(design, REPLICATES, truth, seed=1):
        assert now >= fewest(0.92), name
        assert now >= before - 0.05, name


def test_plain_intervals_of_shares_near_1_cover_too_seldom() -> None:
    (before,) = (before for name, before, *_ in covered(Design(6), REPLICATES, true_values(8000), 1) if name == "pck")
    assert before < 0.92 - stats.binom(REPLICATES, 0.92).std() / REPLICATES


def test_no_interval_leaves_its_range() -> None:
    for average in ("poses", "action"):
        totals, data = data_sets(Design(6, average=average), 20, ", ".join(METRICS), seed=2)
        for metric in metrics_of(totals.protocol, totals.spec).values():
            for cells in data if metric.deviation is None else ():
                found = interval(totals, metric, cells)
                assert metric.bounds[0] <= found.low <= found.high <= metric.bounds[1]
                assert np.isfinite([found.low, found.high]).all()


def test_the_level_of_comparisons_of_exchangeable_models_holds() -> None:
    draw = EFFECTS["both models log-normal, alike"]
    for first in (1, 9):
        sizes = np.ones(10, dtype=int)
        sizes[0] = first
        _, now = comparison_p(draw(np.random.default_rng(1), (1000, 10)), sizes)
        assert (now < 0.05).sum() <= stats.binom(1000, 0.05).ppf(1 - 1e-4)


def test_rare_bad_sequences_are_rejected_too_often_and_like_ones_are_not() -> None:
    bad, alike = (p_values(8, 100, share, "ece")["ece"] < 0.05 for share in (BAD, 0))
    assert bad.sum() > stats.binom(100, 0.05).ppf(1 - 1e-4)
    assert alike.sum() <= stats.binom(100, 0.05).ppf(1 - 1e-4)
