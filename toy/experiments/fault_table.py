"""What does the paper's ECE miss, and which test or score sees it? Every named fault against the whole battery."""

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
from toy.progress import bar

__all__ = ["COLUMNS", "LEVEL", "Found", "evaluate_faults", "fault_table"]

LEVEL = 1e-3
"""p-values, each by itself, below this count as seen."""

COLUMNS = ("ece", "ece_mean", *(test.name for test in RANK_TESTS))
"""The columns: calibration errors, each mean |ω(q) − q|."""


@dataclass(frozen=True)
class Found:
    """What posecal says of one fault.

    Attributes
    ----------
    report : Report
        With the battery and the energy score.
    least_energy : float
        Energy score of sampling from the truth's own law, mm.
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
) -> dict[str, Found]:
    """Evaluate every named fault in the world of independent joints, or where they move together.

    Parameters
    ----------
    seed : int
        Where draws start; every fault has the same truths.
    N : int
        Hypotheses.
    M : int
        Independent poses.
    joints : str
        One of posecal's joint sets.
    joint_correlation : float
        Between the deviations of any two joints from the posterior mean, 0 to below 1.
    faults : sequence of str
        Some of them, by name; all by default.

    Returns
    -------
    dict
        What was found, by the fault's name.

    Raises
    ------
    PoseDataError
        Where joints are to move together and there are no more poses than hypotheses.

    Notes
    -----
    Differs from the published code: not in it.
    """
    if joint_correlation and M <= N:
        raise PoseDataError(
            f"M = {M} poses and N = {N} hypotheses; expected more poses, which ignored-image draws from."
        )
    world, correlation = PoseWorld.independent_joints(joints), joint_correlation or None
    found = {}
    for fault in bar([FAULTS[name] for name in faults], "faults"):
        rng = np.random.default_rng(seed)
        scene = world.draw(rng, sequences=M, frames=1, hidden=0)
        case = Case.of(world, scene, rng, joint_correlation=correlation)
        hypotheses, truth = fault.apply(case, N)
        labels = {"sequence": np.arange(M).astype(np.str_)}
        pairs = PoseData(hypotheses, truth, axes="NMKD", unit="mm", joints=world.joints, labels=labels)
        totals = evaluate(pairs, metrics=[*COLUMNS, "energy_score"]).totals
        deviations = (truth - case.posterior.mean).reshape(M, -1)  # of one law in this world, whatever the pose
        found[fault.name] = Found(Report(totals), float(pdist(deviations).mean() / 2))
    return found


def fault_table(found: dict[str, Found]) -> str:
    """Write the table of faults against tests as Markdown; bold where a test sees the fault.

    Parameters
    ----------
    found : dict
        What :func:`evaluate_faults` gives.

    Returns
    -------
    str
        Lines of Markdown.

    Notes
    -----
    Differs from the published code: not in it.
    """
    metrics = next(iter(found.values())).report.metrics
    heads = ["fault", *(metrics[name].label for name in COLUMNS), "ES ratio"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, of in found.items():
        cells = []
        for column in COLUMNS:
            cell = f"{of.report.value(column):.3f}".lstrip("0")
            cells.append(f"**{cell}**" if of.report.test(column).p < LEVEL else cell)
        ratio = of.report.value("energy_score") / of.least_energy
        lines.append(f"| `{name}` | " + " | ".join(cells) + f" | {ratio:.2f} |")
    return "\n".join(lines)
