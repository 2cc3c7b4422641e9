"""Table of all named faults: calibration errors, rank tests and energy score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from posecal.calibration.rank_tests import RANK_TESTS
from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from posecal.report.report import Report
from toy.faults import FAULTS, Case
from toy.pose_world import PoseWorld
from toy.progress import progress_bar

__all__ = ["COLUMNS", "LEVEL", "FaultEvaluation", "evaluate_faults", "fault_table"]

LEVEL = 1e-3
"""Significance level of each test."""

COLUMNS = ("ece", "ece_mean", *(test.name for test in RANK_TESTS))
"""The columns: calibration errors, each mean |ω(q) − q|."""


@dataclass(frozen=True)
class FaultEvaluation:
    """posecal's evaluation of one fault.

    Attributes
    ----------
    report : Report
        With the rank tests and the energy score.
    least_energy : float
        Energy score of samples from the truth's distribution, mm.
    """

    report: Report
    least_energy: float


def evaluate_faults(
    seed: int = 0,
    *,
    N: int = 100,
    M: int = 1000,
    joints: str = "h36m-16",
    joint_correlation: float = 0.0,
    faults: Sequence[str] = tuple(FAULTS),
) -> dict[str, FaultEvaluation]:
    """Evaluate named faults in the world of independent joints, or with correlated joints.

    Parameters
    ----------
    seed : int
        Random seed; every fault has the same truths.
    N : int
        Number of hypotheses.
    M : int
        Number of independent poses.
    joints : str
        One of posecal's joint sets.
    joint_correlation : float
        Correlation between the deviations of any two joints from the posterior mean, 0 to below 1.
    faults : sequence of str
        Names of the faults; all by default.

    Returns
    -------
    dict
        Evaluations by the fault's name.

    Raises
    ------
    PoseDataError
        Where joints are correlated and there are no more poses than hypotheses.

    Notes
    -----
    Differs from the published code: not in it.
    """
    if joint_correlation and M <= N:
        raise PoseDataError(
            f"M = {M} poses and N = {N} hypotheses; expected more poses, which ignored-image draws from."
        )
    world, correlation = PoseWorld.independent_joints(joints), joint_correlation or None
    evaluations = {}
    for fault in progress_bar([FAULTS[name] for name in faults], "faults"):
        rng = np.random.default_rng(seed)
        scene = world.draw(rng, sequences=M, frames=1, hidden=0)
        case = Case.of(world, scene, rng, joint_correlation=correlation)
        hypotheses, truth = fault.apply(case, N)
        labels = {"sequence": np.arange(M).astype(np.str_)}
        pairs = PoseData(
            hypotheses, truth, axes="NMKD", unit="mm", joints=world.joints, root_joint="none", labels=labels
        )
        totals = evaluate(pairs, metrics=[*COLUMNS, "energy_score"]).totals
        deviations = (truth - case.posterior.mean).reshape(M, -1)  # identically distributed for all poses
        evaluations[fault.name] = FaultEvaluation(Report(totals), float(pdist(deviations).mean() / 2))
    return evaluations


def fault_table(evaluations: dict[str, FaultEvaluation]) -> str:
    """Write the table of faults as Markdown; bold where a test is significant.

    Parameters
    ----------
    evaluations : dict
        From :func:`evaluate_faults`.

    Returns
    -------
    str
        Lines of Markdown.

    Notes
    -----
    Differs from the published code: not in it.
    """
    metrics = next(iter(evaluations.values())).report.metrics
    heads = ["fault", *(metrics[name].label for name in COLUMNS), "ES ratio"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, evaluation in evaluations.items():
        report, cells = evaluation.report, []
        for column in COLUMNS:
            cell = f"{report.value(column):.3f}".lstrip("0")
            cells.append(f"**{cell}**" if report.test(column).p < LEVEL else cell)
        ratio = report.value("energy_score") / evaluation.least_energy
        lines.append(f"| `{name}` | " + " | ".join(cells) + f" | {ratio:.2f} |")
    return "\n".join(lines)
