"""In which axes and units are they? What a file declares, what the user says, and what the shapes forbid."""

from __future__ import annotations

from posecal.data.layout import HYPOTHESES, TRUTH, Layout, plausible_layouts
from posecal.data.pose_data import StoredPoses
from posecal.data.units import millimetres_per
from posecal.errors import PoseDataError

__all__ = ["declared", "layouts", "unit_factor"]


def layouts(
    hypotheses: StoredPoses, truth: StoredPoses, axes: str | None, truth_axes: str | None
) -> tuple[Layout, Layout]:
    """Settle the layouts of the two.

    Parameters
    ----------
    hypotheses, truth : Poses
        As stored or passed.
    axes, truth_axes : str or None
        What the user says of arrays that declare nothing.

    Returns
    -------
    tuple of two Layouts
        Those of the hypotheses and of the truth, which fit their shapes.

    Raises
    ------
    PoseDataError
        For shapes that don't fit, or that fit several layouts of which none is declared.
    """
    x, y = hypotheses.array.shape, truth.array.shape
    own = declared(hypotheses, "axes", hypotheses.axes, axes)
    true_own = declared(truth, "truth-axes", truth.axes, truth_axes)
    both = f"{hypotheses.name} {x} and {truth.name} {y}: expected (N, M, K, D) and (M, K, D)"
    layout = _named(hypotheses, own or HYPOTHESES, HYPOTHESES)
    true_layout = _named(truth, true_own or _truth_beside(layout, y), TRUTH)
    if len(x) == len(true_layout.groups) != len(layout.groups) == len(y):
        raise PoseDataError(f"{both}. The two look swapped.")
    if len(y) != len(true_layout.groups):
        raise PoseDataError(f"{both}. Declare another layout of {truth.name} with --truth-axes.")
    if len(x) != len(layout.groups):
        raise PoseDataError(f"{both}. Declare another layout of {hypotheses.name} with --axes.")
    true_shape = _sizes(truth, true_layout)
    if true_own is None and true_shape[1] == 3 != true_shape[2]:
        raise PoseDataError(f"{both}, coordinates last. Pass --truth-axes MDK.")
    if own is not None:
        _sizes(hypotheses, layout)
        if true_own is None and true_shape[1] == true_shape[2] and layout.without("N", "I") == "MDK":
            raise PoseDataError(f"{both}, but K = D = 3 tells no layout. Pass --truth-axes MKD or --truth-axes MDK.")
        return layout, true_layout
    fitting = plausible_layouts(x, true_shape)
    if len(fitting) > 1:
        raise PoseDataError(
            f"{both}, but the shapes don't tell which axis is the hypotheses (N = M = {x[0]}). "
            f"Pass --axes {' or --axes '.join(fitting)}."
        )
    if fitting and fitting != [HYPOTHESES]:
        raise PoseDataError(f"{both}. The shapes fit --axes {fitting[0]}.")
    return layout, true_layout


def _truth_beside(layout: Layout, y: tuple[int, ...]) -> str:
    """Give the layout of a truth that declares none: the paper's, or the hypotheses' where only that fits."""
    beside = layout.without("N", "I")
    if len(y) != len(Layout(beside, TRUTH).groups):
        return TRUTH
    return TRUTH if len(y) == 3 and y[2] == layout.coordinates else beside


def _named(poses: StoredPoses, text: str, core: str) -> Layout:
    try:
        return Layout(text, core)
    except PoseDataError as error:
        raise PoseDataError(f"{poses.name}: {error}") from None


def _sizes(poses: StoredPoses, layout: Layout) -> tuple[int, ...]:
    try:
        return layout.shape(poses.array.shape)
    except PoseDataError as error:
        raise PoseDataError(f"{poses.name}: {error}") from None


def declared(poses: StoredPoses, flag: str, stored: str | None, said: str | None) -> str | None:
    """Give what a file declares or the user says, which must not differ.

    Raises
    ------
    PoseDataError
        Where they differ.
    """
    if stored is not None and said is not None and stored != said:
        raise PoseDataError(f"{poses.name} declares {stored!r} itself, and --{flag} says {said!r}. Drop the flag.")
    return said if stored is None else stored


def unit_factor(poses: StoredPoses, flag: str, said: str | None, problems: list[str]) -> float:
    """Give the millimetres in one unit of some poses; what is wrong is added to the problems."""
    try:
        return millimetres_per(declared(poses, flag, poses.unit, said) or "mm")
    except PoseDataError as error:
        message = str(error)
        problems.append(message if message.startswith(poses.name) else f"{poses.name}: {message}")
        return 1.0
