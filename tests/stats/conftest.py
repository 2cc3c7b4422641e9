"""The comparison of three models."""

from __future__ import annotations

import pytest

from posecal.report.comparison import Comparison, compare_totals
from tests.helpers.comparisons import MODELS, Y, totals_of


@pytest.fixture(scope="module")
def three() -> Comparison:
    return compare_totals([totals_of(x, Y) for x in MODELS.values()], list(MODELS))
