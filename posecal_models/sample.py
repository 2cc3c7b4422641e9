"""Sampling of hypotheses into a file for ``posecal evaluate``, block by block in constant memory.

The file is an uncompressed ``.npz`` with the poses outermost, ``axes`` MNKD: the hypotheses of a block of poses are
contiguous, and the file can be memory-mapped. The root is at 0, as in a file of true poses.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np
import numpy.typing as npt
import torch
from numpy.lib import format as npy
from torch import Tensor

from posecal.data.write import write_file
from posecal.errors import PoseDataError
from posecal_models.contract import Context, Estimator, PoseDistribution
from posecal_models.data.keypoint_set import KeypointSet
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.registry import ReferenceEstimator

__all__ = ["POSES_AT_ONCE", "check_input", "draw", "sample_to_file"]

POSES_AT_ONCE = 64
"""Poses of a block. Hypotheses depend on the seed and on this number alone."""


def draw(
    distribution: PoseDistribution,
    n: int,
    *,
    generator: torch.Generator | None = None,
    temperature: float = 1.0,
    mode: bool = False,
) -> Tensor:
    """Draw hypotheses, or take the mode as the only one.

    Parameters
    ----------
    distribution : PoseDistribution
        Distributions of M poses.
    n : int
        N.
    generator : torch.Generator, optional
        The source of randomness.
    temperature : float
        Scale of the noise; 1 is the distribution itself.
    mode : bool
        Give the mode instead of samples.

    Returns
    -------
    Tensor
        (N, M, K, 3) or, for the mode, (1, M, K, 3), mm.

    Raises
    ------
    PoseDataError
        Where the distribution has no mode or no temperature.
    """
    if mode:
        if not hasattr(distribution, "mode"):
            raise PoseDataError(f"mode: a {type(distribution).__name__} has none. Draw samples.")
        pose: Tensor = distribution.mode()
        return pose[None]
    if temperature == 1:
        return distribution.sample(n, generator=generator)
    parameters = signature(distribution.sample).parameters.values()
    if not any(parameter.name == "temperature" or parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        raise PoseDataError(f"temperature: a {type(distribution).__name__} has none; expected 1.")
    return distribution.sample(n, generator=generator, temperature=temperature)  # type: ignore[call-arg]


def sample_to_file(
    estimator: Estimator,
    keypoints: KeypointSet,
    path: str | Path,
    *,
    n: int = 200,
    seed: int = 0,
    temperature: float = 1.0,
    mode: bool = False,
    root: str = "Hip",
    device: torch.device | str = "cpu",
    progress: Callable[[int], None] | None = None,
) -> None:
    """Draw hypotheses of every image and write them to a file.

    Parameters
    ----------
    estimator : Estimator
        A reference estimator, or any other.
    keypoints : KeypointSet
        M images.
    path : str or Path
        The ``.npz`` to write, atomically.
    n : int
        N hypotheses of each image.
    seed : int
        Seed of the hypotheses.
    temperature, mode
        As in :func:`draw`.
    root : str
        The joint that poses are relative to; it comes first, at 0.
    device : torch.device or str
        Device of the estimator.
    progress : callable, optional
        Called with the number of poses done.

    Raises
    ------
    PoseDataError
        Where keypoints don't fit the estimator, or hypotheses are not finite.
    PoseFileError
        Where the file can't be written.
    """
    if n < 1:
        raise PoseDataError(f"n: {n}; expected 1 or more hypotheses.")
    ordered = keypoints.in_order_of(estimator.keypoints)
    if not len(ordered):
        raise PoseDataError("keypoints: 0 images; expected 1 or more.")
    check_input(estimator, _context(ordered, slice(None), device))
    count = 1 if mode else n
    joints = (root, *estimator.joints)
    metadata = {
        "axes": np.array("MNKD"),
        "unit": np.array("mm"),
        "joints": np.array(joints),
        "frame_id": ordered.frame_id,
    }

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, array in metadata.items():
                with archive.open(f"{name}.npy", "w") as member:
                    npy.write_array(member, array, allow_pickle=False)
            with archive.open("hypotheses.npy", "w", force_zip64=True) as member:
                _write_header(member, (len(ordered), count, len(joints), 3))
                for start in range(0, len(ordered), POSES_AT_ONCE):
                    member.write(block(start).tobytes())

    @torch.inference_mode()
    def block(start: int) -> npt.NDArray[np.float32]:
        poses = slice(start, start + POSES_AT_ONCE)
        generator = seeded_generator(seed, start // POSES_AT_ONCE)
        drawn = draw(
            estimator(_context(ordered, poses, device)), n, generator=generator, temperature=temperature, mode=mode
        )
        if not drawn.isfinite().all():
            raise PoseDataError(
                f"hypotheses: {int((~drawn.isfinite()).any(-1).any(-1).sum()):,} of {drawn[..., 0, 0].numel():,} drawn "
                f"for the images from {ordered.frame_id[start]} on are not finite. "
                "Check the keypoints and the weights."
            )
        hypotheses = np.zeros((drawn.shape[1], count, len(joints), 3), np.float32)
        hypotheses[:, :, 1:] = drawn.transpose(0, 1).float().cpu().numpy()
        if progress is not None:
            progress(min(start + POSES_AT_ONCE, len(ordered)))
        return hypotheses

    write_file(path, write)


def _write_header(file: IO[bytes], shape: tuple[int, ...]) -> None:
    npy.write_array_header_2_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})


def _context(keypoints: KeypointSet, poses: slice, device: torch.device | str) -> Context:
    return Context(
        torch.from_numpy(keypoints.keypoints[poses]),
        torch.from_numpy(keypoints.observed[poses]),
        torch.from_numpy(keypoints.sigma[poses]),
    ).to(device)


def check_input(estimator: Estimator, context: Context) -> None:
    """Check keypoints against a reference estimator, before anything is sampled.

    Parameters
    ----------
    estimator : Estimator
        The estimator; only reference estimators are checked.
    context : Context
        All keypoints, in the estimator's order.

    Raises
    ------
    PoseDataError
        Where keypoints are missing that the estimator needs, or look normalised already.
    """
    if isinstance(estimator, ReferenceEstimator):
        estimator.check(context)
        estimator.standardizer.check_keypoints(context)
