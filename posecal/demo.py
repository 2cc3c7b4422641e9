"""A demonstration: a synthetic world with known distributions, and three samplers that differ in their spread.

A Gaussian world of poses on the Human3.6M skeleton: each joint is its parent plus a bone with Gaussian error, the
error larger in depth and for joints that are not seen. The truth is one draw around a frame's mean pose, correlated
in time as in video; a calibrated sampler draws its hypotheses from the same law, an overconfident one with half the
spread, an underconfident one with one and a half times as much.
"""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.data.write import write_file, write_members
from posecal.errors import PoseFileError, for_command_line
from posecal.evaluation import evaluate
from posecal.report.format import short_number
from posecal.report.html import write_html
from posecal.report.report import Report
from posecal.report.sheet import Sheet, Table

SAMPLERS = {"calibrated": 1.0, "overconfident": 0.5, "underconfident": 1.5}
"""The spread of each sampler, relative to the true one."""

SHOWN = ("min_mpjpe", "mpjpe", "ece", "signed_area", "coverage_90", "radius_50")
"""The metrics by which the samplers are compared."""

ACTIONS = {"standing": 0.7, "walking": 1.0, "sitting": 1.3}
"""How uncertain the poses of an action are, relative to walking."""


@dataclass(frozen=True)
class World:
    """M poses of which the law is known: jointly Gaussian about a mean, given the frame.

    Attributes
    ----------
    mean : array (M, K, 3)
        Mean of each frame, mm.
    spread : array (M, K, 3)
        Standard deviation of each bone's error, mm; errors add up from the root to the hands and feet.
    truth : array (M, K, 3)
        One pose of each frame, mm.
    skeleton : Skeleton
        The joints.
    sequence, action : arrays of str (M,)
        Labels.
    occluded : bool array (M, K)
        The joints that are not seen; their errors are doubled.
    """

    mean: FloatArray
    spread: FloatArray
    truth: FloatArray
    skeleton: Skeleton
    sequence: npt.NDArray[np.str_]
    action: npt.NDArray[np.str_]
    occluded: npt.NDArray[np.bool_]


def _along_the_tree(errors: FloatArray, skeleton: Skeleton) -> FloatArray:
    """Add each bone's error to those of the bones that lead to it, in place."""
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            errors[..., joint, :] += errors[..., parent, :]
    return errors


def _smooth_noise(random: np.random.Generator, frames: int, shape: tuple[int, ...], memory: float) -> FloatArray:
    """Standard normal noise that is an AR(1) process along the first axis."""
    noise = random.standard_normal((frames, *shape))
    for frame in range(1, frames):
        noise[frame] = memory * noise[frame - 1] + np.sqrt(1 - memory**2) * noise[frame]
    return noise


def make_world(sequences: int = 24, frames: int = 25, seed: int = 0) -> World:
    """Draw the poses of the demonstration.

    Parameters
    ----------
    sequences : int
        How many sequences.
    frames : int
        Frames in each.
    seed : int
        Of the generator.

    Returns
    -------
    World
        M = sequences × frames poses.

    Examples
    --------
    >>> make_world(sequences=3, frames=2).truth.shape
    (6, 17, 3)
    """
    random = np.random.default_rng(seed)
    skeleton = Skeleton(JOINT_SETS["h36m-17"])
    joints, names = len(skeleton.joints), list(ACTIONS)
    mean, spread, truth = (np.empty((sequences, frames, joints, 3)) for _ in range(3))
    occluded = np.empty((sequences, frames, joints), dtype=bool)
    for s in range(sequences):
        motion = _along_the_tree(40 * _smooth_noise(random, frames, (joints, 3), 0.98), skeleton)
        turn = random.uniform(0, 2 * np.pi)
        around = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        pose = (skeleton.rest_pose + motion) @ around.T
        mean[s] = pose - pose[:, :1]
        occluded[s] = random.random(joints) < 0.12
        occluded[s, :, 0] = False
        spread[s] = np.array([14.0, 28.0, 14.0]) * ACTIONS[names[s % len(names)]]
        spread[s][occluded[s]] *= 2
        spread[s, :, 0] = 0
        truth[s] = mean[s] + _along_the_tree(spread[s] * _smooth_noise(random, frames, (joints, 3), 0.8), skeleton)
    number = np.repeat(np.arange(sequences), frames)
    return World(
        mean=mean.reshape(-1, joints, 3),
        spread=spread.reshape(-1, joints, 3),
        truth=truth.reshape(-1, joints, 3),
        skeleton=skeleton,
        sequence=np.array([f"sequence {s:02d}" for s in number]),
        action=np.array(names)[number % len(names)],
        occluded=occluded.reshape(-1, joints),
    )


