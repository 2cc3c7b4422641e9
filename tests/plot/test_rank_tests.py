"""Pictures of rank tests and of the uncertainty of poses: tested on the numbers of their lines."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from posecal.calibration import LEVELS
from posecal.calibration.rank_tests import RANK_TESTS
from posecal.errors import PoseDataError
from posecal.plot import (
    caption_of,
    draw,
    draw_rank_tests,
    event_reliability,
    rank_test,
    risk_coverage,
    sparsification,
)
from posecal.plot.style import ORANGE, ink
from tests.helpers.reports import report_of

WIDE = {"spread": 2.5, "metrics": "default, rank_tests, scores"}


@pytest.fixture
def ax() -> Axes:
    return Figure().add_subplot()


def test_a_line_is_the_curve_s_difference_from_the_diagonal(ax: Axes) -> None:
    report = report_of(**WIDE)  # type: ignore[arg-type]
    rank_test(report, "mahalanobis", ax=ax)
    line = ax.lines[-1]
    np.testing.assert_allclose(line.get_xdata(), LEVELS)
    np.testing.assert_allclose(line.get_ydata(), report.rank_curves("mahalanobis")[0] - LEVELS)


def test_the_grey_band_is_what_chance_allows(ax: Axes) -> None:
    report = report_of(**WIDE)  # type: ignore[arg-type]
    rank_test(report, "tarp", ax=ax)
    (band,) = (entry for entry in ax.collections if entry.get_gid() == "band")
    edge = band.get_paths()[0].vertices[:, 1].max()
    np.testing.assert_allclose(edge, report.test("tarp").band / 2)  # √(q (1 - q)) is 1/2 at its most


def test_what_is_rejected_is_orange_and_what_is_not_is_dark(ax: Axes) -> None:
    for spread in (1.0, 2.5):
        report = report_of(spread, metrics=WIDE["metrics"])  # type: ignore[arg-type]
        for test in report.rank_tests():
            axes = Figure().add_subplot()
            rank_test(report, test, ax=axes)
            rejected = report.rank_tests()[test][1] < 0.05
            assert axes.title.get_color() == (ORANGE if rejected else ink())


@pytest.mark.slow
def test_every_test_has_its_picture_with_its_name_and_adjusted_p() -> None:
    report = report_of(**WIDE)  # type: ignore[arg-type]
    figure = draw_rank_tests(report)
    titles = [axes.get_title() for axes in figure.axes]
    assert [" ".join(title.split("\n")[:-1]) for title in titles] == [test.label for test in RANK_TESTS]
    for title, (_, p) in zip(titles, report.rank_tests().values(), strict=True):
        assert title.endswith("p < 0.001" if p < 0.001 else f"p = {p:.3f}")


def test_without_rank_tests_there_is_no_picture(ax: Axes) -> None:
    with pytest.raises(
        PoseDataError, match=r'^rank_tests: the report has none\. Evaluate with metrics="rank_tests"\.$'
    ):
        draw_rank_tests(report_of())
    with pytest.raises(PoseDataError, match="tarp is no rank test of the report"):
        rank_test(report_of(), "tarp", ax=ax)


def test_the_sparsification_shows_what_is_left_by_spread_and_by_error(ax: Axes) -> None:
    report = report_of()
    sparsification(report, ax=ax)
    drawn = [np.asarray(line.get_ydata(), dtype=float) for line in ax.lines]
    for curve in report.sparsification():
        assert any(len(line) == len(curve) and np.abs(line - curve).max() < 1e-12 for line in drawn)


def test_the_risk_coverage_shows_the_error_of_what_is_kept_by_spread_and_by_error(
    ax: Axes, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = report_of()
    coverage, *curves = report.risk_coverage()
    for most in (len(coverage) + 5, 7):
        monkeypatch.setattr("posecal.plot.curves.MOST_POINTS", most)
        ax.clear()
        risk_coverage(report, ax=ax)
        by_name = {line.get_gid(): line for line in ax.lines}
        for name, curve in zip(("by_spread", "by_error"), curves, strict=True):
            x, y = (np.asarray(values, dtype=float) for values in by_name[name].get_data())
            assert len(x) == min(most, len(coverage))
            assert (x[0], x[-1]) == (coverage[0], 1)
            np.testing.assert_allclose(y, np.interp(x, coverage, curve))
        assert ax.get_ylabel() == "mean error of the poses kept [mm]"


def test_the_caption_of_the_risk_coverage_has_the_numbers_that_there_are() -> None:
    report = report_of()
    words = caption_of(draw(report, "risk_coverage"))
    assert words.startswith(f"AURC {report['aurc']:.3f} mm, excess AURC {report['excess_aurc']:.3f} mm")
    assert ("AUROC" in words.partition(". AURC:")[0]) == (report["failure_rate"] > 0)


def test_the_event_shows_the_isotonic_frequencies(ax: Axes) -> None:
    report = report_of(**WIDE)  # type: ignore[arg-type]
    event_reliability(report, ax=ax)
    observed = report.event_reliability().observed
    assert any(set(np.round(observed, 9)) <= set(np.round(np.asarray(line.get_ydata(), float), 9)) for line in ax.lines)
