"""What are two arrays of poses? Their types, their precision, and what is checked before anything is measured."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from posecal.errors import PoseDataError

__all__ = ["BoolArray", "FloatArray", "checked", "squared_norms", "working_dtype"]

FloatArray = npt.NDArray[np.floating]
BoolArray = npt.NDArray[np.bool_]


def working_dtype(dtype: npt.DTypeLike) -> np.dtype[np.floating]:
    """Give the precision that hypotheses of a dtype are measured in: single stays single, all else is double."""
    dtype = np.dtype(dtype)
    return np.dtype(np.float32 if dtype.kind == "f" and dtype.itemsize <= 4 else np.float64)


def squared_norms(vectors: FloatArray) -> FloatArray:
    """Squared lengths of vectors that lie along the last axis but one, (..., D, n) to (..., n)."""
    found: FloatArray = np.einsum("...dn,...dn->...n", vectors, vectors)
    return found


def checked(
    hypotheses: npt.ArrayLike, truth: npt.ArrayLike, where: npt.ArrayLike | None = None
) -> tuple[FloatArray, FloatArray, BoolArray | None]:
    """Check two arrays in the paper's layout, and the mask.

    Parameters
    ----------
    hypotheses : array (N, M, K, D)
        Hypotheses.
    truth : array (M, K, D)
        True poses.
    where : bool array (M, K), optional
        The joints that count.

    Returns
    -------
    tuple
        The three as arrays.

    Raises
    ------
    PoseDataError
        Where a dtype or a shape is wrong; shapes are named with the letters that they break.
    """
    arrays = [_real(hypotheses, "hypotheses"), _real(truth, "truth")]
    x, y = arrays
    shapes = f"hypotheses {x.shape} and truth {y.shape}"
    expected = "expected (N, M, K, D) and (M, K, D)"
    if x.ndim == 3 and y.ndim == 4:
        raise PoseDataError(f"{shapes}: {expected}. The two look swapped.")
    if x.ndim != 4 or y.ndim != 3:
        raise PoseDataError(f"{shapes}: {expected}.")
    wrong = [
        f"{letter} is {ours} and {theirs}"
        for letter, ours, theirs in zip("MKD", x.shape[1:], y.shape, strict=True)
        if ours != theirs
    ]
    if wrong:
        raise PoseDataError(f"{shapes}: {expected}, but {', '.join(wrong)}.")
    if 0 in x.shape:
        empty = [letter for letter, size in zip("NMKD", x.shape, strict=True) if size == 0]
        raise PoseDataError(f"{shapes}: {', '.join(empty)} is 0; expected at least one of each.")
    if where is None:
        return x, y, None
    mask = np.asarray(where)
    if mask.dtype != bool or mask.shape != y.shape[:2]:
        raise PoseDataError(
            f"where: {mask.dtype} {mask.shape}; expected bool (M, K) = {y.shape[:2]}, True where a joint counts."
        )
    return x, y, mask


def _real(array: npt.ArrayLike, name: str) -> FloatArray:
    found = np.asanyarray(array)
    if found.dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: dtype {found.dtype}; expected real numbers such as float32.")
    return found if found.dtype.kind == "f" else found.astype(np.float64)
