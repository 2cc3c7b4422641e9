"""Files that hold several arrays: ``.npz`` and ``.npy``, ``.mat``, HDF5, ``.pt`` and ``.pkl``; and C3D."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from posecal.conversion.tables import of_multiindex
from posecal.conversion.tracks import Tracks
from posecal.data import pickles
from posecal.errors import PosecalError, PoseDataError, PoseFileError, first_few

_EXTRAS = {"h5py": "convert", "pymatreader": "convert", "ezc3d": "c3d", "torch": "models"}
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


def chosen_array(arrays: Mapping[str, Any], dataset: str | None, name: str) -> np.ndarray[Any, Any]:
    """Choose the coordinates among arrays by name.

    Raises
    ------
    PoseDataError
        Where no name, or more than one, may be meant.
    """
    known = {key: np.asarray(value) for key, value in arrays.items() if _is_numeric(value)}
    shown = ", ".join(f"{key} {value.shape}" for key, value in known.items()) or "no arrays of numbers"
    if dataset is not None:
        if dataset not in known:
            raise PoseDataError(f"{name}: no dataset {dataset!r}; it holds {shown}.")
        return known[dataset]
    likely = [key for key in _LIKELY if key in known]
    large = likely[:1] or [key for key, value in known.items() if value.ndim >= 2]
    if len(large) != 1:
        raise PoseDataError(f"{name}: holds {shown}; expected one array of coordinates. Name it with --dataset.")
    return known[large[0]]


def _is_numeric(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "fiu" and np.ndim(value) > 0
    except ValueError:
        return False


def read_numpy(path: Path, dataset: str | None) -> Tracks:
    """Read an ``.npz`` or ``.npy`` file without pickles, such as mmpose's: S, with a confidence as fourth column."""
    try:
        loaded = np.load(path, allow_pickle=False)
        arrays = {"array": loaded} if isinstance(loaded, np.ndarray) else {key: loaded[key] for key in loaded.files}
    except (ValueError, OSError, EOFError, KeyError) as error:
        raise PoseDataError(f"{path.name}: can't be read ({error}); pickled members are never loaded.") from None
    poses = chosen_array(arrays, dataset, path.name)
    tracks = Tracks(poses.astype(np.float64))
    if poses.ndim == 3 and poses.shape[2] == 4:
        tracks = Tracks(tracks.poses[..., :3], confidence=tracks.poses[..., 3])
        tracks.assumed.append("the fourth column is a confidence")
    names = arrays.get("imgname")
    if names is not None and len(names) == len(poses):
        tracks.frame_id = [str(value) for value in names]
    return tracks


def read_mat(path: Path, dataset: str | None) -> Tracks:
    """Read a MATLAB file of version 7 or 7.3."""
    try:
        return Tracks(chosen_array(_flat(library("pymatreader").read_mat(path)), dataset, path.name).astype(np.float64))
    except (ValueError, OSError, TypeError, KeyError, NotImplementedError) as error:
        if isinstance(error, PoseDataError):
            raise
        raise PoseDataError(f"{path.name}: is no .mat file that can be read ({error}).") from None


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
        if isinstance(item, h5py.Dataset):
            arrays[key] = item[()]

    try:
        with h5py.File(path) as file:
            groups = [group for group in file.values() if "pandas_type" in group.attrs]
            if groups:
                return of_multiindex(_of_pandas(groups[0], path.name), path.name)
            file.visititems(keep)
    except (OSError, KeyError, IndexError, RuntimeError, MemoryError) as error:
        if isinstance(error, PosecalError):
            raise
        raise PoseFileError(f"{path.name}: is no HDF5 file that can be read ({error}).") from None
    return Tracks(chosen_array(arrays, dataset, path.name).astype(np.float64))


def _of_pandas(group: Any, name: str) -> Any:
    """Read a data frame of numbers whose columns have several levels, stored as a table or in the fixed format."""
    import pandas as pd

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
    torch = library("torch")
    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # noqa: BLE001  PyTorch raises of every kind
        raise PoseDataError(
            f"{path.name}: holds more than tensors, or is cut off ({str(error).splitlines()[0]})."
        ) from None
    return Tracks(chosen_array(_tensors(loaded), dataset, path.name).astype(np.float64))


def read_pickle(path: Path, dataset: str | None) -> Tracks:
    """Read a pickle of NumPy arrays in lists, tuples and dictionaries; one that asks for anything else is refused."""
    return Tracks(
        chosen_array(_tensors(pickles.read_pickled(path.read_bytes(), path.name)), dataset, path.name).astype(
            np.float64
        )
    )


def _tensors(loaded: Any) -> dict[str, Any]:
    arrays = loaded if isinstance(loaded, Mapping) else {"array": loaded}
    return {str(key): value.numpy(force=True) if hasattr(value, "numpy") else value for key, value in arrays.items()}


def read_c3d(path: Path, _dataset: str | None) -> Tracks:
    """Read the markers of a C3D file; those of a negative residual, or at the origin, are not known."""
    ezc3d = library("ezc3d")
    try:
        content = ezc3d.c3d(str(path))
    except Exception as error:  # noqa: BLE001  the library raises of every kind
        raise PoseDataError(f"{path.name}: is no .c3d file that can be read ({error}).") from None
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


CONTAINERS: dict[str, Callable[[Path, str | None], Tracks]] = {
    ".npz": read_numpy,
    ".npy": read_numpy,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".pt": read_torch,
    ".pth": read_torch,
    ".pkl": read_pickle,
    ".pickle": read_pickle,
    ".c3d": read_c3d,
}
