"""Arrays of HDF5 and zarr, and tensors on another device, read in place some poses at a time."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import real_array
from posecal.data.child_process import run_in_child
from posecal.errors import PoseDataError, PoseFileError, refuse_unreadable

LIBRARIES = {".h5": "h5py", ".hdf5": "h5py", ".zarr": "zarr"}
_RATIO = 1100
"""What compression can save at most."""
_LEAST_CLAIMED = 1 << 24
"""Bytes up to which an array may be missing in its file: HDF5 stores no chunks that were never written.

Of zarr, that is what its metadata takes: each chunk is a file, and one after another would be looked for."""
_EXTRA = {"h5py": "convert", "zarr": "zarr"}
_COPIED = 32 * 1024 * 1024
"""Bytes up to which a tensor is copied to the host as a whole: its poses are looked at more than once."""


@dataclass(frozen=True)
class DatasetArray:
    """A dataset of h5py or zarr, as a :class:`posecal.data.layout.LazyArray`.

    Attributes
    ----------
    dataset : h5py.Dataset or zarr.Array
        It is read where its parts are asked for.
    """

    dataset: Any

    def __post_init__(self) -> None:
        if self.dtype.kind not in "fiu":
            raise PoseDataError(f"{self.name}: dtype {self.dtype}; expected real numbers such as float32.")
        refuse_unwritten(self.dataset)

    def __reduce__(self) -> tuple[object, ...]:
        if hasattr(self.dataset, "file"):  # of h5py, which does not pickle
            return _reopened, (self.dataset.file.filename, self.dataset.name)
        return DatasetArray, (self.dataset,)

    @property
    def name(self) -> str:
        """What messages call it."""
        return str(self.dataset.name or "array").lstrip("/")

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of every axis."""
        return tuple(self.dataset.shape)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type of its numbers."""
        kind: np.dtype[np.generic] = np.dtype(self.dataset.dtype)
        return kind

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Read a range of every axis.

        Raises
        ------
        PoseFileError
            Where the file is closed, cut off or damaged.
        """
        try:
            return np.asarray(self.dataset[where])
        except Exception as error:  # noqa: BLE001  the libraries raise of every kind
            raise PoseFileError(f"{self.name}: can't be read ({error}). Was the file closed, or cut off?") from None


@dataclass(frozen=True)
class DeviceArray:
    """A tensor on another device, as a :class:`posecal.data.layout.LazyArray`: parts are copied to the host.

    Attributes
    ----------
    tensor : torch.Tensor
        It stays where it is.
    name : str
        What messages call it.
    """

    tensor: Any
    name: str

    def __post_init__(self) -> None:
        self.part((slice(0, 0),))  # refuses other than real numbers

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of every axis."""
        return tuple(self.tensor.shape)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The type that its numbers have on the host."""
        return self.part((slice(0, 0),)).dtype

    def part(self, where: tuple[slice, ...]) -> npt.NDArray[np.generic]:
        """Copy a range of every axis."""
        return real_array(self.tensor[where], self.name)


def is_large_on_device(source: object) -> bool:
    """Whether this is a tensor of PyTorch that lies on another device and is not copied as a whole."""
    place = getattr(getattr(source, "device", None), "type", "cpu")
    return hasattr(source, "detach") and place != "cpu" and getattr(source, "nbytes", 0) > _COPIED


def _walk(path: Path) -> None:
    """Read the structure of an HDF5 file: what its library may crash on, so that it does not do so here."""
    h5py = import_module("h5py")

    def look(_name: str, node: Any) -> None:
        dict(node.attrs)
        if not isinstance(node, h5py.Dataset):
            return
        if node.chunks is not None:
            node.id.get_num_chunks()
        if node.dtype.kind not in "fiu" or (node.size or 0) * node.dtype.itemsize <= _LEAST_CLAIMED:
            node[()]
        else:
            node[(0,) * node.ndim], node[tuple(length - 1 for length in node.shape)]

    with refuse_unreadable(path, "can't be read by h5py ({})."), h5py.File(path, "r") as file:
        look("/", file)
        file.visititems(look)


