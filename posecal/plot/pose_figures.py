"""Pictures of poses: hypotheses, the truth, and the cloud of one joint."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import find_joint, joint_keys, side_of
from posecal.data.root import origin
from posecal.data.skeleton import Skeleton
from posecal.errors import PoseDataError, did_you_mean, first_few, printable
from posecal.plot.style import OVER, UNDER, ink, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D

    from posecal.data.pose_data import PoseData

LEFT = "#56B4E9"
"""The true pose's left side; the rest of it is darker."""

VIEW = -62.0, 8.0
"""Azimuth and elevation from which a pose is seen, degrees."""

NUMBERS_AT_ONCE = 4_000_000
"""How many coordinates of hypotheses are read at once."""


def poses(
    hypotheses: FloatArray,
    truth: FloatArray,
    joints: Sequence[str],
    *,
    cloud: str | None = None,
    most: int = 50,
    ax: Any = None,
    parents: Sequence[int] = (),
    view: tuple[float, float] = VIEW,
) -> Any:
    """Draw one pose in two or three dimensions: its hypotheses, the truth, and the cloud of one joint.

    Parameters
    ----------
    hypotheses : array (N, K, D)
        Hypotheses; thin and grey.
    truth : array (K, D)
        The true pose; blue, its left side light.
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

    view : tuple of two floats
        Azimuth and elevation from which a pose in space is seen, degrees.

    Returns
    -------
    matplotlib Axes or Axes3D
        The axes, with a person upright: up is where the head is. In space it stands on a floor at the height of the
        lowest true joint.

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
        colour = LEFT if side_of(joints[bone[1]]) == "left" else UNDER
        ax.plot(*true[list(bone)].T, color=colour, lw=1.8, solid_capstyle="round", zorder=4, gid=f"truth {ends}")
    if d == 3:
        _frame(ax, true, shown, view)
    else:
        ax.set_aspect("equal")
        ax.margins(0.08)
        ax.set_axis_off()
    return ax


def _frame(ax: Axes3D, true: FloatArray, shown: FloatArray, view: tuple[float, float]) -> None:
    """Look at a pose, as large as it fits, with its floor; of the hypotheses a few far points may stick out."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    ends = np.nanquantile(shown.reshape(-1, 3), [0.01, 0.99], axis=0)
    low, high = np.fmin(ends[0], np.nanmin(true, axis=0)), np.fmax(ends[1], np.nanmax(true, axis=0))
    middle, reach = (low + high) / 2, np.maximum(0.52 * (high - low), 1.0)
    reach[:2] = reach[:2].max()
    (west, south, bottom), (east, north, top) = middle - reach, middle + reach
    ax.set(xlim=(west, east), ylim=(south, north))
    ax.set_zlim(bottom, top)
    z = float(np.nanmin(true[:, 2]))
    (west, south), (east, north) = middle[:2] - 0.7 * reach[:2], middle[:2] + 0.7 * reach[:2]
    corners = [(west, south, z), (east, south, z), (east, north, z), (west, north, z)]
    floor = Poly3DCollection([corners], facecolor=ink(), edgecolor="none", alpha=0.08, zorder=0)
    floor.set_gid("floor")
    ax.computed_zorder = False
    ax.add_collection3d(floor)
    ax.set_box_aspect(tuple(reach), zoom=0.85 * float(np.linalg.norm(reach) / reach.max()))
    ax.view_init(elev=view[1], azim=view[0])
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


