"""Benchmark of estimators on held-out motion capture: the paper's Table 1.

Every estimator gets the same images: motion capture of the test subjects, projected into four virtual cameras, with the
same simulated detector. Each is sampled with several seeds, and each sample is evaluated by :func:`posecal.evaluate`.
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
from torch import nn

import posecal.evaluation
from posecal.engine.presets import preset
from posecal.engine.protocol import Protocol
from posecal.errors import printable
from posecal.report.report import Report
from posecal_models.contract import Context, Estimator
from posecal_models.data.detector import Detector
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.registry import ReferenceEstimator, parameter_count
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.sample import POSES_AT_ONCE, draw

__all__ = ["COLUMNS", "HARD", "BenchmarkRow", "draw_hypotheses", "evaluate_estimator", "held_out_poses", "markdown"]

HARD = 4
"""Hidden keypoints, of 16, from which on a pose counts as hard."""

COLUMNS = {
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
class BenchmarkRow:
    """One row of the table.

    Attributes
    ----------
    name : str
        The estimator's name.
    values : dict of str to list of float
        A value for each sampling seed, by the names of :data:`COLUMNS`; none where a column does not apply.
    report : Report or None
        Of the first seed, with its calibration curves; None for a point estimator.
    seconds : float
        Time for drawing the hypotheses of one seed.
    """

    name: str
    values: dict[str, list[float]]
    report: Report | None
    seconds: float


def held_out_poses(
    path: str | Path, subjects: Sequence[str], *, every: int = 16, views: int = 4, seed: int = 0
) -> LiftingSet:
    """Return the images that the estimators are evaluated on.

    Parameters
    ----------
    path : str or Path
        Motion capture, see :class:`posecal_models.data.mocap.MocapPoses`.
    subjects : sequence of str
        Test subjects, which no estimator was trained on.
    every, views, seed : int
        Frame step, cameras around each clip, and the seed of cameras and detector.

    Returns
    -------
    LiftingSet
        With detected keypoints.
    """
    images = MocapPoses(path).project(subjects=subjects, every=every, views=views, seed=seed)
    return Detector().detect_set(images, seed=seed)


@torch.inference_mode()
def draw_hypotheses(
    estimator: Estimator, data: LiftingSet, n: int, *, seed: int = 0, progress: Callable[[int], None] | None = None
) -> npt.NDArray[np.float32]:
    """Draw hypotheses of every pose.

    Parameters
    ----------
    estimator : Estimator
        A reference estimator, or any other.
    data : LiftingSet
        M images, in any order of joints.
    n : int
        N.
    seed : int
        Seed of the hypotheses.
    progress : callable, optional
        Called with the number of poses done.

    Returns
    -------
    ndarray
        (N, M, K, 3), mm, in the estimator's order of joints.
    """
    ordered = data.in_order_of(estimator.joints, estimator.keypoints)
    device = device_of(estimator)
    parts = []
    for start in range(0, len(ordered), POSES_AT_ONCE):
        block = ordered.take(slice(start, start + POSES_AT_ONCE))
        context = Context(
            torch.from_numpy(block.keypoints), torch.from_numpy(block.observed), torch.from_numpy(block.sigma)
        ).to(device)
        generator = seeded_generator(seed, start // POSES_AT_ONCE)
        parts.append(draw(estimator(context), n, generator=generator).float().cpu().numpy())
        if progress is not None:
            progress(min(start + POSES_AT_ONCE, len(ordered)))
    return np.concatenate(parts, axis=1)


def device_of(estimator: Estimator) -> torch.device:
    """Return the device of an estimator's parameters; the CPU, where it has none."""
    parameters = estimator.parameters() if isinstance(estimator, nn.Module) else iter(())
    return next((parameter.device for parameter in parameters), torch.device("cpu"))


