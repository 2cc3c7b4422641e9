"""Synthetic people in mm with hypotheses about them, and plain NumPy formulas for their right values."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import JOINT_SETS, Skeleton

Array = npt.NDArray[Any]

JOINTS = list(JOINT_SETS["h36m-17"])
"""Names of the joints, the root first."""

HIPS = [JOINTS.index("RHip"), JOINTS.index("LHip")]


def people(random: np.random.Generator, M: int, rest: Array | None = None, jitter: float = 60.0) -> Array:
    """Poses (M, K, 3) about a rest pose, each turned about the vertical axis; the first joint does not jitter."""
    rest = np.asarray(Skeleton(tuple(JOINTS)).rest_pose if rest is None else rest, dtype=np.float64)
    angle = random.uniform(0, 2 * np.pi, M)
    poses = rest + random.normal(0, jitter, (M, *rest.shape))
    poses[:, 0] = rest[0]
    turned = poses.copy()
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned[..., 0] = cos * poses[..., 0] - sin * poses[..., 1]
    turned[..., 1] = sin * poses[..., 0] + cos * poses[..., 1]
    return turned


def about(random: np.random.Generator, truth: Array, N: int, spread: float = 40.0, bias: float = 25.0) -> Array:
    """Hypotheses (N, M, K, D) about a biased truth."""
    centre = truth + random.normal(0, bias, truth.shape)
    return np.asarray(centre + random.normal(0, spread, (N, *truth.shape)))


def relative(poses: Array, root: int | list[int] = 0) -> Array:
    """Poses relative to a joint, or to the midpoint of several."""
    roots = [root] if isinstance(root, int) else root
    return np.asarray(poses - poses[..., roots, :].mean(axis=-2, keepdims=True))


def errors(hypotheses: Array, truth: Array, root: int | list[int] | None = 0) -> Array:
    """Distances (N, M, K) of joints, relative to the root unless it is None."""
    if root is not None:
        hypotheses, truth = relative(hypotheses, root), relative(truth, root)
    return np.asarray(np.linalg.norm(hypotheses - truth, axis=-1))


def aligned_errors(hypotheses: Array, truth: Array) -> Array:
    """Distances (N, M, K) after the best similarity transform of each hypothesis."""
    found = np.empty(hypotheses.shape[:-1])
    for n, m in np.ndindex(*hypotheses.shape[:2]):
        x, y = hypotheses[n, m], truth[m]
        x0, y0 = x - x.mean(axis=0), y - y.mean(axis=0)
        left, sizes, right = np.linalg.svd(x0.T @ y0)
        sign = np.ones(len(sizes))
        sign[-1] = np.sign(np.linalg.det(left @ right))
        rotation, scale = left @ np.diag(sign) @ right, (sizes * sign).sum() / (x0**2).sum()
        found[n, m] = np.linalg.norm(scale * x0 @ rotation - y0, axis=-1)
    return found


def best_and_mean(distances: Array) -> dict[str, float]:
    """Right values of minMPJPE and MPJPE, of distances (N, M, K)."""
    of_poses = distances.mean(axis=-1)
    return {"min_mpjpe": float(of_poses.min(axis=0).mean()), "mpjpe": float(of_poses.mean())}
