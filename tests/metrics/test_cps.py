"""CPS, against loops over hypotheses, joints and thresholds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec, Scope
from posecal.geometry.procrustes import Alignment
from posecal.metrics import cps
from posecal.metrics.cps import cps_area, cps_metrics
from posecal.metrics.selection import SELECTIONS, Selection
from tests.helpers import oracles
from tests.helpers.random_worlds import Mask, mostly, skewed

N, M, K = 4, 9, 5

EDGES = [0.0, 1e-150, *(v for t in (1, 5, 145, 150, 299, 300) for v in (t, np.nextafter(t, 0), np.nextafter(t, 999)))]


@pytest.fixture
def where() -> Mask:
    """Some joints that count; in pose 4, none."""
    return mostly(M, K)


def trapezoid(error: float) -> float:
    heights = [float(error < t) for t in range(1, 301)]
    return sum((one + other) / 2 for one, other in itertools.pairwise(heights))


@given(st.floats(0, 400, allow_subnormal=False))
def test_cps_of_an_error_is_the_trapezoid_over_300_thresholds(error: float) -> None:
    np.testing.assert_allclose(cps_area(np.array(error)), trapezoid(error))


@pytest.mark.parametrize("error", EDGES)
def test_cps_is_right_at_its_thresholds_and_next_to_them(error: float) -> None:
    np.testing.assert_allclose(cps_area(np.array(error)), trapezoid(error))


def test_the_largest_cps_is_299_mm() -> None:
    y = np.random.default_rng(0).normal(0, 300, (1, 5, 3))
    np.testing.assert_allclose(cps(y[None], y), 299)


def test_a_cps_of_190_is_a_worst_joint_of_about_110_mm() -> None:
    y = np.zeros((1, 2, 3))
    x = y[None] + [[0, 0, 0], [110.4, 0, 0]]
    assert cps(x, y, align="none") == 300 - 110 - 0.5


@pytest.mark.parametrize("align", ["none", "similarity", "rigid", "scale"])
@pytest.mark.parametrize("select", SELECTIONS)
def test_cps_is_the_loop_over_300_thresholds(select: Selection, align: Alignment, where: Mask) -> None:
    x, y = skewed(4, N, M, K)
    link = oracles.links(oracles.pose_errors(x, y, where))
    moved = oracles.aligned(x, y, where, align)
    expected = oracles.cps(oracles.joint_errors(moved, y), where, select, link)
    np.testing.assert_allclose(cps(x, y, select=select, align=align, where=where), expected)


@pytest.mark.parametrize(
    ("unit", "shown", "most", "number"), [("mm", "mm", "0 to 299 mm", 190.0), ("share", "", "0 to 299/300", 190 / 300)]
)
def test_cps_is_an_area_or_a_share_of_300_mm(unit: str, shown: str, most: str, number: float) -> None:
    (metric,) = cps_metrics(Scope(Protocol(cps_unit=unit), DataSpec(4, ("a", "b", "c"), root=None)))  # type: ignore[arg-type]
    assert (metric.unit, metric.range) == (shown, most)
    assert metric.definition.endswith("; over 300 mm") == (unit == "share")
    assert metric.finish(np.array(190.0)) == pytest.approx(number)
