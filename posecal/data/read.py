"""Reading of poses, from ``.npz`` and ``.npy`` files or from arrays, with everything that is declared about them."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Callable, Mapping
from io import FileIO
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from posecal.data import log_density as density
from posecal.data.archive import Header, Member, open_archive
from posecal.data.arrays import LABEL_KINDS, as_labels, as_marks, as_scores, as_text, checked_choice, real_array
from posecal.data.draws import STATED, DrawnHypotheses, is_stated, open_distributions
from posecal.data.file_array import Source, open_array, open_member, opened
from posecal.data.fitted_poses import as_fitted_hashes
from posecal.data.gaussian import GaussianPrediction
from posecal.data.layout import HYPOTHESES, MemoryArray
from posecal.data.lazy import (
    LIBRARIES,
    DatasetArray,
    DeviceArray,
    is_dataset,
    is_large_on_device,
    open_datasets,
    split_address,
)
from posecal.data.remote import is_address, local_copy
from posecal.data.stored_poses import COMMON_LABELS, StoredPoses
from posecal.data.weights import as_weights
from posecal.errors import PosecalError, PoseDataError, PoseFileError, attempt, raise_all, refuse_unreadable

T = TypeVar("T")
Role = Literal["hypotheses", "truth"]

_NAMES: dict[Role, tuple[str, ...]] = {"hypotheses": ("hypotheses", "hyps"), "truth": ("truth", "gt")}
_ALWAYS_READ = 1000
"""Values of a member that are read whatever there are of coordinates, so that messages can say what they are."""

_MARKS = ("occluded", "visible")
_OF_HYPOTHESES = ("scores", "weights", "recalibrated_on", *density.MEMBERS)
_RESERVED = (*_MARKS, *_OF_HYPOTHESES, "axes", "unit", "joints", "frame_id", "fps", "valid", "parents", "observed")
DECLARED = frozenset((*_RESERVED, *COMMON_LABELS))
"""Names under which something beside the coordinates is read, whatever its kind."""


def read_poses(source: npt.ArrayLike | str | os.PathLike[str] | GaussianPrediction, role: Role) -> StoredPoses:
    """Open a file of hypotheses or of true poses; arrays are taken as they are.

    Parameters
    ----------
    source : path, array_like or GaussianPrediction
        An ``.npz`` or ``.npy`` file, the coordinates, or what hypotheses are drawn from.
    role : str
        ``hypotheses`` or ``truth``: which array is looked for, and what messages call one that was passed.

    Returns
    -------
    StoredPoses
        The coordinates, in the file, and everything that it declares.

    Raises
    ------
    PoseFileError
        For files that can't be read: missing, a folder, empty, cut off, of another kind.
    PoseDataError
        For files that lack the array, or whose members have the wrong type, and for what is no array of numbers.

    Notes
    -----
    Differs from the published code: none.
    """
    checked_choice(role, "role", _NAMES)
    if is_dataset(source):
        return StoredPoses(role, DatasetArray(source))
    if is_large_on_device(source):
        return StoredPoses(role, DeviceArray(source, role))
    if isinstance(source, GaussianPrediction):
        return StoredPoses(role, DrawnHypotheses(source), HYPOTHESES)
    if not isinstance(source, (str, os.PathLike)):
        return StoredPoses(role, MemoryArray(real_array(source, role)))
    if is_address(source):
        with local_copy(os.fspath(source)) as copy:
            return read_poses(copy, role)  # the file stays open, and is gone with it
    path, dataset = split_address(os.fspath(source))
    if path.suffix.lower() in LIBRARIES and path.exists():
        return _read_datasets(path, dataset, role)
    with opened(path) as file:
        start = file.read(6)
        if not start:
            raise PoseFileError(f"{path.name}: empty file; expected an .npz or .npy file.")
        if start == b"\x93NUMPY":
            return StoredPoses(path.name, open_array(file, 0, path.name, Source.of(path, file)))
        if not start.startswith(b"PK"):
            is_pickle = start.startswith(b"\x80")
            raise PoseFileError(_foreign(path, "looks like a pickle" if is_pickle else _kind_of(path, start)))
        return _read_archive(file, path, role)


_OTHER_KINDS = {b"\x89HDF": "is an HDF5 file", b"MATLAB": "is a MATLAB file", b"{": "is JSON", b"[": "is JSON"}
_OTHER_ENDINGS = {".csv": "is a table of text", ".trc": "is a table of text", ".c3d": "is a C3D file"}


def _kind_of(path: Path, start: bytes) -> str:
    """Say what another file is, by its first bytes or its ending."""
    known = next((words for magic, words in _OTHER_KINDS.items() if start.startswith(magic)), "")
    return known or _OTHER_ENDINGS.get(path.suffix.lower(), "is neither an .npz nor an .npy file")


def _foreign(path: Path, what: str) -> str:
    """Write the message about the file of another tool."""
    return (
        f"{path.name} {what}; expected numpy.savez or numpy.save. posecal never unpickles. posecal convert makes one "
        "of CSV, TRC, C3D, JSON, .mat, HDF5, .pt and .pkl."
    )


def _read_archive(file: FileIO, path: Path, role: Role) -> StoredPoses:
    """Read the members of an ``.npz`` file, but for the coordinates, and close it unless those lie in it."""
    stored, name = open_archive(file, path.name), path.name
    if not stored and any(member.endswith("data.pkl") for member in zipfile.ZipFile(file).namelist()):
        raise PoseFileError(_foreign(path, "is a file of PyTorch"))
    headers = {key: member.header for key, member in stored.items()}
    if role == "hypotheses" and is_stated(headers):
        poses = _read_distributions(path, headers, stored)
        file.close()
        return poses
    chosen = _choose(headers, name, role)
    members = _declared(headers, chosen, headers[chosen][0], name, lambda key: stored[key].read())
    array = open_member(stored[chosen], file, path)
    if array.file is not file:
        file.close()
    return StoredPoses(name, array, **members, unread=_unread(headers, chosen))


def _read_distributions(path: Path, headers: Mapping[str, Header], stored: Mapping[str, Member]) -> StoredPoses:
    """Read what stands beside distributions, of which hypotheses will be drawn."""
    drawn = open_distributions(path, stored)
    others = {key: header for key, header in headers.items() if key not in STATED}
    members = _declared(others, "", drawn.shape, path.name, lambda key: stored[key].read())
    return StoredPoses(path.name, drawn, **{**members, "axes": HYPOTHESES}, unread=_unread(others, ""))


def _read_datasets(path: Path, dataset: str, role: Role) -> StoredPoses:
    """Read what stands beside the coordinates of an HDF5 file or a zarr group; those are read where they lie."""
    with refuse_unreadable(path):
        coordinates, others = open_datasets(path, dataset, _NAMES[role])
        array = DatasetArray(coordinates)
        members = declared_beside({k: v for k, v in others.items() if k in DECLARED}, array.shape, path.name)
        datasets = {k: (v.shape, False, v.dtype) for k, v in others.items() if hasattr(v, "chunks")}
    return StoredPoses(path.name, array, **members, unread=_unread(datasets, ""))


def _unread(headers: Mapping[str, Header], chosen: str) -> dict[str, tuple[int, ...]]:
    """Give the shapes of the arrays of numbers that evaluations don't read; what a file is trained with is no such."""
    known = {chosen, *_RESERVED, *_NAMES["hypotheses"], *_NAMES["truth"]}
    known |= {"keypoints_2d", "keypoints_observed", "keypoints_sigma"}
    known |= {"confidence"} if "valid" in headers else set()  # of convert, which makes valid of it
    return {
        key: shape
        for key, (shape, _, dtype) in headers.items()
        if key not in known and len(shape) > 1 and dtype.kind in "biuf"
    }


