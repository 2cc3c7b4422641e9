"""Pictures of skeletons: signed areas of the joints, and poses with their hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import find_joint, joint_keys
from posecal.data.root import origin
from posecal.data.skeleton import Skeleton
from posecal.errors import PoseDataError, did_you_mean, first_few, printable
from posecal.plot.layout import free_sides, joint_places
from posecal.plot.style import FAINT, INK, OVER, STYLE, UNDER, given

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D

    from posecal.data.pose_data import PoseData
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
    size, sides = 7 if is_person and len(joints) <= FEW else 5, np.where(at[:, 0] < 0, -1, 1)
    if not is_person:
        sides = free_sides(at)
    for parent, child in skeleton.bones:
        ax.plot(*at[[parent, child]].T, color=FAINT, lw=3, solid_capstyle="round", zorder=1)
    for joint, (x, y), side in zip(joints, at, sides, strict=True):
        value = report.value("signed_area", joint=joint)
        if np.isnan(value):
            ax.scatter(x, y, s=14, color="white", edgecolor=INK, lw=0.8, zorder=3)
            continue
        area = 20 + 1800 * abs(value)
        ax.scatter(x, y, s=area, color=OVER if value < 0 else UNDER, edgecolor="white", lw=0.8, zorder=2, gid=joint)
        ax.annotate(
            f"{printable(joint)}\n{with_sign(value, 3)}" if is_named else with_sign(value, 3),
            (x, y),
            xytext=(side * (3 + np.sqrt(area / np.pi)), 5 if x == 0 and is_person else 0),  # off the shoulder bone
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=size,
            zorder=4,
        )
    ax.set_aspect("equal")
    ax.margins(0.2, 0.05 if is_person else 0.15)
    ax.axis("off")
    for side_name, across in (("right side", 0.08), ("left side", 0.92)) if is_person else ():
        ax.text(across, 0.98, side_name, transform=ax.transAxes, ha="center", fontsize=7.5, color="#666666")
    for word, colour in (("overconfident", OVER), ("underconfident", UNDER)):
        ax.scatter([], [], s=60, color=colour, edgecolor="white", lw=0.8, label=word)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0.03), ncols=2, handletextpad=0.2, columnspacing=1.5)
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
    ax: Any = None,
    parents: Sequence[int] = (),
) -> Any:
    """Draw one pose in two or three dimensions: its hypotheses, the truth, and the cloud of one joint.

    Parameters
    ----------
    hypotheses : array (N, K, D)
        Hypotheses; thin and grey.
    truth : array (K, D)
        The true pose; blue.
    joints : sequence of str
        K names; the bones follow from them. Joints without bones are points.
    cloud : str, optional
        The joint whose hypotheses are shown as pink points.
    most : int
        How many hypotheses are drawn, evenly chosen.
    ax : matplotlib Axes or Axes3D, optional
        Where to draw, as D has it; new axes by default.
    parents : sequence of int, optional
        The number of each joint's parent, -1 for a root, instead of the bones that follow from the names.

    Returns
    -------
    matplotlib Axes or Axes3D
        The axes, with a person upright: up is where the head is.

    Raises
    ------
    PoseDataError
        For one coordinate, a joint that is not there, or where no coordinate is finite.
    """
    from matplotlib.collections import LineCollection
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    d = truth.shape[-1]
    if d not in (2, 3):
        raise PoseDataError(f"truth: D = {d}; expected 2 or 3 coordinates to draw.")
    skeleton = Skeleton(tuple(joints), tuple(parents))
    bones = list(skeleton.bones)
    alone = [k for k in range(len(joints)) if not any(k in bone for bone in bones)]
    at = None if cloud is None else find_joint(cloud, tuple(joints))
    if cloud is not None and at is None:
        raise PoseDataError(f"joint: {cloud!r} is not among the joints. {did_you_mean(cloud, joints)}")
    turn = upright(truth, skeleton)
    chosen = np.linspace(0, len(hypotheses) - 1, min(most, len(hypotheses))).astype(int)
    shown, true = (np.where(np.isfinite(points), points, np.nan) @ turn for points in (hypotheses[chosen], truth))
    if not (np.isfinite(true).any() and np.isfinite(shown).any()):
        raise PoseDataError("pose: no joint with finite coordinates; expected some to draw.")
    if ax is None:
        from matplotlib import pyplot as plt

        ax = plt.figure().add_subplot(projection="3d" if d == 3 else None)
    depth: dict[str, Any] = {"depthshade": False} if d == 3 else {}
    if bones:
        lines: Any = Line3DCollection if d == 3 else LineCollection
        grey = lines(shown[:, bones].reshape(-1, 2, d), colors="#8C8C8C", lw=0.4, alpha=0.35, zorder=1)
        grey.set_gid("hypotheses")
        (ax.add_collection3d if d == 3 else ax.add_collection)(grey)
    if alone:
        points = shown[:, alone].reshape(-1, d)
        ax.scatter(*points.T, s=2, color="#8C8C8C", alpha=0.35, lw=0, zorder=1, gid="hypotheses of points", **depth)
        ax.scatter(*true[alone].T, s=9, color=UNDER, lw=0, zorder=4, gid="truth of points", **depth)
    if at is not None:
        points = shown[:, at]
        ax.scatter(*points.T, s=4, color=OVER, alpha=0.8, lw=0, zorder=3, gid=f"cloud {joints[at]}", **depth)
    for bone in bones:
        ends = " ".join(joints[end] for end in bone)
        ax.plot(*true[list(bone)].T, color=UNDER, lw=1.8, solid_capstyle="round", zorder=4, gid=f"truth {ends}")
    if d == 3:
        _frame(ax, np.concatenate([true[None], shown]))
    else:
        ax.set_aspect("equal")
        ax.margins(0.08)
        ax.set_axis_off()
    return ax


def _frame(ax: Axes3D, points: FloatArray) -> None:
    """Look at some poses from the side, as large as they fit; a few far ones may stick out."""
    low, high = np.nanquantile(points.reshape(-1, 3), [0.01, 0.99], axis=0)
    middle, reach = (low + high) / 2, np.maximum(0.55 * (high - low), 1.0)
    reach[:2] = reach[:2].max()
    ax.set(xlim=middle[0] + reach[0] * np.array([-1, 1]), ylim=middle[1] + reach[1] * np.array([-1, 1]))
    ax.set_zlim(middle[2] - reach[2], middle[2] + reach[2])
    ax.set_box_aspect(tuple(reach), zoom=0.85 * float(np.linalg.norm(reach) / reach.max()))
    ax.view_init(elev=8, azim=-62)
    ax.set_axis_off()


def upright(truth: FloatArray, skeleton: Skeleton) -> FloatArray:
    """A rotation of the axes, (D, D), that puts the axis from the feet to the head upwards.

    Of what has neither, the axis from the root (the first joint without a parent) to the middle of the others; of two
    coordinates the second, which only is turned over.
    """
    known, d = np.asarray(np.isfinite(truth).all(axis=1)), truth.shape[1]
    at = {key: k for k, key in enumerate(joint_keys(skeleton.joints)) if known[k]}
    top = next((at[name] for name in ("Head", "Neck/Nose", "Thorax") if name in at), None)
    low = [at[name] for name in ("LFoot", "RFoot", "LKnee", "RKnee", "Hip") if name in at][:2]
    roots = [k for k, parent in enumerate(skeleton.parents) if parent < 0 and known[k]]
    if top is not None and low:
        upwards = truth[top] - truth[low].mean(axis=0)
    elif top is None and len(roots) == 1 and skeleton.bones:
        upwards = truth[known].mean(axis=0) - truth[roots[0]]
    else:
        return np.diag([1.0, -1.0]) if d == 2 else np.eye(d)  # as in images, where the second axis points down
    axis = 1 if d == 2 else int(np.abs(upwards).argmax())
    sign = float(np.sign(upwards[axis])) or 1.0
    if d == 2:
        return np.diag([1.0, sign])
    turn = np.zeros((3, 3))
    first, second = ((axis + 1) % 3, (axis + 2) % 3)
    turn[first, 0], turn[second, 1], turn[axis, 2] = 1.0, sign, sign
    return turn


def upright_of_most(truth: FloatArray, skeleton: Skeleton) -> FloatArray:
    """Give the rotation, (D, D), that puts most of some poses (M, K, D) upright: a few may lie or stand on hands."""
    turns = [upright(pose, skeleton).tolist() for pose in truth]
    return np.array(max(turns, key=turns.count))


def frames_of(data: PoseData, text: str | None, some: int = 5) -> list[int]:
    """Give the numbers of the poses that a user names by frame id or by number; evenly spaced ones by default.

    Raises
    ------
    PoseDataError
        For a name that no pose has.
    """
    if text is None:
        total = len(data.truth)
        return sorted({total * (2 * part + 1) // (2 * some) for part in range(some)})
    numbers = {name: number for number, name in enumerate(data.frame_id.tolist())}
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if word not in numbers and not (word.isdecimal() and int(word) < len(numbers)):
            raise PoseDataError(
                f"frames: {word!r} is neither a frame id nor a number below {len(numbers):,}. "
                f"The first are {first_few(list(numbers))}."
            )
    return [numbers[word] if word in numbers else int(word) for word in words]


def draw_poses(
    data: PoseData, frames: Sequence[int], *, cloud: str | None = None, most: int = 50, columns: int = 5
) -> Figure:
    """Draw some poses with their hypotheses, side by side, without a display.

    Parameters
    ----------
    data : PoseData
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

    at = None if cloud is None else find_joint(cloud, data.joints)
    cloud = cloud if at is None else data.joints[at]
    projection = "3d" if data.shape[3] == 3 else None
    across = min(columns, len(frames))
    down = -(-len(frames) // across)
    wide, tall, side, below = 1.7, 2.25, 2.2, 0.25  # of a picture, of its square axes and of the words, inches
    width, height = wide * across, tall * down + below
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        for number, frame in enumerate(frames):
            row, column = divmod(number, across)
            left, bottom = wide * (column + 0.5) - side / 2, height - tall * (row + 1)
            corner = (left / width, bottom / height, side / width, side / height)
            ax = figure.add_axes(corner, projection=projection)
            ax.patch.set_visible(False)
            hypotheses, truth = data.hypotheses.read(frame, frame + 1)[:, 0], data.truth[frame]
            if data.root is not None:  # as they are evaluated
                hypotheses, truth = hypotheses - origin(hypotheses, data.root), truth - origin(truth, data.root)
            poses(hypotheses, truth, data.joints, cloud=cloud, most=most, ax=ax, parents=data.parents)
            figure.text(
                wide * (column + 0.5) / width,
                (bottom + tall - 0.03) / height,
                printable(str(data.frame_id[frame])),
                ha="center",
                va="top",
                fontsize=7,
            )
        words = f"blue: truth · grey: {min(most, data.shape[0])} of {data.shape[0]} hypotheses"
        words += f" · pink: {printable(cloud)}" if cloud else ""
        figure.text(0.12 / width, 0.3 * below / height, words, fontsize=6.5, color="#444444")
    return figure
