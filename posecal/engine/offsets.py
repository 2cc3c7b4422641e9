"""Hypotheses minus the truth, and true poses, relative to the root."""

from __future__ import annotations

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray, working_dtype
from posecal.data.degenerate import is_outside
from posecal.data.root import AnyRoot, Root, origin, root_joints


def offsets_from_truth(hypotheses: FloatArray, truth: FloatArray, root: AnyRoot) -> FloatArray:
    """Subtract the truth, (N, B, K, D) minus (B, K, D), root-relative where a root is given, as (B, K, D, N)."""
    dtype = working_dtype(hypotheses.dtype)
    offsets = np.empty((*truth.shape, len(hypotheses)), dtype=dtype)
    with np.errstate(invalid="ignore", over="ignore"):  # joints that don't count may hold anything
        # Subtract in the order of the input: hypotheses a power of two apart would push each other out of the cache.
        offsets[...] = np.subtract(hypotheses, truth.astype(dtype, copy=False), dtype=dtype).transpose(1, 2, 3, 0)
        if root is not None and (isinstance(root, Root) or offsets[:, root].any()):
            offsets -= origin(offsets, root, axis=1)
    return offsets


def relative_to_root(truth: FloatArray, root: AnyRoot, dtype: np.dtype[np.floating]) -> FloatArray:
    """Give true poses relative to the root, if there is one, in the precision of the offsets."""
    with np.errstate(invalid="ignore", over="ignore"):
        wide = truth.astype(working_dtype(truth.dtype), copy=False)
        return (wide if root is None else wide - origin(wide, root)).astype(dtype)


def far_roots(hypotheses: FloatArray, where: BoolArray, root: AnyRoot) -> BoolArray:
    """Find the poses and joints, (B, K), at which the root of a hypothesis, (N, B, K, D), is NaN or too far away.

    A hypothesis that is far away as a whole, such as one of a fill value, is near relative to its root, and takes the
    precision of what is computed beside it.
    """
    found = np.zeros_like(where)
    for joint in root_joints(root):
        wide = hypotheses[:, :, joint].astype(working_dtype(hypotheses.dtype), copy=False)
        found[:, joint] = is_outside(wide).any(axis=(0, 2)) & where[:, joint]
    return found