def declared_beside(values: Mapping[str, Any], coordinates: tuple[int, ...], name: str) -> dict[str, Any]:
    """Read what datasets, attributes or arrays beside the coordinates declare, as attributes of StoredPoses.

    Raises
    ------
    PoseDataError
        For values of the wrong type, all at once.
    """
    headers: dict[str, Header] = {key: (np.shape(value), False, _dtype(value)) for key, value in values.items()}
    return _declared(headers, "", coordinates, name, lambda key: _loaded(values[key]))


def _dtype(value: Any) -> np.dtype[np.generic]:
    return np.dtype(value.dtype) if hasattr(value, "dtype") else np.asarray(value).dtype


def _loaded(value: Any) -> npt.NDArray[Any]:
    """Read a dataset or an attribute; byte strings, as HDF5 has them, become text."""
    array = np.asarray(value[()] if hasattr(value, "chunks") else value)
    if array.dtype.kind != "O":
        return array
    texts = [entry.decode("utf-8", "replace") if isinstance(entry, bytes) else str(entry) for entry in array.ravel()]
    return np.array(texts).reshape(array.shape)


def _declared(
    headers: Mapping[str, Header],
    chosen: str,
    coordinates: tuple[int, ...],
    name: str,
    load: Callable[[str], npt.NDArray[Any]],
) -> dict[str, Any]:
    """Read what is declared beside the coordinates, all that is wrong with it at once.

    Nothing declares more values than there are coordinates: what does is refused by its shape, and no memory used.
    """
    problems: list[str | PosecalError] = []
    most = max(math.prod(coordinates), _ALWAYS_READ)
    larger = {key for key, (shape, _, _) in headers.items() if math.prod(shape) > most}

    def read(convert: Callable[[npt.NDArray[Any], str], T], key: str) -> T | None:
        if key in larger:
            shape = headers[key][0]
            problems.append(
                f"{name}: {key} {shape} for coordinates {coordinates}; expected one for each frame or joint."
            )
            return None
        return attempt(problems, lambda: convert(load(key), f"{name}: {key}")) if key in headers else None

    labels = {
        key: read(_label, key)
        for key, (shape, _, dtype) in headers.items()
        if key not in (*_RESERVED, chosen) and (key in COMMON_LABELS or key not in larger)
        if len(shape) == 1 or (key in COMMON_LABELS and _is_of_poses(shape, coordinates))
        if dtype.kind in LABEL_KINDS or (dtype.hasobject and key in COMMON_LABELS)
    }
    marks = {key: read(as_marks, key) for key in _MARKS}
    members: dict[str, Any] = {
        "axes": read(_word, "axes"),
        "unit": read(_word, "unit"),
        "joints": read(lambda array, name: tuple(as_text(array.ravel(), name).tolist()), "joints"),
        "parents": read(_parents, "parents"),
        "frame_id": read(lambda array, name: as_labels(array.ravel(), name), "frame_id"),
        "labels": {key: values for key, values in labels.items() if values is not None},
        "marks": {key: mask for key, mask in marks.items() if mask is not None},
        "scores": read(as_scores, "scores"),
        "log_prob": read(density.as_log_prob, "log_prob"),
        "dimensions": read(density.as_dimensions, "dimensions"),
        "weights": read(as_weights, "weights"),
        "valid": read(as_marks, "valid"),
        "fps": read(_number, "fps"),
        "recalibrated_on": read(as_fitted_hashes, "recalibrated_on"),
        "observed": read(real_array, "observed"),
    }
    raise_all(problems)
    return members


