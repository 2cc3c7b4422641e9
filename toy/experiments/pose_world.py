"""Which poses does the oracle world hold, and what do perfect and faulty samplers say of them?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.calibration import calibration_curve
from posecal.data.skeleton import Skeleton, canonical_name
from posecal.metrics import min_mpjpe
from toy import body_pictures
from toy.experiments.result import Result
from toy.faults import Case, Fault
from toy.pose_files import make_folder, write_case
from toy.pose_world import PoseWorld
from toy.posterior import Posterior
from toy.progress import bar
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
    """Write the files of each fault, and draw poses of the last.

    Parameters
    ----------
    world : PoseWorld
        Where poses are drawn.
    faults : sequence of Fault
        What is wrong; every fault has the same truths.
    data : Path
        The folder for ``hyps.npz`` and ``gt.npz``, or, with several faults, for a folder for each.
    seed : int
        Where draws start.
    N : int
        Hypotheses.
    sequences, frames, correlation, hidden
        As in :meth:`toy.pose_world.PoseWorld.draw`.

    Returns
    -------
    Result
        What the exact posterior is like, and what was written.
    """
    if len(faults) > 1:
        make_folder(data)

    def case() -> Case:
        rng = np.random.default_rng(seed)
        scene = world.draw(rng, sequences=sequences, frames=frames, correlation=correlation, hidden=hidden)
        return Case.of(world, scene, rng)

    exact = case()
    every = np.asarray(exact.scene.observed.all(axis=1))
    kinds = {name: chosen for name, chosen in (("every keypoint", every), ("some hidden", ~every)) if chosen.any()}
    root = Skeleton(world.joints).root
    written: list[list[str | float]] = []
    poses: list[tuple[str, Floats, Floats]] = []
    for fault in bar(faults, "hypotheses"):
        folder = data / fault.name if len(faults) > 1 else data
        hypotheses, truth = write_case(folder, case(), fault, N)
        curve = calibration_curve(hypotheses, truth, root=root)
        best = float(min_mpjpe(hypotheses, truth).mean())
        written.append([str(folder), curve.ece(), curve.ece("mean"), best, fault.says])
        poses = [(name, hypotheses[:, m], truth[m]) for name, chosen in kinds.items() for m in [chosen.argmax()]]

    text = [
        _spreads(exact.posterior, kinds),
        _density(exact),
        _best_of(exact, N),
        table(
            f"wrote hyps.npz (N = {N}) and gt.npz; ECE (exchangeable) of the median joint, and mean over joints",
            ["", "ECE", "mean", "minMPJPE, mm", "what is wrong"],
            written,
        ),
    ]
    names = [canonical_name(name) for name in world.joints]
    joint = names.index("RWrist") if "RWrist" in names else len(names) - 1
    bones = [(parent, child) for child, parent in enumerate(world.parents)]
    return Result("\n".join(text), body_pictures.people(poses, bones, joint, world.joints[joint]))


def _spreads(posterior: Posterior, kinds: dict[str, npt.NDArray[np.bool_]]) -> str:
    variance = np.diagonal(posterior.joint_covariance, axis1=-2, axis2=-1)[posterior.pattern]
    return table(
        "standard deviation of a joint given the keypoints, mm",
        ["", "poses", "x", "y", "depth"],
        [
            [name, str(chosen.sum()), *(float(sd) for sd in np.sqrt(variance[chosen].mean(axis=(0, 1))))]
            for name, chosen in kinds.items()
        ],
    )


def _density(case: Case) -> str:
    density = case.posterior.log_prob(case.scene.truth)
    error = float(density.std(ddof=1) / np.sqrt(len(density)))
    entropy = float(case.posterior.entropy.mean())
    return check("NLL of the truth, nats per pose in mm", entropy, (-float(density.mean()), error))


def _best_of(case: Case, N: int) -> str:
    best, error = case.posterior.expected_min_mpjpe(N, case.rng)
    return f"minMPJPE of {N} exact hypotheses, of other draws: {best:.2f} ± {error:.2f} mm"
