"""What does a person show? Signed areas of joints on a skeleton, and poses with their hypotheses in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from posecal.block import FloatArray
from posecal.errors import PoseDataError, did_you_mean, first_few
from posecal.pairs import PosePairs
from posecal.plot.style import FAINT, INK, OVER, OVER_TEXT, STYLE, UNDER, given
from posecal.report import Report
from posecal.skeleton import Skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D

__all__ = ["draw_poses", "frames_of", "poses", "signed_areas", "with_sign"]


def signed_areas(report: Report, *, ax: Axes | None = None) -> Axes:
    """Draw the signed area of every joint on a standing skeleton.

    Parameters
    ----------
    report : Report
        Holds the numbers.
    ax : matplotlib Axes, optional
        Where to draw; the current axes by default.

    Returns
    -------
    matplotlib Axes
        The axes: a disc per joint, its area growing with the size of the signed area, in the colour of its side.

    Raises
    ------
    PoseDataError
        Where the report has no signed areas, or its joints have no place on a person.
    """
    ax = given(ax)
    report.value("signed_area")
    joints = report.totals.subject.joints
    skeleton = Skeleton(joints)
    at = skeleton.rest_pose[:, [0, 2]] * [2.0, 1.0]  # from the front, and broad, so that the numbers have room
    for parent, child in skeleton.bones:
        ax.plot(*at[[parent, child]].T, color=FAINT, lw=3, solid_capstyle="round", zorder=1)
    values = {row.joint: row.value for row in report.rows if row.metric == "signed_area" and row.joint is not None}
    for joint, (x, y) in zip(joints, at, strict=True):
        value = values.get(joint)
        if value is None:
            ax.scatter(x, y, s=14, color="white", edgecolor=INK, lw=0.8, zorder=3)
            continue
        area = 20 + 1800 * abs(value)
        ax.scatter(x, y, s=area, color=OVER if value < 0 else UNDER, edgecolor="white", lw=0.8, zorder=2, gid=joint)
        side = -1 if x < 0 else 1
        ax.annotate(
            with_sign(value, 3),
            (x, y),
            xytext=(side * (3 + np.sqrt(area / np.pi)), 0),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=7,
            zorder=4,
        )
    ax.set_aspect("equal")
    ax.margins(0.2, 0.05)
    ax.axis("off")
    for side_name, place in (("right side", 0.08), ("left side", 0.92)):
        ax.text(place, 0.98, side_name, transform=ax.transAxes, ha="center", fontsize=7.5, color="#666666")
    for word, y, colour in (("overconfident", 0.32, OVER_TEXT), ("underconfident", 0.26, UNDER)):
        ax.text(0.5, y, word, transform=ax.transAxes, ha="center", color=colour)
    return ax


def with_sign(value: float, digits: int) -> str:
    """Write a number with its sign."""
    return f"{value:+.{digits}f}".replace("-", "−")


def poses(
    hypotheses: FloatArray,
    truth: FloatArray,
    joints: Sequence[str],
    *,
    cloud: str | None = None,
    most: int = 50,
    ax: Axes3D | None = None,
) -> Axes3D:
    """Draw one pose in three dimensions: its hypotheses, the truth, and the cloud of one joint.

    Parameters
    ----------
    hypotheses : array (N, K, 3)
        Hypotheses, mm; thin and grey.
    truth : array (K, 3)
        The true pose, mm; blue.
    joints : sequence of str
        K names; the bones follow from them.
    cloud : str, optional
        The joint whose hypotheses are shown as pink points.
    most : int
        How many hypotheses are drawn, evenly chosen.
    ax : matplotlib Axes3D, optional
        Where to draw; new axes by default.

    Returns
    -------
    matplotlib Axes3D
        The axes, with the person upright: up is where the head is.
    """
    if ax is None:
        from matplotlib import pyplot as plt

        ax = plt.figure().add_subplot(projection="3d")
    skeleton = Skeleton(tuple(joints))
    turn = _upright(truth, skeleton)
    shown = hypotheses[np.linspace(0, len(hypotheses) - 1, min(most, len(hypotheses))).astype(int)] @ turn
    true = truth @ turn
    for pose in shown:
        for bone in skeleton.bones:
            ax.plot(*pose[list(bone)].T, color="#8C8C8C", lw=0.4, alpha=0.35, zorder=1)
    if cloud is not None:
        points = shown[:, list(joints).index(cloud)]
        ax.scatter(*points.T, s=4, color=OVER, alpha=0.8, lw=0, zorder=3, depthshade=False)
    for bone in skeleton.bones:
        ax.plot(*true[list(bone)].T, color=UNDER, lw=1.8, solid_capstyle="round", zorder=4)
    centre = (true.max(axis=0) + true.min(axis=0)) / 2
    reach = 0.56 * (true.max(axis=0) - true.min(axis=0)).max()
    ax.set(xlim=centre[0] + reach * np.array([-1, 1]), ylim=centre[1] + reach * np.array([-1, 1]))
    ax.set_zlim(centre[2] - reach, centre[2] + reach)
    ax.set_box_aspect((1, 1, 1), zoom=1.6)
    ax.view_init(elev=8, azim=-62)
    ax.set_axis_off()
    return ax


def _upright(truth: FloatArray, skeleton: Skeleton) -> FloatArray:
    """A rotation of the axes, (3, 3), that puts the axis from the feet to the head upwards."""
    at = {name: place for place, name in enumerate(skeleton.joints)}
    top = next((at[name] for name in ("Head", "Neck/Nose", "Thorax") if name in at), None)
    low = [at[name] for name in ("LFoot", "RFoot", "LKnee", "RKnee", "Hip") if name in at][:2]
    if top is None or not low:
        return np.eye(3)
    upwards = truth[top] - truth[low].mean(axis=0)
    axis = int(np.abs(upwards).argmax())
    sign = float(np.sign(upwards[axis])) or 1.0
    turn = np.zeros((3, 3))
    first, second = ((axis + 1) % 3, (axis + 2) % 3)
    turn[first, 0], turn[second, 1], turn[axis, 2] = 1.0, sign, sign
    return turn


def frames_of(pairs: PosePairs, text: str | None, some: int = 5) -> list[int]:
    """Give the numbers of the poses that a user names by frame id or by number; evenly spaced ones by default.

    Raises
    ------
    PoseDataError
        For a name that no pose has.
    """
    if text is None:
        last = len(pairs.truth) - 1
        return sorted({last * (2 * place + 1) // (2 * some) for place in range(some)})
    places = {name: place for place, name in enumerate(pairs.frame_id.tolist())}
    found = []
    for word in (part.strip() for part in text.split(",")):
        if word not in places and not (word.isdecimal() and int(word) < len(places)):
            raise PoseDataError(
                f"frames: {word!r} is neither a frame id nor a number below {len(places):,}. "
                f"The first are {first_few(list(places))}."
            )
        found.append(places[word] if word in places else int(word))
    return found


def draw_poses(
    pairs: PosePairs, frames: Sequence[int], *, cloud: str | None = None, most: int = 50, columns: int = 5
) -> Figure:
    """Draw some poses with their hypotheses, side by side, without a display.

    Parameters
    ----------
    pairs : PosePairs
        Hypotheses and truth.
    frames : sequence of int
        The numbers of the poses.
    cloud, most
        As for :func:`poses`.
    columns : int
        Pictures in a row.

    Returns
    -------
    matplotlib Figure
        Ready to be saved.

    Raises
    ------
    PoseDataError
        For a joint that the poses don't have.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    if cloud is not None and cloud not in pairs.joints:
        raise PoseDataError(f"joint: {cloud!r} is not among the joints. {did_you_mean(cloud, pairs.joints)}")
    across = min(columns, len(frames))
    down = -(-len(frames) // across)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.9 * across, 2.7 * down + 0.25))
        for place, frame in enumerate(frames):
            ax = figure.add_subplot(down, across, place + 1, projection="3d")
            poses(
                pairs.hypotheses.read(frame, frame + 1)[:, 0],
                pairs.truth[frame],
                pairs.joints,
                cloud=cloud,
                most=most,
                ax=cast("Axes3D", ax),
            )
            ax.set_title(str(pairs.frame_id[frame]), fontsize=7, y=1.0)
        edge = 0.25 / figure.get_figheight()
        figure.subplots_adjust(left=0, right=1, top=0.96, bottom=edge, wspace=0, hspace=0.08)
        words = f"blue: truth · grey: {min(most, pairs.shape[0])} of {pairs.shape[0]} hypotheses"
        words += f" · pink: {cloud}" if cloud else ""
        figure.text(0.02, 0.3 * edge, words, fontsize=6.5, color="#444444")
    return figure
