"""Reading of hypotheses without a truth, as maps are applied to."""

from __future__ import annotations

import numpy as np

from posecal.data.checks import TINY, metres_message, pose_size
from posecal.data.declarations import Declarations, joint_names, named_call, quantity_of, refuse_other_names, resolve
from posecal.data.degenerate import column_problem
from posecal.data.layout import HYPOTHESES, Layout
from posecal.data.match import Names, empty_problem, numbered
from posecal.data.members import read_members
from posecal.data.root import AnyRoot, choose_root
from posecal.data.stored_poses import ArrayHypotheses, StoredPoses, sample_rows
from posecal.errors import PosecalError, PoseDataError, attempt, option, raise_all

_FRAMES = 16
"""How many are looked at."""


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
        For a layout, a unit or names that don't fit, an undeclared layout where N = M or nothing of the file has the
        length M, columns that are no coordinates, and undeclared units that look like metres.
    """
    declared = declarations or Declarations()
    axes = resolve(poses, "axes", poses.axes, declared.axes)
    layout = named_call(poses, Layout, axes or HYPOTHESES, HYPOTHESES)
    n, m, k, d = named_call(poses, layout.shape, poses.array.shape)
    problems: list[str | PosecalError] = [empty_problem(poses)] if 0 in poses.array.shape else []
    unit, factor = attempt(problems, quantity_of, poses, "unit", declared.unit) or ("mm", 1.0)
    attempt(problems, refuse_other_names, declared, poses)
    joints = joint_names(poses, k, declared, problems) or numbered(k)
    labels, frames = read_members(poses, (m, k), problems).labels, poses.frame_id
    if frames is not None and len(frames) != m:
        problems.append(f"{poses.name}: frame_id has {len(frames):,} values for {m:,} poses; expected one each.")
    raise_all(problems)
    is_told = any(poses.labels[name].ndim for name in labels) or bool(poses.marks)
    is_told = is_told or frames is not None or poses.valid is not None
    if axes is None and (n == m or not is_told):
        options = " or ".join(option("axes", text) for text in (HYPOTHESES, "MNKD"))
        raise PoseDataError(
            f"{poses.name} {poses.array.shape}: expected (N, M, K, D) or (M, N, K, D), which its shape does not tell "
            f"apart without a truth. Pass {options}."
        )
    hypotheses = ArrayHypotheses(poses.array, layout, np.arange(m), np.arange(k), factor, n)
    rows = sample_rows(m, _FRAMES)
    if problem := column_problem(poses.name, layout.read(poses.array, rows), "axes", layout.text):
        raise PoseDataError(problem)
    size = pose_size(hypotheses.select(rows).read(0, len(rows))[:12].reshape(-1, k, d))
    if unit == "mm" and poses.unit is None is declared.unit and 0 < size < TINY:
        advice = f"Pass {option('unit', 'm')}, or store unit in the file; {option('unit', 'mm')} if it is right."
        raise PoseDataError(f"{metres_message(poses.name, size)} {advice}")
    return hypotheses, joints, choose_root(declared.root_joint, joints, hypotheses.read(0, 1)[0])[0]
