"""The pose world: files of perfect and faulty samplers, and properties of the exact posterior."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.calibration import calibration_curve
from posecal.data.joint_names import joint_keys
from posecal.data.skeleton import Skeleton
from posecal.metrics import min_mpjpe
from toy import pose_figures
from toy.experiments.result import Result
from toy.faults import Case, Fault
from toy.pose_files import make_folder, write_case
from toy.pose_world import PoseWorld
from toy.posterior import Posterior
from toy.progress import progress_bar
from toy.table import check, table

__all__ = ["run"]

Floats = npt.NDArray[np.float32]


def run(
    world: PoseWorld,
    faults: Sequence[Fault],
    data: Path,
    *,
    seed: int = 0,
    N: int = 200,
    sequences: int = 40,
    frames: int = 25,
    correlation: float = 0.0,
    hidden: float = 0.3,
) -> Result:
    """Write the files of each fault, and plot poses of the last.

    Parameters
    ----------
    world : PoseWorld
        The world.
    faults : sequence of Fault
        The faults; all have the same truths.
    data : Path
        The folder for ``hyps.npz`` and ``gt.npz``, or, with several faults, for a folder for each.
    seed : int
        Random seed.
    N : int
        Number of hypotheses.
    sequences, frames, correlation, hidden
        As in :meth:`toy.pose_world.PoseWorld.draw`.

    Returns
    -------
    Result
        Properties of the exact posterior, and of the written files.
    """
    if len(faults) > 1:
        make_folder(data)

    def case() -> Case:
        rng = np.random.default_rng(seed)
        scene = world.draw(rng, sequences=sequences, frames=frames, correlation=correlation, hidden=hidden)
        return Case.of(world, scene, rng)

    exact = case()
    all_observed = np.asarray(exact.scene.observed.all(axis=1))
    masks = (("every keypoint", all_observed), ("some hidden", ~all_observed))
    kinds = {name: mask for name, mask in masks if mask.any()}
    root = Skeleton(world.joints).root
    rows: list[list[str | float]] = []
    poses: list[tuple[str, Floats, Floats]] = []
    for fault in progress_bar(faults, "hypotheses"):
        folder = data / fault.name if len(faults) > 1 else data
        hypotheses, truth = write_case(folder, case(), fault, N)
        curve = calibration_curve(hypotheses, truth, root=root)
        best = float(min_mpjpe(hypotheses, truth).mean())
        rows.append([str(folder), curve.ece(), curve.ece("mean"), best, fault.description])
        poses = [(name, hypotheses[:, m], truth[m]) for name, mask in kinds.items() for m in [mask.argmax()]]

    text = [
        _spreads(exact.posterior, kinds),
        _density(exact),
        _best_of(exact, N),
        table(
            f"wrote hyps.npz (N = {N}) and gt.npz; ECE (exchangeable) of the median joint, and mean over joints",
            ["", "ECE", "mean", "minMPJPE, mm", "fault"],
            rows,
        ),
    ]
    names = joint_keys(world.joints)
    joint = names.index("RWrist") if "RWrist" in names else len(names) - 1
    bones = [(parent, child) for child, parent in enumerate(world.parents)]
    return Result("\n".join(text), pose_figures.people(poses, bones, joint, world.joints[joint]))


def _spreads(posterior: Posterior, kinds: dict[str, npt.NDArray[np.bool_]]) -> str:
    variance = np.diagonal(posterior.joint_covariance, axis1=-2, axis2=-1)[posterior.pattern]
    return table(
        "standard deviation of a joint given the keypoints, mm",
        ["", "poses", "x", "y", "depth"],
        [
            [name, str(mask.sum()), *(float(sd) for sd in np.sqrt(variance[mask].mean(axis=(0, 1))))]
            for name, mask in kinds.items()
        ],
    )


def _density(case: Case) -> str:
    density = case.posterior.log_prob(case.scene.truth)
    error = float(density.std(ddof=1) / np.sqrt(len(density)))
    entropy = float(case.posterior.entropy.mean())
    return check("NLL of the truth, nats per pose in mm", entropy, (-float(density.mean()), error))


def _best_of(case: Case, N: int) -> str:
    best, error = case.posterior.expected_min_mpjpe(N, case.rng)
    return f"minMPJPE of {N} exact hypotheses, from other draws: {best:.2f} ± {error:.2f} mm"