def refuse_unwritten(dataset: Any) -> None:
    """Refuse a dataset of many more bytes than were ever written: it would be read as so many zeros.

    Raises
    ------
    PoseFileError
        With both numbers.
    """
    needed, is_hdf5 = math.prod(dataset.shape) * dataset.dtype.itemsize, hasattr(dataset, "id")
    there = dataset.id.get_storage_size() if is_hdf5 else dataset.nbytes_stored()
    if needed > max(_RATIO * there, _LEAST_CLAIMED if is_hdf5 else 0):
        name, shape = str(dataset.name or "array").lstrip("/"), tuple(dataset.shape)
        raise PoseFileError(f"{name}: {there:,} of {needed:,} bytes of {shape} are there; expected all.")


def _reopened(path: str, dataset: str) -> DatasetArray:
    return DatasetArray(import_module("h5py").File(path, "r")[dataset])


def is_dataset(source: object) -> bool:
    """Whether this is a dataset of h5py or an array of zarr, without importing either."""
    module = type(source).__module__.partition(".")[0]
    return module in {"h5py", "zarr"} and hasattr(source, "shape")


def split_address(text: str) -> tuple[Path, str]:
    """Split ``FILE.h5:/dataset`` into the file and the dataset, which is empty where none is named."""
    for ending in LIBRARIES:
        path, colon, dataset = text.partition(f"{ending}:")
        if colon:
            return Path(path + ending), dataset
    return Path(text), ""


def open_datasets(path: Path, dataset: str, names: tuple[str, ...]) -> tuple[Any, Mapping[str, Any]]:
    """Open the dataset of coordinates of an HDF5 file or a zarr group, and what stands beside it.

    Parameters
    ----------
    path : Path
        An existing ``.h5``, ``.hdf5`` or ``.zarr``.
    dataset : str
        Its name; empty for one of ``names``, or the only one of several axes.
    names : tuple of str
        What the coordinates may be called.

    Returns
    -------
    array : dataset
        Of the coordinates, not read.
    others : mapping
        Datasets of the same group, and attributes of the file, the group and the array, by name; the nearest counts.

    Raises
    ------
    PoseDataError, PoseFileError
        Where the library is not installed, the file is none, or it holds no such dataset.
    """
    library = LIBRARIES[path.suffix.lower()]
    try:
        module = import_module(library)
    except ImportError:
        raise PoseDataError(
            f"{path.name}: needs {library}, which is not installed. pip install 'posecal[{_EXTRA[library]}]' brings it."
        ) from None
    if library == "h5py":
        run_in_child(path, _walk, path)
    with refuse_unreadable(path, f"can't be read by {library} ({{}})."), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files beside the arrays of a zarr group
        root = module.File(path, "r") if library == "h5py" else module.open(str(path), mode="r")
        if hasattr(root, "dtype"):  # a zarr array by itself
            return root, dict(root.attrs)
        inner = dataset.rpartition("/")[0]
        group = root[inner or "/"]
        # the names first: what is raised within an iteration leaves h5py locked, and zarr reads all members at once
        folder = path / inner.strip("/")
        found = list(group) if library == "h5py" else [each.name for each in folder.iterdir() if each.is_dir()]
        nodes = {str(key): group[key] for key in found}
        held = {key: node for key, node in nodes.items() if hasattr(node, "dtype")}
    name = dataset.rpartition("/")[2]
    large = [key for key, value in held.items() if len(value.shape) > 2]
    chosen = [name] if name else [key for key in names if key in held] or large
    if len(chosen) != 1 or chosen[0] not in held:
        shown = ", ".join(f"{key} {tuple(value.shape)}" for key, value in held.items()) or "nothing"
        raise PoseDataError(
            f"{path.name} holds {shown}; expected {' or '.join(names)}, or the name after a colon: {path.name}:NAME."
        )
    beside = {key: value for key, value in held.items() if key != chosen[0]}
    return held[chosen[0]], {**root.attrs, **group.attrs, **beside, **held[chosen[0]].attrs}
