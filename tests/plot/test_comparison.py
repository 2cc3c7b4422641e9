"""Models on the axes of accuracy and calibration: tested on the numbers of their points."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from posecal.errors import PoseDataError
from posecal.plot import accuracy_and_calibration, caption_of, draw_comparison
from posecal.report.comparison import Comparison, compare_totals
from tests.helpers.reports import report_of

NAMES = ["right", "narrow"]


def pair(metrics: str = "default") -> Comparison:
    return compare_totals([report_of(spread, metrics=metrics).totals for spread in (1.0, 0.5)], NAMES)


@pytest.fixture
def ax() -> Axes:
    return Figure().add_subplot()


def test_a_model_is_a_point_at_its_ece_and_minmpjpe_with_its_interval(ax: Axes) -> None:
    found = pair()
    accuracy_and_calibration(found, ax=ax)
    for name in NAMES:
        (point,) = (line for line in ax.lines if line.get_gid() == name)
        np.testing.assert_allclose(point.get_xydata(), [[found.value("ece", name), found.value("min_mpjpe", name)]])
        sure = found.interval("min_mpjpe", name)
        assert any(np.array_equal(line.get_ydata(), [sure.low, sure.high]) for line in ax.lines)


def test_the_region_that_chance_allows_ends_at_the_null_quantile(ax: Axes) -> None:
    found = pair()
    accuracy_and_calibration(found, ax=ax)
    (region,) = (patch for patch in ax.patches if patch.get_gid() == "feasible")
    ends = region.get_extents().transformed(ax.transData.inverted()).intervalx
    np.testing.assert_allclose(ends, [0, found.feasible()], atol=1e-12)


def test_both_axes_are_needed(ax: Axes) -> None:
    with pytest.raises(PoseDataError, match=r"comparison: no ece; expected both min_mpjpe and ece"):
        accuracy_and_calibration(pair("min_mpjpe"), ax=ax)


def test_the_figure_carries_the_signature() -> None:
    found = pair()
    assert found.totals[0].signature in caption_of(draw_comparison(found, size=(5, 3), title="a title"))


def test_several_comparisons_stand_side_by_side_with_their_titles() -> None:
    found = pair()
    figure = draw_comparison({"one": found, "other": pair("min_mpjpe"), "third": found})
    assert [ax.get_title() for ax in figure.axes] == ["one", "third"]  # the other has no ECE
    assert figure.get_figwidth() == 2 * draw_comparison(found).get_figwidth()


def test_the_region_is_named_beside_it_or_within_where_there_is_no_place(ax: Axes) -> None:
    for models, side in ((["right"], "right"), (NAMES, "left")):
        ax.clear()
        totals = [report_of(spread).totals for spread in (1.0, 0.5)[: len(models)]]
        accuracy_and_calibration(Comparison(tuple(models), tuple(totals)), ax=ax)
        (words,) = (text for text in ax.texts if "calibrated, but for chance" in text.get_text())
        assert words.get_horizontalalignment() == side


def test_names_of_models_at_one_point_do_not_overlap(ax: Axes) -> None:
    totals = report_of(1.0).totals
    accuracy_and_calibration(compare_totals([totals] * 4, names := ["first", "second", "third", "fourth"]), ax=ax)
    extents = [text.get_window_extent() for text in ax.texts if text.get_text() in names]
    assert len(extents) == 4
    assert not any(one.overlaps(other) for one, other in combinations(extents, 2))


def test_names_of_models_cover_no_bar_of_another_where_there_is_room() -> None:
    totals = [report_of(spread).totals for spread in (1.0, 0.8, 0.6, 0.5)]
    (ax,) = draw_comparison(compare_totals(totals, names := ["a long name", "another name", "third", "fourth"])).axes
    extents = [text.get_window_extent() for text in ax.texts if text.get_text() in names]
    bars = [line.get_window_extent() for line in ax.lines if line.get_gid() not in names]
    assert (len(extents), len(bars)) == (4, 4)
    assert not any(extent.overlaps(bar) for extent in extents for bar in bars)
    assert all(ax.bbox.x0 < extent.x0 and extent.x1 < ax.bbox.x1 for extent in extents)
