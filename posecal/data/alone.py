"""Reading of hypotheses without a truth, as maps are applied to."""

from __future__ import annotations

import numpy as np

from posecal.data.declarations import Declarations, joint_names, named_call, quantity_of, resolve
from posecal.data.layout import HYPOTHESES, Layout
from posecal.data.match import Names, empty_problem, numbered
from posecal.data.root import AnyRoot, choose_root
from posecal.data.stored_poses import ArrayHypotheses, StoredPoses
from posecal.errors import PosecalError, attempt, raise_all


def resolve_hypotheses(
    poses: StoredPoses, declarations: Declarations | None = None
) -> tuple[ArrayHypotheses, Names, AnyRoot]:
    """Read hypotheses without a truth.

    Parameters
    ----------
    poses : StoredPoses
        Hypotheses, as stored or passed; undeclared they are (N, M, K, D) in mm.
    declarations : Declarations, optional
        What the user declares about them.

    Returns
    -------
    hypotheses : ArrayHypotheses
        Read some poses at a time.
    joints : tuple of str
        Their joints, numbered where they have no names.
    root : int, Root or None
        What positions are relative to.

    Raises
    ------
    PoseDataError
        For a layout, a unit or names that don't fit.
    """
    declared = declarations or Declarations()
    axes = resolve(poses, "axes", poses.axes, declared.axes) or HYPOTHESES
    layout = named_call(poses, Layout, axes, HYPOTHESES)
    n, m, k, _ = named_call(poses, layout.shape, poses.array.shape)
    problems: list[str | PosecalError] = [empty_problem(poses)] if 0 in poses.array.shape else []
    _, factor = attempt(problems, quantity_of, poses, "unit", declared.unit) or ("mm", 1.0)
    joints = joint_names(poses, k, declared, problems) or numbered(k)
    raise_all(problems)
    hypotheses = ArrayHypotheses(poses.array, layout, np.arange(m), np.arange(k), factor, n)
    return hypotheses, joints, choose_root(declared.root_joint, joints, hypotheses.read(0, 1)[0])[0]
