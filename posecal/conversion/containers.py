"""Files that hold several arrays: ``.npz`` and ``.npy``, ``.mat``, HDF5, ``.pt`` and ``.pkl``; and C3D."""

from __future__ import annotations

import struct
import warnings
import zipfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from posecal.conversion.tables import of_multiindex
from posecal.conversion.tracks import Tracks
from posecal.data import pickles
from posecal.data.archive import read_archive
from posecal.data.arrays import as_array
from posecal.data.child_process import run_in_child
from posecal.data.file_array import Source, open_array, opened
from posecal.data.layout import LazyArray
from posecal.data.lazy import DatasetArray, refuse_unwritten
from posecal.data.read import DECLARED, declared_beside
from posecal.errors import PoseDataError, PoseFileError, first_few, option, refuse_unreadable

_LEAST_CLAIMED = 1 << 24
"""Bytes up to which a tensor may repeat its numbers."""

_EXTRAS = {"h5py": "convert", "pymatreader": "convert", "ezc3d": "c3d", "torch": "models"}
_BESIDE = ("frame_id", "parents", "scores", "valid", "weights")
_LIKELY = (
    "hypotheses",
    "hyps",
    "truth",
    "gt",
    "poses",
    "joints3d",
    "joints_3d",
    "keypoints",
    "keypoints_3d",
    "S",
    "part",
)


def library(name: str) -> Any:
    """Import a library of an extra.

    Raises
    ------
    PoseDataError
        Where it is not installed, with how to install it.
    """
    try:
        return import_module(name)
    except ImportError:
        raise PoseDataError(f"{name}: not installed. pip install 'posecal[{_EXTRAS[name]}]' brings it.") from None


def chosen_array(arrays: Mapping[str, Any], dataset: str | None, name: str) -> str:
    """Choose the coordinates among arrays, and give their name.

    Raises
    ------
    PoseDataError
        Where no name, or more than one, may be meant.
    """
    known = {key: value for key, value in map(_as_numbers, arrays.items()) if value is not None}
    shown = ", ".join(f"{key} {value.shape}" for key, value in known.items()) or "no arrays of numbers"
    if dataset is not None:
        if dataset not in known:
            raise PoseDataError(f"{name}: no dataset {dataset!r}; it holds {shown}.")
        return dataset
    likely = [key for key in _LIKELY if key in known]
    large = likely[:1] or [key for key, value in known.items() if len(value.shape) >= 2]
    if len(large) != 1:
        raise PoseDataError(
            f"{name}: holds {shown}; expected one array of coordinates. Name it with {option('dataset')}."
        )
    return large[0]


def _tracks(arrays: Mapping[str, Any], dataset: str | None, name: str) -> Tracks:
    """Give the coordinates among arrays, with what is stated about them: of themselves, of their group, of the file."""
    key = chosen_array(arrays, dataset, name)
    coordinates = arrays[key] if hasattr(arrays[key], "dtype") else np.asarray(arrays[key])
    group = key.rpartition("/")[0]
    near = {word: [f"{key}/{word}", f"{group}/{word}", word] for word in sorted(DECLARED)}
    found = {word: next((p for p in places if p in arrays and p != key), None) for word, places in near.items()}
    stated = {word: arrays[place] for word, place in found.items() if place is not None}
    if _has_numbers(stated.get("joints")):
        del stated["joints"]  # positions, beside those that were asked for
    declared = declared_beside(stated, coordinates.shape, name)
    others = {**declared["labels"], **declared["marks"], **{word: declared[word] for word in _BESIDE}}
    is_dataset = hasattr(coordinates, "chunks")
    return Tracks(
        (_whole(DatasetArray(coordinates)) if is_dataset else coordinates).astype(np.float64),
        declared["joints"] or (),
        declared["unit"] or "",
        declared["fps"] or 0.0,
        axes=declared["axes"] or "",
        is_array=True,
        beside={word: np.asarray(value) for word, value in others.items() if value is not None},
    )


def _has_numbers(value: Any) -> bool:
    return value is not None and (value if hasattr(value, "dtype") else np.asarray(value)).dtype.kind in "fiu"


def _as_numbers(item: tuple[str, Any]) -> tuple[str, Any]:
    """Give an array, or a dataset that is not read yet; None in the place of one that holds no numbers."""
    key, value = item
    try:
        array = value if hasattr(value, "dtype") else np.asarray(value)
    except ValueError:
        return key, None
    return key, array if array.dtype.kind in "fiu" and len(array.shape) > 0 else None


