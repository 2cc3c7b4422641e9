"""Pictures against the horizon show the numbers of the groups, at their times."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

import posecal
from posecal.errors import PoseDataError
from posecal.plot import draw, draw_horizon, figure_bytes, horizon
from toy.motion_world import Forecast, MotionWorld

WORLD = MotionWorld(joints=2, frames=3)
OBSERVED, TRUTH = WORLD.sample(8, np.random.default_rng(0))
HYPOTHESES = WORLD.predict(Forecast(), OBSERVED, 25, np.random.default_rng(1))


def report_of(frames: int = 3, **options: object) -> posecal.Report:
    declared = {"axes": "NMTKD", "unit": "mm", "root_joint": "none", "by": "horizon", **options}
    return posecal.evaluate(HYPOTHESES[:, :, :frames], TRUTH[:, :frames], **declared)  # type: ignore[arg-type]


def test_a_line_holds_the_numbers_of_the_horizons_at_their_times() -> None:
    report = report_of(fps=50)
    ax = horizon(report, "coverage_90", ax=Figure().add_subplot())
    (line,) = [line for line in ax.get_lines() if line.get_gid() == "coverage_90"]
    assert np.asarray(line.get_xdata()).tolist() == [20, 40, 60]
    expected = [report.value("coverage_90", f"horizon={ms} ms") for ms in (20, 40, 60)]
    assert np.asarray(line.get_ydata()).tolist() == expected
    assert ax.get_xlabel() == "horizon [ms]"


def test_a_saved_result_by_horizon_is_drawn_without_saying_so_again() -> None:
    figure = draw(posecal.Report(report_of().totals), "horizon")
    first, second = figure.axes
    assert [text.get_text() for text in first.get_legend().get_texts()] == ["coverage at 50 %", "coverage at 90 %"]
    assert [line.get_gid() for line in second.get_lines()] == ["min_mpjpe", "mean_pose_mpjpe", "radius_90"]
    assert first.get_xlabel() == "frame of the clip"
    assert figure_bytes(figure, ".png").startswith(b"\x89PNG")


def test_one_horizon_is_a_point() -> None:
    ax = horizon(report_of(1), "coverage_90", ax=Figure().add_subplot())
    assert ax.get_lines()[0].get_marker() == "o"


def test_horizons_of_one_s_own_names_stand_in_their_order() -> None:
    own = np.tile(["0 near", "1 middle", "2 far"], 8)
    ax = horizon(report_of(labels={"horizon": own}), "min_mpjpe", ax=Figure().add_subplot())
    assert np.asarray(ax.get_lines()[0].get_xdata()).tolist() == [1, 2, 3]


def test_what_it_can_t_show_is_refused() -> None:
    with pytest.raises(
        PoseDataError, match=r'^horizon: the result has no groups by horizon; expected clips, such as axes="NMT'
    ):
        draw_horizon(report_of(by=()))
    with pytest.raises(PoseDataError, match=r"^horizon: the result has neither coverage nor errors"):
        draw_horizon(report_of(metrics="ade"))
