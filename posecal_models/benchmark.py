"""How do the estimators compare on real motion? The paper's Table 1, on poses of people that none was trained on.

Every estimator gets the same images: motion capture of the test subjects, seen by four virtual cameras through the same
noisy detector. Each is sampled with several seeds, and each sample is judged by :func:`posecal.evaluate`.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

import posecal.evaluation
from posecal.engine.presets import preset
from posecal.engine.protocol import Protocol
from posecal.report.report import Report
from posecal_models.contract import Context, Estimator
from posecal_models.data.detector import Detector
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.training_set import seeded
from posecal_models.estimators import ReferenceEstimator, parameter_count
from posecal_models.sample import POSES_AT_ONCE, draw
from posecal_models.simple_baseline import SimpleBaseline

__all__ = ["HARD", "Judged", "columns", "held_out_poses", "hypotheses_of", "judge", "markdown"]

HARD = 4
"""So many hidden keypoints of 16 make a pose hard."""

columns = {
    "min_mpjpe": ("minMPJPE", "mm", 1),
    "hard_min_mpjpe": ("hard", "mm", 1),
    "ece": ("ECE", "exchangeable", 3),
    "ece_paper": ("ECE", "paper", 3),
    "ece_reference": ("ECE", "reference", 3),
    "occluded_min_mpjpe": ("occluded", "mm", 1),
    "occluded_ece": ("occluded ECE", "exchangeable", 3),
    "energy_score": ("energy score", "mm", 1),
    "n": ("N", "", 0),
    "parameters": ("parameters", "", 0),
}
"""The columns of the table: heading, unit or definition, digits."""

_DEFAULT = Protocol(joints="h36m-17", metrics="min_mpjpe, ece, ece_paper, ece_reference, energy_score")
_HARD = replace(_DEFAULT, frames="hard", metrics="min_mpjpe")
_OCCLUDED = replace(preset("cgnf-occluded").protocol, metrics="min_mpjpe, ece")
_POINT = replace(_DEFAULT, metrics="min_mpjpe")


@dataclass(frozen=True)
class Judged:
    """One row of the table.

    Attributes
    ----------
    name : str
        Of the estimator.
    values : dict of str to list of float
        A value for each sampling seed, by the names of :data:`columns`; none where a column does not apply.
    report : Report or None
        Of the first seed, with its calibration curves; None for a point estimator.
    seconds : float
        That drawing the hypotheses of one seed took.
    """

    name: str
    values: dict[str, list[float]]
    report: Report | None
    seconds: float


def held_out_poses(
    path: str | Path, subjects: Sequence[str], *, every: int = 16, views: int = 4, seed: int = 0
) -> LiftingSet:
    """Give the images that the estimators are judged on.

    Parameters
    ----------
    path : str or Path
        Motion capture, see :class:`posecal_models.data.mocap.MocapPoses`.
    subjects : sequence of str
        Those that no estimator was trained on.
    every, views, seed : int
        Frames, cameras, and the seed of cameras and detector.

    Returns
    -------
    LiftingSet
        With detected keypoints.
    """
    seen = MocapPoses(path).seen_by_cameras(subjects=subjects, every=every, views=views, seed=seed)
    return Detector().seen(seen, seed=seed)


@torch.inference_mode()
def hypotheses_of(
    estimator: Estimator, data: LiftingSet, n: int, *, seed: int = 0, progress: Callable[[int], None] | None = None
) -> npt.NDArray[np.float32]:
    """Draw hypotheses of every pose.

    Parameters
    ----------
    estimator : Estimator
        Ours or somebody else's.
    data : LiftingSet
        M images, in any order of joints.
    n : int
        N.
    seed : int
        Of what is drawn.
    progress : callable, optional
        Is told how many poses are done.

    Returns
    -------
    ndarray
        (N, M, K, 3), mm, in the estimator's order of joints.
    """
    ordered = data.in_order_of(estimator.joints, estimator.keypoints)
    parts = []
    for start in range(0, len(ordered), POSES_AT_ONCE):
        some = ordered.take(slice(start, start + POSES_AT_ONCE))
        context = Context(
            torch.from_numpy(some.keypoints), torch.from_numpy(some.observed), torch.from_numpy(some.sigma)
        )
        generator = seeded("cpu", seed, start // POSES_AT_ONCE)
        parts.append(draw(estimator(context), n, generator=generator).float().numpy())
        if progress is not None:
            progress(min(start + POSES_AT_ONCE, len(ordered)))
    return np.concatenate(parts, axis=1)


def judge(
    name: str,
    estimator: ReferenceEstimator,
    data: LiftingSet,
    *,
    n: int = 200,
    seeds: Sequence[int] = (0, 1, 2),
    progress: Callable[[int], None] | None = None,
) -> Judged:
    """Fill one row of the table.

    Parameters
    ----------
    name : str
        Of the estimator.
    estimator : CGNF, SimpleBaseline or GaussianNoise
        What is judged.
    data : LiftingSet
        M images.
    n : int
        N; a point estimator has 1.
    seeds : sequence of int
        Of the draws.
    progress : callable, optional
        Is told how many poses of how many seeds are done.

    Returns
    -------
    Judged
        The row.
    """
    point = isinstance(estimator, SimpleBaseline)
    count = 1 if point else n
    ordered = data.in_order_of(estimator.joints, estimator.keypoints)
    names = (ordered.root, *ordered.joints)
    truth = np.pad(ordered.poses, ((0, 0), (1, 0), (0, 0)))
    seen = data.in_order_of(keypoint_joints=estimator.joints).observed  # of the images, whatever the estimator reads
    occluded = np.pad(~seen, ((0, 0), (1, 0)))
    hard = np.where(occluded.sum(1) >= HARD, "yes", "no")
    values: dict[str, list[float]] = {column: [] for column in columns}
    first: Report | None = None
    seconds = []
    for index, seed in enumerate(seeds[:1] if point else seeds):
        done = None if progress is None else _after(progress, index * len(data))
        start = time.perf_counter()
        drawn = hypotheses_of(estimator, data, count, seed=seed, progress=done)
        seconds.append(time.perf_counter() - start)
        held = np.pad(drawn, ((0, 0), (0, 0), (1, 0), (0, 0)))

        def report(protocol: Protocol, held: npt.NDArray[np.float32] = held) -> Report:
            return posecal.evaluation.evaluate(
                held,
                truth,
                joints=names,
                labels={"sequence": ordered.sequence, "hard": hard},
                occluded=occluded,
                protocol=protocol,
            )

        whole = report(_POINT if point else _DEFAULT)
        values["min_mpjpe"].append(whole.value("min_mpjpe"))
        values["hard_min_mpjpe"].append(report(_HARD).value("min_mpjpe"))
        some = report(replace(_OCCLUDED, metrics="min_mpjpe") if point else _OCCLUDED)
        values["occluded_min_mpjpe"].append(some.value("min_mpjpe"))
        if not point:
            first = first or whole
            for metric in ("ece", "ece_paper", "ece_reference", "energy_score"):
                values[metric].append(whole.value(metric))
            values["occluded_ece"].append(some.value("ece"))
    values["n"], values["parameters"] = [count], [parameter_count(estimator)]
    return Judged(name, values, first, statistics.mean(seconds))


def _after(progress: Callable[[int], None], before: int) -> Callable[[int], None]:
    return lambda poses: progress(before + poses)


def markdown(rows: Sequence[Judged]) -> str:
    """Write the table: mean ± standard deviation over the sampling seeds.

    Parameters
    ----------
    rows : sequence of Judged
        The estimators.

    Returns
    -------
    str
        A Markdown table.
    """
    heads = [f"{head} ({unit})" if unit else head for head, unit, _ in columns.values()]
    lines = ["| | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for row in rows:
        cells = [_cell(row.values, column, digits) for column, (_, _, digits) in columns.items()]
        lines.append(f"| {row.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(values: Mapping[str, list[float]], column: str, digits: int) -> str:
    found = values[column]
    if not found:
        return "–"
    mean = f"{statistics.mean(found):,.{digits}f}"
    return mean if len(found) < 2 else f"{mean} ± {statistics.stdev(found):.{digits + 1}f}"