def evaluate_estimator(
    name: str,
    estimator: ReferenceEstimator,
    data: LiftingSet,
    *,
    n: int = 200,
    seeds: Sequence[int] = (0, 1, 2),
    progress: Callable[[int], None] | None = None,
) -> BenchmarkRow:
    """Evaluate an estimator: one row of the table.

    Parameters
    ----------
    name : str
        The estimator's name.
    estimator : ReferenceEstimator
        The estimator to evaluate.
    data : LiftingSet
        M images.
    n : int
        N; a point estimator has 1.
    seeds : sequence of int
        Sampling seeds.
    progress : callable, optional
        Called with the number of poses done, over all seeds.

    Returns
    -------
    BenchmarkRow
        The row.
    """
    point = isinstance(estimator, SimpleBaseline)
    count = 1 if point else n
    ordered = data.in_order_of(estimator.joints, estimator.keypoints)
    names = (ordered.root, *ordered.joints)
    truth = np.pad(ordered.poses, ((0, 0), (1, 0), (0, 0)))
    observed = data.in_order_of(keypoint_joints=estimator.joints).observed  # also where the estimator reads others
    occluded = np.pad(~observed, ((0, 0), (1, 0)))
    hard = np.where(occluded.sum(1) >= HARD, "yes", "no")
    values: dict[str, list[float]] = {column: [] for column in COLUMNS}
    first: Report | None = None
    seconds = []
    for index, seed in enumerate(seeds[:1] if point else seeds):
        seed_progress = None if progress is None else _with_offset(progress, index * len(data))
        start = time.perf_counter()
        drawn = draw_hypotheses(estimator, data, count, seed=seed, progress=seed_progress)
        seconds.append(time.perf_counter() - start)
        with_root = np.pad(drawn, ((0, 0), (0, 0), (1, 0), (0, 0)))

        def evaluate(protocol: Protocol, hypotheses: npt.NDArray[np.float32] = with_root) -> Report:
            return posecal.evaluation.evaluate(
                hypotheses,
                truth,
                joints=names,
                labels={"sequence": ordered.sequence, "hard": hard},
                occluded=occluded,
                protocol=protocol,
            )

        report = evaluate(_POINT if point else _DEFAULT)
        values["min_mpjpe"].append(report.value("min_mpjpe"))
        values["hard_min_mpjpe"].append(evaluate(_HARD).value("min_mpjpe"))
        occluded_report = evaluate(replace(_OCCLUDED, metrics="min_mpjpe") if point else _OCCLUDED)
        values["occluded_min_mpjpe"].append(occluded_report.value("min_mpjpe"))
        if not point:
            first = first or report
            for metric in ("ece", "ece_paper", "ece_reference", "energy_score"):
                values[metric].append(report.value(metric))
            values["occluded_ece"].append(occluded_report.value("ece"))
    values["n"], values["parameters"] = [count], [parameter_count(estimator)]
    return BenchmarkRow(name, values, first, statistics.mean(seconds))


def _with_offset(progress: Callable[[int], None], offset: int) -> Callable[[int], None]:
    return lambda poses: progress(offset + poses)


def markdown(rows: Sequence[BenchmarkRow]) -> str:
    """Write the table: mean ± standard deviation over the sampling seeds.

    Parameters
    ----------
    rows : sequence of BenchmarkRow
        The estimators.

    Returns
    -------
    str
        A Markdown table.
    """
    heads = [f"{head} ({unit})" if unit else head for head, unit, _ in COLUMNS.values()]
    lines = ["| | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for row in rows:
        cells = [_cell(row.values, column, digits) for column, (_, _, digits) in COLUMNS.items()]
        lines.append(f"| {printable(row.name)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(values: Mapping[str, list[float]], column: str, digits: int) -> str:
    numbers = values[column]
    if not numbers:
        return "–"
    mean = f"{statistics.mean(numbers):,.{digits}f}"
    return mean if len(numbers) < 2 else f"{mean} ± {statistics.stdev(numbers):.{digits + 1}f}"
