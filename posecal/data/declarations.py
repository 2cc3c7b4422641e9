"""What users declare about poses that don't declare it themselves: axes, units, joints, frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from numbers import Integral
from typing import Any, Literal, TypeVar

from posecal.data.arrays import checked_choice
from posecal.data.joint_names import distinguished, joint_keys, repeated_names
from posecal.data.layout import HYPOTHESES, TRUTH, Layout, plausible_layouts
from posecal.data.own_skeleton import OwnSkeleton, as_skeleton, checked_parents
from posecal.data.skeleton import joint_set
from posecal.data.stored_poses import StoredPoses
from posecal.data.units import quantity
from posecal.errors import PosecalError, PoseDataError, attempt, first_few, option, raise_all

T = TypeVar("T")


@dataclass(frozen=True)
class Declarations:
    """What the user declares about hypotheses and truth.

    Attributes
    ----------
    axes, truth_axes : str or None
        Layouts of arrays that don't declare theirs. The truth's is (M, K, D) by default, or follows from the
        hypotheses' where only that fits.
    unit, truth_unit : str, float or None
        Units of arrays that don't declare theirs; ``unit`` is for both unless ``truth_unit`` is given.
    joints : str, sequence of str or None
        Names of joints that have none, or a joint set.
    root_joint : str, int or None
        What to subtract: a joint, a midpoint, one for each part, or ``none``; see :mod:`posecal.data.root`.
    missing : str
        ``error``, ``skip`` to score the frames that both have, or ``part`` where the hypotheses are of some frames
        of the truth.
    shared_joints : str
        ``same``, or ``common`` to score the joints that both have.
    n_hypotheses : int or None
        How many hypotheses are read, the first ones; all by default.
    skeleton : path, str, mapping or None
        Names, parents and root of the joints; see :func:`posecal.data.own_skeleton.as_skeleton`.

    Raises
    ------
    PoseDataError
        For a layout, a unit or a joint set that can't be, whatever the data; all at once.
    """

    axes: str | None = None
    truth_axes: str | None = None
    unit: str | float | None = None
    truth_unit: str | float | None = None
    joints: Sequence[str] | None = None
    root_joint: str | int | None = None
    missing: Literal["error", "skip", "part"] = "error"
    shared_joints: Literal["same", "common"] = "same"
    n_hypotheses: int | None = None
    skeleton: Any = None

    def __post_init__(self) -> None:
        checks: tuple[tuple[object, Callable[[Any], object]], ...] = (
            (self.axes, lambda text: Layout(text, HYPOTHESES)),
            (self.truth_axes, lambda text: Layout(text, TRUTH)),
            (self.unit, quantity),
            (self.truth_unit, quantity),
            (self.joints, _joint_names),
            (self.root_joint, _root_joint),
            (self.skeleton, as_skeleton),
            (self.missing, lambda text: checked_choice(text, "missing", ("error", "skip", "part"))),
            (self.shared_joints, lambda text: checked_choice(text, option("shared_joints"), ("same", "common"))),
        )
        problems: list[str | PosecalError] = []
        for value, check in checks:
            if value is not None:
                attempt(problems, check, value)
        raise_all(problems)

    @property
    def joint_names(self) -> tuple[str, ...] | None:
        """The names in ``joints``, or else of the skeleton."""
        if self.joints is None:
            return None if self.skeleton is None else as_skeleton(self.skeleton).names
        return _joint_names(self.joints)

    def skeleton_of(
        self, names: tuple[str, ...], *stored: tuple[str, Sequence[int | str] | None]
    ) -> OwnSkeleton | None:
        """Give the user's own skeleton of some joints: as declared, or the first that is stored with a file's name."""
        if self.skeleton is not None:
            return as_skeleton(self.skeleton).of(names)
        name, parents = next((pair for pair in stored if pair[1] is not None), ("", None))
        return None if parents is None else OwnSkeleton(names, checked_parents(parents, name, names))


def _joint_names(joints: object) -> tuple[str, ...]:
    if isinstance(joints, str):
        return joint_set(joints)
    if not isinstance(joints, Iterable) or not all(isinstance(name, str) for name in joints):
        raise PoseDataError(f"joints: {joints!r}; expected K names, or a joint set such as h36m-17.")
    return tuple(map(str, joints))


def _root_joint(root: object) -> None:
    if isinstance(root, bool) or not isinstance(root, (str, Integral)):
        raise PoseDataError(f"{option('root_joint')}: {root!r}; expected a name, an index, or none.")


def choose_layouts(
    hypotheses: StoredPoses, truth: StoredPoses, axes: str | None, truth_axes: str | None
) -> tuple[Layout, Layout]:
    """Choose the layouts of hypotheses and truth: as declared, or the paper's where nothing else fits.

    Parameters
    ----------
    hypotheses, truth : StoredPoses
        As stored or passed.
    axes, truth_axes : str or None
        What the user declares.

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
    own = resolve(hypotheses, "axes", hypotheses.axes, axes)
    if own is None and len(x) == len(y) == 3 and x[1:] == y[1:] and truth_axes is None is truth.axes:
        own = TRUTH  # of the truth's own shape: one prediction of each pose
    true_own = resolve(truth, "truth_axes", truth.axes, truth_axes)
    both = f"{hypotheses.name} {x} and {truth.name} {y}: expected (N, M, K, D) and (M, K, D)"
    layout = named_call(hypotheses, Layout, own or HYPOTHESES, HYPOTHESES)
    true_layout = named_call(truth, Layout, true_own or _default_truth(layout, y), TRUTH)
    if len(x) == len(true_layout.groups) != len(layout.groups) == len(y):
        raise PoseDataError(f"{both}. The two look swapped.")
    if len(y) != len(true_layout.groups):
        raise PoseDataError(f"{both}. Declare another layout of {truth.name} with {option('truth_axes')}.")
    if len(x) != len(layout.groups):
        raise PoseDataError(f"{both}. Declare another layout of {hypotheses.name} with {option('axes')}.")
    true_shape = named_call(truth, true_layout.shape, y)
    if own is None and true_own is None and true_shape[1] == 3 != true_shape[2] > 1:
        raise PoseDataError(f"{both}, coordinates last. Pass {option('truth_axes', 'MDK')}.")
    if own is not None:
        named_call(hypotheses, layout.shape, x)
        if true_own is None and true_shape[1] == true_shape[2] and layout.without("N", "I") == "MDK":
            options = " or ".join(option("truth_axes", text) for text in ("MKD", "MDK"))
            raise PoseDataError(f"{both}, but the shapes don't tell the axes apart (K = D = 3). Pass {options}.")
        return layout, true_layout
    fitting = plausible_layouts(x, true_shape)
    refuse_ambiguous(both, x, fitting)
    if fitting not in ([], [HYPOTHESES]):
        raise PoseDataError(f"{both}. The shapes fit {option('axes', fitting[0])}.")
    return layout, true_layout