def read_numpy(path: Path, dataset: str | None) -> Tracks:
    """Read an ``.npz`` or ``.npy`` file without pickles."""
    with opened(path) as file:
        if file.read(6) == b"\x93NUMPY":
            arrays: dict[str, Any] = {"array": _whole(open_array(file, 0, path.name, Source.of(path, file)))}
        else:
            file.close()
            arrays = dict(read_archive(path))
    tracks = _tracks(arrays, dataset, path.name)
    names = arrays.get("imgname")
    if names is not None and names.shape == tracks.poses.shape[:1]:
        tracks.frame_id = [str(value) for value in names]
    return tracks


def _whole(array: LazyArray) -> np.ndarray[Any, Any]:
    """Read all of an array that lies in a file."""
    return array.part(tuple(slice(0, length) for length in array.shape))


def read_mat(path: Path, dataset: str | None) -> Tracks:
    """Read a MATLAB file of version 7 or 7.3."""
    with refuse_unreadable(path, "is no .mat file that can be read ({})."), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numbers that no computer writes any more
        arrays = _flat(library("pymatreader").read_mat(path))
    return _tracks(arrays, dataset, path.name)


def _flat(document: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in document.items():
        found |= _flat(value, f"{before}{key}/") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return found


def read_hdf5(path: Path, dataset: str | None) -> Tracks:
    """Read HDF5: a dataset, or the table that DeepLabCut and Anipose write through pandas.

    pandas itself would unpickle what such a table holds beside its numbers, and with it run any code.
    """
    h5py = library("h5py")
    arrays: dict[str, Any] = {}

    def keep(key: str, item: Any) -> None:
        arrays.update({f"{key}/{word}": item.attrs[word] for word in item.attrs if word in DECLARED})
        if isinstance(item, h5py.Dataset):
            arrays[key] = item

    with refuse_unreadable(path, "is no HDF5 file that can be read ({})."), h5py.File(path) as file:
        groups = [group for group in map(file.get, list(file)) if "pandas_type" in group.attrs]
        if groups:
            if dataset is not None:
                raise PoseDataError(f"{path.name}: a table of pandas; expected no {option('dataset', dataset)}.")
            return of_multiindex(_of_pandas(groups[0], path.name), path.name)
        arrays.update({word: file.attrs[word] for word in file.attrs if word in DECLARED})
        file.visititems(keep)
        return _tracks(arrays, dataset, path.name)


def _of_pandas(group: Any, name: str) -> Any:
    """Read a data frame of numbers whose columns have several levels, stored as a table or in the fixed format."""
    import pandas as pd

    for item in map(group.get, list(group)):
        if hasattr(item, "shape"):
            refuse_unwritten(item)
    if "table" in group:
        table = group["table"][()]
        if "values_block_0" not in table.dtype.names or "values_block_1" in table.dtype.names:
            raise PoseDataError(f"{name}: columns of several types; expected numbers. Save it as .csv.")
        columns = pickles.read_pickled(bytes(group.attrs["non_index_axes"]), f"{name}: names of columns")[0][1]
        return pd.DataFrame(table["values_block_0"], table["index"], pd.MultiIndex.from_tuples(map(tuple, columns)))
    if "block0_values" not in group or "block1_values" in group:
        raise PoseDataError(f"{name}: columns of several types, or none; expected numbers. Save it as .csv.")
    levels, codes = [], []
    for number in range(int(group.attrs.get("block0_items_nlevels", 1))):
        words = group[f"block0_items_level{number}"][()]
        if words.dtype.kind != "S":
            raise PoseDataError(f"{name}: names of columns are {words.dtype}; expected text. Save it as .csv.")
        levels.append(np.char.decode(words, "utf-8"))
        codes.append(group[f"block0_items_label{number}"][()])
    columns = [tuple(level[code] for level, code in zip(levels, key, strict=True)) for key in zip(*codes, strict=True)]
    return pd.DataFrame(group["block0_values"][()], columns=pd.MultiIndex.from_tuples(columns))


def read_torch(path: Path, dataset: str | None) -> Tracks:
    """Read tensors that PyTorch saved; nothing else in the file is loaded (``weights_only``)."""
    members = _named(load_tensors(path))
    tensors = {key: value for key, value in members.items() if hasattr(value, "untyped_storage")}
    arrays = {key: _in_memory(value, f"{path.name}: {key}") for key, value in tensors.items()}
    return _tracks({**{k: v for k, v in members.items() if k in DECLARED}, **arrays}, dataset, path.name)


def load_tensors(path: Path) -> Any:
    """Load what PyTorch saved, tensors only, after its checksums, which PyTorch does not compare.

    Raises
    ------
    PoseFileError
        For a file that holds anything else, or can't be read.
    """
    torch = library("torch")
    with refuse_unreadable(path, "holds more than tensors, or is cut off."), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pickles that are no tensors, which are refused
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                if (damaged := archive.testzip()) is not None:
                    raise PoseFileError(f"{path.name}: {damaged} is damaged. Copy it again.")
        return torch.load(path, map_location="cpu", weights_only=True)


def read_pickle(path: Path, dataset: str | None) -> Tracks:
    """Read a pickle of NumPy arrays in lists, tuples and dictionaries; one that asks for anything else is refused."""
    arrays = _named(pickles.read_pickled(path.read_bytes(), path.name))
    return _tracks(arrays, dataset, path.name)


def _named(loaded: Any) -> dict[str, Any]:
    members = loaded if isinstance(loaded, Mapping) else {"array": loaded}
    return {str(key): value for key, value in members.items()}


def _in_memory(tensor: Any, name: str) -> np.ndarray[Any, Any]:
    """Give a tensor as an array; one that repeats its numbers by strides of 0 may not be of many times their size."""
    if tensor.numel() * tensor.element_size() > max(tensor.untyped_storage().nbytes(), _LEAST_CLAIMED):
        raise PoseDataError(f"{name}: a tensor {tuple(tensor.shape)} of fewer numbers; expected as many as it has.")
    return as_array(tensor, name)


def read_c3d(path: Path, _dataset: str | None) -> Tracks:
    """Read the markers of a C3D file; those of a negative residual, or at the origin, are not known."""
    with refuse_unreadable(path, "is no .c3d file that can be read ({})."):
        _refuse_cut_c3d(path)
        content = library("ezc3d").c3d(str(path))
    point = content["parameters"]["POINT"]
    points = content["data"]["points"][:3].transpose(2, 1, 0)
    if not points.size:
        raise PoseDataError(f"{path.name}: holds no markers; expected some.")
    lost = ~points.any(axis=2)
    points[lost] = np.nan
    joints = [str(label) for label in point["LABELS"]["value"]][: points.shape[1]]
    assumed = ["markers at exactly 0, 0, 0 are not known"] if lost.any() else []
    unit, rate = first_few(point["UNITS"]["value"], 1), float(point["RATE"]["value"][0])
    return Tracks(points, joints, unit, rate, assumed=assumed)


def _refuse_cut_c3d(path: Path) -> None:
    """Refuse a file of fewer bytes than its header says, of which the library would never find the end."""
    with path.open("rb") as file:
        head, size = file.read(512), file.seek(0, 2)
        file.seek(512 * (head[0] - 1) + 3)
        is_little_endian = file.read(1) == b"\x54"
    if head[1] != 0x50:
        raise ValueError("it has no head of one")
    points, analog, first, last, _, scale, start = struct.unpack_from("<5HfH", head, 2)
    frames, width = last - first + 1, 4 if scale < 0 else 2
    needed = 512 * (start - 1) + frames * (4 * points + analog) * width
    if is_little_endian and size < needed:
        raise ValueError(f"{size:,} of {needed:,} bytes are there")


def _in_child(read: Callable[[Path, str | None], Tracks]) -> Callable[[Path, str | None], Tracks]:
    return lambda path, dataset: run_in_child(path, read, path, dataset)


CONTAINERS: dict[str, Callable[[Path, str | None], Tracks]] = {
    ".npz": read_numpy,
    ".npy": read_numpy,
    ".mat": _in_child(read_mat),
    ".h5": _in_child(read_hdf5),
    ".hdf5": _in_child(read_hdf5),
    ".pt": read_torch,
    ".pth": read_torch,
    ".pkl": read_pickle,
    ".pickle": read_pickle,
    ".c3d": _in_child(read_c3d),
}
