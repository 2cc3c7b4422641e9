"""Arrays, tensors and lists as NumPy arrays, and the checks of single arguments."""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from posecal.errors import PosecalError, PoseDataError, attempt, did_you_mean, first_few, raise_all

FloatArray = npt.NDArray[np.floating]
BoolArray = npt.NDArray[np.bool_]

LABEL_KINDS = "USbiu"
"""Kinds of arrays that can be labels: text, bytes, yes/no, whole numbers."""


def working_dtype(dtype: npt.DTypeLike) -> np.dtype[np.floating]:
    """Give the precision that hypotheses of a dtype are measured in: single stays single, all else is double."""
    dtype = np.dtype(dtype)
    return np.dtype(np.float32 if dtype.kind == "f" and dtype.itemsize <= 4 else np.float64)


def squared_norms(vectors: FloatArray) -> FloatArray:
    """Squared lengths of vectors that lie along the last axis but one, (..., D, n) to (..., n)."""
    squares: FloatArray = np.einsum("...dn,...dn->...n", vectors, vectors)
    return squares


# --- conversion -----------------------------------------------------------------------------------------------


def as_array(values: object, name: str) -> npt.NDArray[Any]:
    """Convert arrays and tensors of any library, and lists of them, into a NumPy array.

    Parameters
    ----------
    values : array_like
        NumPy, PyTorch (on any device, with or without gradients), JAX, or anything that NumPy or DLPack reads. Numbers
        of fewer than 32 bits that NumPy lacks, such as bfloat16, become single precision.
    name : str
        What messages call it.

    Returns
    -------
    array
        A view where one is possible.

    Raises
    ------
    PoseDataError
        For lists of unequal lengths, arrays with masked numbers, and what can't be read.
    """
    try:
        array = np.asarray(_in_memory(values))
        if array.dtype.name == "bfloat16" or array.dtype.name.startswith("float8"):
            array = array.astype(np.float32)
    except (ValueError, TypeError, RuntimeError, BufferError) as error:
        if isinstance(values, (list, tuple)) and isinstance(error, ValueError):
            raise PoseDataError(
                f"{name}: lists of unequal lengths; expected an array. Pad the shorter ones, and mask the padding."
            ) from None
        reason = next(iter(str(error).splitlines()), "")
        raise PoseDataError(
            f"{name}: a {type(values).__name__} that can't be read ({reason}); expected an array."
        ) from None
    if np.ma.is_masked(values):
        raise PoseDataError(f"{name}: masked numbers; expected an array without. Mask joints with where.")
    return array


def _in_memory(values: Any) -> Any:
    """Give tensors as arrays in memory, without importing the libraries that they are of."""
    if isinstance(values, (list, tuple)):
        return [_in_memory(entry) for entry in values]
    if hasattr(values, "detach"):  # PyTorch
        tensor = values.detach().cpu().resolve_neg()
        return (tensor.float() if tensor.is_floating_point() and tensor.element_size() < 4 else tensor).numpy()
    if hasattr(values, "__dlpack__") and not hasattr(values, "__array__"):
        return np.from_dlpack(values)
    return values


def real_array(values: object, name: str) -> npt.NDArray[Any]:
    """Convert anything that :func:`as_array` does into an array of real numbers.

    Raises
    ------
    PoseDataError
        Where it holds something else.
    """
    array = as_array(values, name)
    if array.dtype.kind not in "fiu":
        what = f"dtype {array.dtype}" if array.ndim else type(values).__name__
        raise PoseDataError(f"{name}: {what}; expected real numbers such as float32.")
    return array


def as_text(array: npt.NDArray[Any], name: str) -> npt.NDArray[np.str_]:
    """Write text, bytes, yes/no and numbers as text.

    Raises
    ------
    PoseDataError
        For bytes that are not UTF-8.
    """
    if array.dtype.kind == "S":
        try:
            return np.char.decode(array.astype(np.bytes_), "utf-8")
        except UnicodeDecodeError as error:
            raise PoseDataError(f"{name}: {error}. Save text, not bytes of another encoding.") from None
    if array.dtype.kind == "b":
        return np.where(array, "yes", "no")
    return array.astype(np.str_)


