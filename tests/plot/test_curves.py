"""The reliability diagram, errors against n, and correct shares: tested on the numbers of their lines."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import posecal
from posecal.calibration import LEVELS
from posecal.demo import sample
from posecal.errors import PoseDataError
from posecal.plot import errors_by_n, pck_curves, reliability, signed_areas
from posecal.plot.curves import default_definition
from posecal.report.report import Report
from tests.helpers.reports import N, report_of, unlabelled, world

DRAWERS = [reliability, errors_by_n, pck_curves, signed_areas]


@pytest.fixture
def ax() -> Axes:
    return Figure().add_subplot()


@pytest.fixture(autouse=True)
def _no_figure_is_left() -> Iterator[None]:
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


def line(ax: Axes, gid: str) -> Line2D:
    (found,) = (entry for entry in ax.lines if entry.get_gid() == gid)
    return found


def points(ax: Axes, gid: str) -> np.ndarray:
    return np.asarray(line(ax, gid).get_xydata())


@pytest.mark.parametrize("draw", DRAWERS, ids=lambda draw: draw.__name__)
def test_axes_that_are_given_are_drawn_on_and_returned(draw: Callable[..., Axes], ax: Axes) -> None:
    assert draw(report_of(), ax=ax) is ax
    assert ax.has_data()


@pytest.mark.parametrize("draw", DRAWERS, ids=lambda draw: draw.__name__)
def test_without_axes_the_current_ones_are_taken(draw: Callable[..., Axes]) -> None:
    from matplotlib import pyplot as plt

    current = plt.figure().add_subplot()
    assert draw(report_of()) is current


# --- reliability ----------------------------------------------------------------------------------------------


def test_the_dark_line_is_the_curve_that_the_ece_is_made_from(ax: Axes) -> None:
    reliability(report_of(0.5), ax=ax)
    drawn = points(ax, "summary")
    np.testing.assert_allclose(drawn[:, 0], LEVELS)
    np.testing.assert_allclose(np.abs(drawn[:, 1] - LEVELS).mean(), report_of(0.5).value("ece"), atol=1e-12)
    assert line(ax, "summary").get_label() == "median of joints"


@pytest.mark.parametrize("spread", [0.3, 1.0, 3.0])
def test_no_curve_crosses_the_words_of_the_two_sides(spread: float, ax: Axes) -> None:
    reliability({"one": report_of(spread), "other": report_of(1.0)}, ax=ax)
    ax.figure.draw_without_rendering()  # type: ignore[union-attr]
    for text in ax.texts:
        box = text.get_window_extent().transformed(ax.transData.inverted())
        across = np.linspace(box.x0, box.x1, 200)
        for curve in (line(ax, "summary one"), line(ax, "summary other"), line(ax, "diagonal")):
            values = np.interp(across, *np.asarray(curve.get_xydata()).T)
            assert values.max() < box.y0 or values.min() > box.y1
    assert {text.get_text() for text in ax.texts} == {"underconfident", "overconfident"}


def test_there_is_a_faint_line_behind_it_for_every_joint_but_the_root(ax: Axes) -> None:
    report = report_of()
    reliability(report, ax=ax)
    joints = posecal.JOINT_SETS["h36m-17"]
    assert [entry.get_gid() for entry in ax.lines if str(entry.get_gid()).startswith("joint ")] == [
        f"joint {name}" for name in joints[1:]
    ]
    coverage = report.calibration().joints[joints.index("RKnee")]
    np.testing.assert_allclose(points(ax, "joint RKnee")[:, 1], coverage)
    assert line(ax, "joint RKnee").get_zorder() < line(ax, "summary").get_zorder()


def test_the_diagonal_goes_from_corner_to_corner(ax: Axes) -> None:
    reliability(report_of(), ax=ax)
    np.testing.assert_allclose(points(ax, "diagonal"), [[0, 0], [1, 1]])
    assert (ax.get_xlim(), ax.get_ylim(), ax.get_aspect()) == ((0, 1), (0, 1), 1)


def test_the_regions_are_named_on_their_sides_of_the_diagonal(ax: Axes) -> None:
    reliability(report_of(), ax=ax)
    at = {text.get_text(): text.get_position() for text in ax.texts}
    x, y = at["underconfident"]
    assert y > x
    x, y = at["overconfident"]
    assert y < x


@pytest.mark.parametrize(("spread", "sign"), [(0.5, -1), (1.5, 1)])
def test_a_sampler_s_line_lies_in_the_region_of_its_name(spread: float, sign: int, ax: Axes) -> None:
    reliability(report_of(spread), ax=ax)
    drawn = points(ax, "summary")[5:-5]
    assert (sign * (drawn[:, 1] - drawn[:, 0]) > 0).all()


def band(ax: Axes) -> PolyCollection | None:
    found = [c for c in ax.collections if isinstance(c, PolyCollection) and c.get_gid() == "band"]
    return found[0] if found else None


@pytest.mark.slow
def test_the_band_of_a_calibrated_sampler_is_about_the_diagonal_and_widest_at_its_middle(ax: Axes) -> None:
    report = report_of()
    reliability(report, ax=ax)
    found = band(ax)
    assert found is not None
    edge = found.get_paths()[0].vertices
    middle = np.sort(edge[np.isclose(edge[:, 0], 0.5), 1])
    half = 0.5 * report.test("ece").band  # the root of q (1 − q) is a half there
    np.testing.assert_allclose([middle[0], middle[-1]], [0.5 - half, 0.5 + half])
    np.testing.assert_allclose(edge[np.isclose(edge[:, 0], 0), 1], 0, atol=1e-12)


def test_there_is_no_band_where_sequences_allow_no_test(ax: Axes) -> None:
    here = world()
    few = slice(0, 9)
    report = posecal.evaluate(
        sample(here, N)[:, few], here.truth[few], labels={"sequence": here.sequence[few]}, axes="NMKD", unit="mm"
    )
    reliability(report, ax=ax)
    assert band(ax) is None
    assert line(ax, "summary") is not None


def test_a_group_s_curve_is_drawn_where_it_is_asked_for(ax: Axes) -> None:
    report = report_of(by=("action",))
    reliability(report, group="action=sitting", ax=ax)
    np.testing.assert_allclose(points(ax, "summary")[:, 1], report.summary_curve(group="action=sitting"))
    assert np.abs(report.summary_curve(group="action=sitting") - report.summary_curve()).max() > 0.01


def test_another_definition_is_drawn_where_it_is_asked_for_or_the_only_one(ax: Axes) -> None:
    reliability(report_of(), definition="paper", ax=ax)
    np.testing.assert_allclose(points(ax, "summary")[:, 1], report_of().summary_curve("paper"))
    assert band(ax) is None
    assert default_definition(report_of()) == "exchangeable"
    assert default_definition(report_of(metrics="ece_reference")) == "reference"


def test_the_line_says_what_stands_for_all_joints(ax: Axes) -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 5), here.truth, joints="h36m-17", protocol=posecal.Protocol(ece_over="worst"), unit="mm"
    )
    reliability(report, ax=ax)
    assert line(ax, "summary").get_label() == "worst joint"


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (lambda: unlabelled(n=1), r"^reliability: calibration needs at least 2 hypotheses; there is 1\.$"),
        (
            lambda: report_of(metrics="mpjpe"),
            r'^reliability: the report has no calibration curves\. Evaluate with metrics="ece"\.$',
        ),
    ],
)
def test_without_curves_there_is_no_diagram(report: Callable[[], Report], words: str, ax: Axes) -> None:
    with pytest.raises(PoseDataError, match=words):
        reliability(report(), ax=ax)


# --- errors and correct shares --------------------------------------------------------------------------------


def test_errors_fall_from_the_mean_to_the_best_of_all(ax: Axes) -> None:
    errors_by_n(report_of(), ax=ax)
    x, y = np.asarray(ax.lines[0].get_xydata()).T
    assert (x[0], x[-1]) == (1, N)
    np.testing.assert_allclose(y[0], report_of().value("mpjpe"))
    np.testing.assert_allclose(y[-1], report_of().value("min_mpjpe"))
    assert (np.diff(y) < 0).all()
    assert ax.get_ylim()[0] == 0
    assert "[mm]" in ax.get_ylabel()


def test_ticks_are_round_numbers_of_hypotheses(ax: Axes) -> None:
    errors_by_n(report_of(), ax=ax)
    assert [label.get_text() for label in ax.get_xticklabels()] == ["1", "2", "5", "10"]


def test_shares_of_correct_joints_and_poses_rise_and_meet_the_reported_pck(ax: Axes) -> None:
    report = report_of(1.5)
    pck_curves(report, ax=ax)
    for gid in ("pck_curve", "cps_curve"):
        x, y = points(ax, gid).T
        assert (np.diff(y) >= 0).all()
        assert 0 <= y[0] <= y[-1] <= 1
        assert (x[0], x[-1]) == (0, 300)
    x, y = points(ax, "pck_curve").T
    np.testing.assert_allclose(y[x == 150], report.value("pck"), rtol=1e-6)
    x, y = points(ax, "cps_curve").T
    np.testing.assert_allclose(np.trapezoid(y, x), report.value("cps"), rtol=0.05)  # the area, from few points
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {"joints (PCK)", "whole poses, aligned (CPS)"}  # type: ignore[union-attr]


def test_a_curve_that_the_report_lacks_is_said(ax: Axes) -> None:
    with pytest.raises(
        PoseDataError, match=r"^curve: the report has no errors_by_n; it is among the default metrics\.$"
    ):
        errors_by_n(report_of(metrics="pck"), ax=ax)
    with pytest.raises(PoseDataError, match=r"^curve: the report has no pck_curve; it is among the default metrics\.$"):
        pck_curves(report_of(metrics="pck"), ax=ax)