def refuse_ambiguous(which: str, shape: tuple[int, ...], fitting: Sequence[str]) -> None:
    """Refuse hypotheses of a shape that several layouts fit.

    Raises
    ------
    PoseDataError
        With the lengths that are equal, and the layouts.
    """
    if len(fitting) > 1:
        sizes = Layout(fitting[0], HYPOTHESES).sizes(shape)
        pairs = ((a, b) for a, b in combinations(HYPOTHESES, 2) if sizes[a] == sizes[b] > 1)
        equal = ", ".join(f"{a} = {b} = {sizes[a]}" for a, b in pairs)
        options = " or ".join(option("axes", text) for text in fitting)
        raise PoseDataError(f"{which}, but the shapes don't tell the axes apart ({equal}). Pass {options}.")


def _default_truth(layout: Layout, shape: tuple[int, ...]) -> str:
    """Give the layout of a truth that declares none: the paper's, or the hypotheses' where only that fits."""
    same = layout.without("N", "I")
    if len(shape) != len(Layout(same, TRUTH).groups):
        return TRUTH
    return TRUTH if len(shape) == 3 and shape[2] == layout.coordinates else same


def resolve(poses: StoredPoses, name: str, stored: str | None, declared: object) -> str | None:
    """Give what poses declare themselves, or else what the user does; the two must not differ.

    Raises
    ------
    PoseDataError
        Where they differ.
    """
    if stored is not None and declared is not None and stored != str(declared):
        raise PoseDataError(
            f"{poses.name} declares {stored!r} itself; expected no {option(name, declared)}. Leave it out."
        )
    return stored if declared is None else str(declared)


def quantity_of(poses: StoredPoses, name: str, declared: object, otherwise: str = "mm") -> tuple[str, float]:
    """Give the unit in which poses are measured, and the factor of the stored numbers; see :func:`quantity`.

    Raises
    ------
    PoseDataError
        For a unit that is none, or two that differ.
    """
    return named_call(poses, quantity, resolve(poses, name, poses.unit, declared) or otherwise)


def joint_names(
    poses: StoredPoses, size: int, declared: Declarations, problems: list[str | PosecalError]
) -> tuple[str, ...] | None:
    """Give the names of K joints, as stored or else as declared; None where there are none."""
    names = declared.joint_names if poses.joints is None else poses.joints
    if names is None:
        return None
    if len(names) != size:
        of_set = poses.joints is None and isinstance(declared.joints, str)
        what = f"{declared.joints} has {len(names)} joints" if of_set else f"{len(names)} joints named"
        problems.append(f"{poses.name}: {what} for K = {size}; expected one name each.")
        return None
    names = distinguished(names)
    if repeated := repeated_names(names):
        problems.append(f"{poses.name} names joints more than once: {first_few(repeated)}.")
    return names


def refuse_other_names(declared: Declarations, *stored: StoredPoses) -> None:
    """Refuse names of joints for poses that all have names, of other joints.

    Raises
    ------
    PoseDataError
        With the poses.
    """
    named = [poses.joints for poses in stored if poses.joints is not None]
    if declared.joints is None or len(named) < len(stored):
        return
    wanted = {*joint_keys(declared.joint_names or ())}
    if all({*joint_keys(distinguished(names))} != wanted for names in named):
        which = f"{' and '.join(poses.name for poses in stored)} {'names' if len(stored) == 1 else 'name'} joints"
        what = option("joints", declared.joints if isinstance(declared.joints, str) else None)
        raise PoseDataError(f"{which} ({first_few(named[0])}); expected no {what}. Leave it out.")


def named_call(poses: StoredPoses, function: Callable[..., T], *arguments: Any) -> T:
    """Call a function; where it refuses, name the poses.

    Raises
    ------
    PoseDataError
        What it raises, with their name.
    """
    try:
        return function(*arguments)
    except PoseDataError as error:
        raise PoseDataError(f"{poses.name}: {error.message}") from None