def frames_of(data: PoseData, text: str | None = None, some: int = 5) -> list[int]:
    """Give the numbers of the poses that a user names.

    Parameters
    ----------
    data : PoseData
        Hypotheses and truth.
    text : str, optional
        Frame ids or numbers with commas; ``even`` for evenly spaced ones; ``worst``, the default, for those of the
        largest error of the best hypothesis, of every sequence one before any has two.
    some : int
        How many evenly spaced or worst ones there are.

    Returns
    -------
    list of int
        From 0; the worst first.

    Raises
    ------
    PoseDataError
        For a name that no pose has.
    """
    numbers = {name: number for number, name in enumerate(data.frame_id.tolist())}
    total = len(data.truth)
    if text == "even":
        return sorted({total * (2 * part + 1) // (2 * some) for part in range(some)})
    if text is None or (text == "worst" and text not in numbers):
        order = np.argsort(-np.nan_to_num(_best_errors(data, range(total)), nan=-1.0), kind="stable")
        labels = data.labels.get("sequence")
        _, worst = np.unique(order if labels is None else labels[order], return_index=True)
        first = np.isin(np.arange(total), worst)
        return [*map(int, order[first]), *map(int, order[~first])][:some]
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if word not in numbers and not (word.isdecimal() and int(word) < len(numbers)):
            raise PoseDataError(
                f"frames: {word!r} is neither a frame id nor a number below {len(numbers):,}. "
                f"The first are {first_few(list(numbers))}."
            )
    return [numbers[word] if word in numbers else int(word) for word in words]


def _as_evaluated(data: PoseData, start: int, stop: int) -> tuple[FloatArray, FloatArray]:
    """Some poses relative to the root: hypotheses (N, m, K, D), truth (m, K, D)."""
    hypotheses, truth = data.hypotheses.read(start, stop), data.truth[start:stop]
    if data.root is not None:
        with np.errstate(invalid="ignore"):  # of joints that are not finite, which are not drawn
            hypotheses, truth = hypotheses - origin(hypotheses, data.root), truth - origin(truth, data.root)
    return hypotheses, truth


def _best_errors(data: PoseData, frames: Sequence[int]) -> FloatArray:
    """The mean distance of the joints of the best hypothesis of each pose; NaN where no joint counts."""
    n, _, k, d = data.shape
    step = max(1, NUMBERS_AT_ONCE // (n * k * d)) if isinstance(frames, range) else 1
    errors = []
    for frame in frames[::step]:
        rows = slice(frame, min(frame + step, len(data.truth)))
        x, y = _as_evaluated(data, rows.start, rows.stop)
        distances = np.sqrt(((x - y) ** 2).sum(axis=-1))
        counted = np.isfinite(distances) & (True if data.where is None else data.where[rows])
        sums = np.where(counted, distances, 0).sum(axis=-1)
        means = np.divide(sums, counted.sum(axis=-1), out=np.full(sums.shape, np.inf), where=counted.any(axis=-1))
        errors.append(means.min(axis=0))
    found = np.concatenate(errors)
    return np.where(np.isfinite(found), found, np.nan)


def draw_poses(
    data: PoseData,
    frames: Sequence[int],
    *,
    cloud: str | None = None,
    most: int = 50,
    columns: int = 5,
    view: tuple[float, float] = VIEW,
    title: str | None = None,
    size: tuple[float, float] | None = None,
    style: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw some poses with their hypotheses, side by side, without a display.

    Parameters
    ----------
    data : PoseData
        Hypotheses and truth.
    frames : sequence of int
        The numbers of the poses.
    cloud, most, view
        As for :func:`poses`.
    columns : int
        Pictures in a row.
    title, size, style
        As for :func:`posecal.plot.draw`.

    Returns
    -------
    matplotlib Figure
        Ready to be saved. Above each pose stand its frame id and the error of its best hypothesis: the mean distance
        of its joints, relative to the root.

    Raises
    ------
    PoseDataError
        For a joint that the poses don't have, and for a size or style that is none.
    """
    at = None if cloud is None else find_joint(cloud, data.joints)
    cloud = cloud if at is None else data.joints[at]
    is_space = data.shape[3] == 3
    across = min(columns, len(frames))
    down = -(-len(frames) // across)
    above, below, words = 0.3 * bool(title), 0.25, 0.32  # of the title, the legend, and the words over each pose
    width, height = size or (1.7 * across, 2.35 * down + above + below)
    wide, tall = width / across, (height - above - below) / down
    side = min(1.3 * wide, 1.12 * (tall - words)) if is_space else min(wide, tall - words)  # axes have empty margins
    errors = _best_errors(data, frames)
    with new_figure((width, height), style, title, layout="none") as figure:
        for number, (frame, error) in enumerate(zip(frames, errors, strict=True)):
            row, column = divmod(number, across)
            middle, top = wide * (column + 0.5), height - above - tall * row
            bottom = top - words - (tall - words + side) / 2
            corner = ((middle - side / 2) / width, bottom / height, side / width, side / height)
            ax = figure.add_axes(corner, projection="3d" if is_space else None)
            ax.patch.set_visible(False)
            hypotheses, truth = _as_evaluated(data, frame, frame + 1)
            poses(
                hypotheses[:, 0], truth[0], data.joints, cloud=cloud, most=most, ax=ax, parents=data.parents, view=view
            )
            said = "" if np.isnan(error) else f"{error:.3g} {data.unit or ''}".rstrip()
            name = f"{printable(str(data.frame_id[frame]))}\n{said}"
            figure.text(middle / width, (top - 0.03) / height, name, ha="center", va="top", fontsize="small")
        drawn = f"{min(most, data.shape[0])} of {data.shape[0]}"
        legend = f"truth: blue, its left side light · hypotheses: grey, {drawn}"
        legend += f" · {printable(cloud)}: pink" if cloud else ""
        figure.text(0.12 / width, 0.3 * below / height, legend, fontsize="x-small")
        seen = f", from azimuth {view[0]:g}° and elevation {view[1]:g}°, over the floor of the lowest true joint"
        figure.set_label(
            f"Frames {', '.join(str(data.frame_id[frame]) for frame in frames)}{seen if is_space else ''}; {legend}. "
            f"Over each pose: the error of the best of its N={data.shape[0]} hypotheses, the mean distance of joints "
            f"{'as given' if data.root is None else 'relative to the root'}."
        )
    return figure