def as_labels(values: object, name: str, *, or_one: bool = False, or_clips: bool = False) -> npt.NDArray[np.str_]:
    """Convert a label of every pose, of every frame of clips (C, T), or one for all poses, into text.

    Raises
    ------
    PoseDataError
        Where it is not one word, number or yes/no per pose.
    """
    array = as_array(values, name)
    if array.dtype.kind in "OT" and all(isinstance(value, str) for value in array.flat):
        array = array.astype(np.str_)
    is_shaped = array.ndim == 1 or (or_one and array.ndim == 0) or (or_clips and array.ndim == 2)
    if not is_shaped or array.dtype.kind not in LABEL_KINDS:
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected one word or whole number per pose, (M,).")
    return as_text(array, name)


def as_label_arrays(labels: object, name: str) -> dict[str, npt.NDArray[np.str_]]:
    """Convert labels by name, each of every pose, of every frame of clips or one for all poses, into text.

    Raises
    ------
    PoseDataError
        Where some are something else, all at once.
    """
    if not isinstance(labels, Mapping):
        what = f"{name}: {type(labels).__name__}"
        raise PoseDataError(f"{what}; expected a mapping of names, such as sequence, to values.")
    problems: list[str | PosecalError] = []
    convert = partial(as_labels, or_one=True, or_clips=True)
    arrays = {str(key): attempt(problems, convert, labels[key], str(key)) for key in labels}
    raise_all(problems)
    return {key: array for key, array in arrays.items() if array is not None}


def as_marks(values: object, name: str) -> BoolArray:
    """Convert a mask: yes/no, or numbers of which each is 0 or 1.

    Raises
    ------
    PoseDataError
        Where it holds something else.
    """
    array = as_array(values, name)
    if array.dtype.kind in "fiu" and ((array == 0) | (array == 1)).all():
        array = array == 1
    if array.dtype.kind != "b":
        found = f", values {first_few(np.unique(array).tolist())}" if array.dtype.kind in "fiu" else ""
        raise PoseDataError(f"{name}: dtype {array.dtype}{found}; expected bool (M, K), or numbers 0 and 1.")
    return cast(BoolArray, array)


def as_scores(values: object, name: str) -> FloatArray:
    """Convert the score of every hypothesis into double precision.

    Raises
    ------
    PoseDataError
        Where one is not a real number.
    """
    array = real_array(values, name)
    unknown = int(np.isnan(array).sum())
    if unknown:
        raise PoseDataError(f"{name}: {unknown:,} of {array.size:,} are NaN; expected numbers (N, M).")
    return array.astype(np.float64)


# --- checks ---------------------------------------------------------------------------------------------------


def checked_mask(values: object, shape: tuple[int, ...], name: str = "where") -> BoolArray:
    """Check a mask of joints, (M, K), or of poses, (M,); give it as one of joints.

    Raises
    ------
    PoseDataError
        Where it is no mask, or of another shape.
    """
    array = as_array(values, name)
    is_mask = array.dtype.kind in "bfiu" and ((array == 0) | (array == 1)).all()
    if not is_mask or array.shape not in {shape, shape[:1]}:
        raise PoseDataError(
            f"{name}: {array.dtype} {array.shape}; expected bool (M, K) = {shape} or (M,), True where a joint counts."
        )
    marks = as_marks(array, name)
    return marks if array.ndim == 2 else np.repeat(marks[:, None], shape[1], axis=1)


def checked_index(value: Any, name: str, size: int, of: str) -> int:
    """Check the index of one of so many, which may be counted from the end; give it counted from 0.

    Raises
    ------
    PoseDataError
        For anything else.
    """
    try:
        index = size if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        index = size
    if not -size <= index < size:
        raise PoseDataError(f"{name}: {value!r}; expected the index of one of {size} {of}.")
    return index % size


def checked_root(root: object, n_joints: int) -> int | None:
    """Check the joint to subtract from every pose, None for none.

    Raises
    ------
    PoseDataError
        Where it is not the index of a joint.
    """
    return None if root is None else checked_index(root, "root", n_joints, "joints")


def checked_number(value: object, name: str, valid: Callable[[float], bool], expected: str) -> float:
    """Check a real number.

    Raises
    ------
    PoseDataError
        Where it is none, or not valid.
    """
    array = as_array(value, name)
    if array.ndim or array.dtype.kind not in "fiu" or not valid(float(array)):
        raise PoseDataError(f"{name}: {value!r}; expected {expected}.")
    return float(array)


def checked_choice(value: object, name: str, known: Collection[str]) -> str:
    """Check one of some words.

    Raises
    ------
    PoseDataError
        For another word, or something else.
    """
    if not isinstance(value, str) or value not in known:
        raise PoseDataError(f"{name}: {value!r} is not known. {did_you_mean(str(value), known)}")
    return value