def sample(world: World, n_hypotheses: int = 200, spread: float = 1.0, seed: int = 1) -> npt.NDArray[np.float32]:
    """Draw hypotheses from the law of each frame, with its spread times a factor.

    Parameters
    ----------
    world : World
        M poses.
    n_hypotheses : int
        N.
    spread : float
        1 for a calibrated sampler.
    seed : int
        Of the generator.

    Returns
    -------
    array (N, M, K, 3)
        Hypotheses, mm.

    Examples
    --------
    >>> sample(make_world(sequences=3, frames=2), n_hypotheses=5).shape
    (5, 6, 17, 3)
    """
    random = np.random.default_rng(seed)
    hypotheses = np.empty((n_hypotheses, *world.mean.shape), dtype=np.float32)
    for hypothesis in hypotheses:
        errors = spread * world.spread * random.standard_normal(world.mean.shape)
        hypothesis[...] = world.mean + _along_the_tree(errors, world.skeleton)
    return hypotheses


def write_demo(folder: Path, world: World | None = None, n_hypotheses: int = 200) -> Iterator[Path]:
    """Write the truth and the hypotheses of each sampler, as a user would.

    Parameters
    ----------
    folder : Path
        An existing folder.
    world : World, optional
        The poses.
    n_hypotheses : int
        N.

    Yields
    ------
    Path
        Each file, once it is written: ``gt.npz``, then one per sampler.

    Raises
    ------
    PoseFileError
        Where a file can't be written.
    """
    world = world or make_world()
    frames = np.array([f"{name}/{number}" for number, name in enumerate(world.sequence)])
    common = {"unit": np.array("mm"), "joints": np.array(world.skeleton.joints), "frame_id": frames}

    def write(name: str, **members: npt.NDArray[np.generic]) -> Path:
        write_file(folder / name, lambda file: write_members(file, {**members, **common}))
        return folder / name

    labels = {"sequence": world.sequence, "action": world.action, "occluded": world.occluded}
    yield write("gt.npz", truth=world.truth.astype(np.float32), axes=np.array("MKD"), **labels)
    for name, spread in SAMPLERS.items():
        yield write(f"{name}.npz", hypotheses=sample(world, n_hypotheses, spread), axes=np.array("NMKD"))


def run_demo(folder: Path, write_line: Callable[[str], object], *, width: int = 120, colour: bool = False) -> None:
    """Write the demonstration, evaluate each sampler as a user would, and point out what to notice.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    write_line : callable
        Takes each line.
    width, colour : int and bool
        Columns of the terminal, and whether to use its colours.

    Raises
    ------
    PoseFileError
        Where the folder or a file can't be written.
    """
    from posecal.plot import draw, save

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PoseFileError(f"{folder}: can't be made ({error.strerror}).") from None
    world = make_world()
    write_line(
        f"A world where the truth is known: M = {len(world.truth)} poses, and N = 200 hypotheses from each of three\n"
        "samplers that know the mean of every pose exactly and differ in nothing but their spread.\n"
        "These commands evaluate them:\n"
    )
    files = {path.stem: path for path in write_demo(folder, world)}
    reports = {}
    write_line(f"  cd {shlex.quote(str(folder))}")
    for name in SAMPLERS:
        outputs = f"--plot {name}.png --html {name}.html --save {name}-result.npz"
        write_line(f"  {_program()} evaluate {name}.npz gt.npz {outputs}")
        report = reports[name] = evaluate(files[name], files["gt"])
        save(draw(report, title=f"{name} sampler"), folder / f"{name}.png")
        write_html(report, folder / f"{name}.html", f"{name} sampler")
        report.save(folder / f"{name}-result.npz")
    figure = draw(reports, panels=True, size=(8.6, 3.3))
    for ax, (name, report) in zip(figure.axes, reports.items(), strict=True):
        ax.set_title(f"{name}\nminMPJPE {report['min_mpjpe']:.1f} mm, ECE {report['ece']:.3f}", fontsize="medium")
    save(figure, folder / "samplers.svg")
    write_line(f"\n{reports['calibrated'].render(width=width, colour=colour, words=for_command_line)}\n")
    write_line(_summary_of(reports).text(width=width, colour=colour))
    write_line(f"\nIn {folder}: the files, a page (.html), a reliability diagram (.png) and a result for each sampler.")


def _program() -> str:
    """Name the program as a shell runs it here, where posecal is not on its path too."""
    return "posecal" if shutil.which("posecal") else f"{shlex.quote(sys.executable)} -m posecal"


def _summary_of(reports: Mapping[str, Report]) -> Sheet:
    """Say what to notice about the three samplers."""
    metrics = [reports["calibrated"].metrics[name] for name in SHOWN]
    rows = [
        (name, *(f"{short_number(report[m.name], m.unit)} {m.unit}".rstrip() for m in metrics))
        for name, report in reports.items()
    ]
    best = min(reports, key=lambda name: reports[name]["min_mpjpe"])
    notice = (
        f"the {best} sampler has the best minMPJPE. A benchmark that ranks by minMPJPE prefers a model whose 90 % "
        f"balls hold {100 * reports[best]['coverage_90']:.0f} % of the truths."
    )
    return Sheet(
        "That was the calibrated sampler. All three, and what posecal says of them",
        sentences=[f"{name}: {report.summary[0]}" for name, report in reports.items()],
        tables=[Table("Samplers", ["sampler", *(metric.label for metric in metrics)], rows)],
        definitions=[("Notice", notice)],
    )
