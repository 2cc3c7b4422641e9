"""Picture of a skeleton with the signed area of every joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posecal.data.skeleton import Skeleton
from posecal.errors import printable
from posecal.plot.layout import free_sides, joint_places
from posecal.plot.style import FAINT, OVER, UNDER, given, ink

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from posecal.report.report import Report


FEW = 17
"""Of more joints the numbers are written smaller."""

MOST_NAMES = 30
"""More joints are not named."""


def signed_areas(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the signed area of every joint on the skeleton.

    Parameters
    ----------
    report : Report
        Holds the numbers.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: a disc per joint, its area growing with the size of the signed area, in the colour of its side; with
        names where up to 30 joints are not those of a person.

    Raises
    ------
    PoseDataError
        Where the report has no signed areas.
    """
    ax = given(ax)
    report.value("signed_area")  # refuses a report without
    joints = report.totals.spec.joints
    skeleton = Skeleton(joints, report.totals.spec.parents)
    at, is_person = joint_places(skeleton)
    is_named = not is_person and len(joints) <= MOST_NAMES
    size, sides = "small" if is_person and len(joints) <= FEW else "xx-small", np.where(at[:, 0] < 0, -1, 1)
    if not is_person:
        sides = free_sides(at)
    for parent, child in skeleton.bones:
        ax.plot(*at[[parent, child]].T, color=FAINT, lw=3, solid_capstyle="round", zorder=1)
    for joint, (x, y), side in zip(joints, at, sides, strict=True):
        value = report.value("signed_area", joint=joint)
        if np.isnan(value):
            ax.scatter(x, y, s=14, color="white", edgecolor=ink(), lw=0.8, zorder=3)
            continue
        area = 12 + 400 * abs(value)
        ax.scatter(x, y, s=area, color=OVER if value < 0 else UNDER, edgecolor="white", lw=0.8, zorder=2, gid=joint)
        ax.annotate(
            f"{printable(joint)}\n{with_sign(value, 2)}" if is_named else with_sign(value, 2),
            (x, y),
            xytext=(side * (3 + np.sqrt(area / np.pi)), 5 if x == 0 and is_person else 0),  # off the shoulder bone
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=size,
            zorder=4,
        )
    ax.set_aspect("equal")
    ax.margins(0.16, 0.05 if is_person else 0.15)
    ax.axis("off")
    for side_name, across in (("right side", 0.08), ("left side", 0.92)) if is_person else ():
        ax.text(across, 0.98, side_name, transform=ax.transAxes, ha="center", fontsize="small", color="#666666")
    for word, colour in (("overconfident", OVER), ("underconfident", UNDER)):
        ax.scatter([], [], s=60, color=colour, edgecolor="white", lw=0.8, label=word)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, handletextpad=0.2, columnspacing=1.5)
    return ax


def with_sign(value: float, digits: int) -> str:
    """Write a number with its sign."""
    return f"{value:+.{digits}f}".replace("-", "−")