def _choose(headers: dict[str, Header], name: str, role: Role) -> str:
    """Choose the member that holds the coordinates."""
    for key in _NAMES[role]:
        if key in headers:
            return key
    other: Role = "truth" if role == "hypotheses" else "hypotheses"
    swapped = [key for key in _NAMES[other] if key in headers]
    wanted = " or ".join(_NAMES[role])
    if swapped:
        shape = headers[swapped[0]][0]
        raise PoseDataError(f"{name} holds {swapped[0]} {shape} and no {wanted}. The two files look swapped.")
    large = [key for key, (shape, _, _) in headers.items() if key not in _RESERVED and len(shape) > 1]
    if len(large) == 1 and not (role == "hypotheses" and large[0] in STATED):
        return large[0]
    if role == "hypotheses" and {*large} & {*STATED}:
        raise PoseDataError(
            f"{name} holds {', '.join(large)}; expected mean and covariance, or mean and sigma, of a distribution. A "
            "pose that is a prediction by itself is stored as hypotheses."
        )
    members = ", ".join(f"{key} {shape}" for key, (shape, _, _) in headers.items()) or "nothing"
    raise PoseDataError(f"{name} holds {members}; expected an array named {wanted}, or just one array of coordinates.")


def _word(array: npt.NDArray[Any], name: str) -> str:
    if array.size != 1:
        raise PoseDataError(f"{name}: {array.size} values; expected one word.")
    return str(as_text(array.ravel(), name)[0])


def _label(array: npt.NDArray[Any], name: str) -> npt.NDArray[np.str_]:
    """Read a label of each pose, or of each frame of clips; a row or a column is one of each pose."""
    found = array.reshape(()) if array.size == 1 else array.ravel() if 1 in array.shape else array
    return as_labels(found, name, or_one=True, or_clips=True)


def _is_of_poses(shape: tuple[int, ...], coordinates: tuple[int, ...]) -> bool:
    """Whether a table may hold a label: of all poses, of each in a row or a column, or of frames of clips (C, T)."""
    if len(shape) != 2:
        return False
    frames = coordinates[:-2]
    is_of_clips = math.prod(shape) in map(math.prod, pairwise(frames))
    return math.prod(shape) == 1 or (1 in shape and max(shape) in frames) or is_of_clips


def _parents(array: npt.NDArray[Any], name: str) -> tuple[int | str, ...]:
    if array.dtype.kind not in "iuSU":
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected (K,), numbers (-1 for a root) or names.")
    return tuple((array if array.dtype.kind in "iu" else as_text(array, name)).ravel().tolist())


def _number(array: npt.NDArray[Any], name: str) -> float:
    if array.size != 1 or array.dtype.kind not in "fiu":
        raise PoseDataError(f"{name}: {array.dtype} {array.shape}; expected one number.")
    return float(array.astype(np.float64).ravel()[0])
