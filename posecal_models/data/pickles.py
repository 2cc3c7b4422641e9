"""How is a pickle read that somebody else made? With a reader that knows arrays, dictionaries, lists and text only.

A pickle is a program: loading one from the network with :mod:`pickle` runs whatever it says. Here every name that it
asks for is looked up in a short table, so that a hostile file is refused before it has done anything.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from posecal.errors import PoseFileError

__all__ = ["read_object_npz", "read_pickle"]


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """Turn text into bytes, as pickles of protocol 2 store the bytes of an array."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"asks for the codec {encoding}")
    return text.encode("latin1")


_reconstruct: Callable[..., Any] = np.zeros(0).__reduce__()[0]  # type: ignore[assignment]
_scalar: Callable[..., Any] = np.float64(0).__reduce__()[0]  # type: ignore[assignment]
_frombuffer: Callable[..., Any] = np.zeros(0).__reduce_ex__(5)[0]  # type: ignore[assignment]

_ADMITTED: dict[tuple[str, str], Any] = {
    ("_codecs", "encode"): _encode,
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    **{
        (f"numpy.{package}.multiarray", name): known
        for package in ("core", "_core")
        for name, known in (("_reconstruct", _reconstruct), ("scalar", _scalar))
    },
    **{(f"numpy.{package}.numeric", "_frombuffer"): _frombuffer for package in ("core", "_core")},
}


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"asks for {module}.{name}") from None


def _load(file: io.BufferedIOBase, which: str) -> Any:
    try:
        return _PlainUnpickler(file, encoding="latin1").load()
    except (
        pickle.UnpicklingError,
        EOFError,
        ValueError,
        IndexError,
        TypeError,
        KeyError,
        AttributeError,
    ) as problem:
        raise PoseFileError(
            f"{which}: {' '.join(str(problem).split())}; expected a pickle of plain arrays, dictionaries, lists "
            "and text. It was not loaded: a pickle that asks for more can run programs."
        ) from problem


def read_pickle(path: str | Path) -> Any:
    """Read a pickle of plain arrays, dictionaries, lists and text.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    object
        What it holds.

    Raises
    ------
    PoseFileError
        Where the file can't be read, or asks for anything else.
    """
    try:
        with open(path, "rb") as file:
            return _load(file, str(path))
    except PoseFileError:
        raise
    except OSError as problem:
        raise PoseFileError(f"{path}: can't be read ({problem.strerror}).") from problem


def read_object_npz(path: str | Path) -> dict[str, Any]:
    """Read an ``.npz`` whose members may be pickled objects, without trusting the pickles.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    dict of str to object
        Members: arrays as arrays, a single pickled object as the object.

    Raises
    ------
    PoseFileError
        Where the file can't be read, or a pickle asks for more than plain data.
    """
    members: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                with archive.open(name) as file:
                    members[name.removesuffix(".npy")] = _read_npy(io.BytesIO(file.read()), f"{path}: {name}")
    except PoseFileError:
        raise
    except (OSError, zipfile.BadZipFile, ValueError) as problem:
        raise PoseFileError(f"{path}: can't be read as .npz ({problem}).") from problem
    return members


def _read_npy(file: io.BytesIO, which: str) -> Any:
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if not dtype.hasobject:
        file.seek(0)
        return npy.read_array(file, allow_pickle=False)
    loaded = _load(file, which)
    return loaded.item() if isinstance(loaded, np.ndarray) and shape == () else loaded
