"""The tables on comparisons, with fewer replicates."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from scipy import stats

from tests.evidence import comparison
from tests.evidence.comparison import MODELS, exchangeable, false_winners, found, part_of


def share(cell: str) -> float:
    return float(cell.rstrip("%")) / 100


@pytest.mark.slow
def test_between_exchangeable_models_some_metric_names_a_better_one_in_at_most_7_percent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(comparison, "SIZES", (8,))
    times = 60
    most = stats.binom(times, 0.07).ppf(0.9999) / times
    rows = false_winners(times)
    assert [row[:3] for row in rows] == [("8", m, n) for m in "23" for n in ("48", "81")]
    for *_, before, primary, now in rows:
        assert share(primary) <= share(now) <= most
        assert share(now) < share(before)
    assert share(rows[1][3]) > most  # of all metrics, each with a test of its own


@pytest.mark.slow
def test_primary_metrics_find_more_than_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "SIZES", (40,))
    ((_, alone, primary, other, *_),) = found(40)
    assert share(alone) >= share(primary) > share(other)
    assert share(primary) > 0.5


@pytest.mark.slow
def test_a_part_of_a_comparison_is_the_one_of_its_models() -> None:
    """What is known of each model is taken over; the differences are those of a comparison from the start."""
    whole = exchangeable(8, 0)
    assert len(whole.differences) == 3 * 81
    part = part_of(whole, 2, "default, scores")
    afresh = comparison.compare_totals(part.totals, MODELS[:2])
    for ours, theirs in zip(part.differences, afresh.differences, strict=True):
        np.testing.assert_equal(asdict(ours), asdict(theirs))  # also where there is no value: few hypotheses
    assert len(part.differences) == 48
