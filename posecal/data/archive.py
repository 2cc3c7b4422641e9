"""How are arrays written into an .npz file? Member by member, some of them piece by piece."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt

__all__ = ["Archive", "write_members"]


class Archive:
    """An .npz file that is being written.

    Parameters
    ----------
    file : binary file
        Where to.
    compressed : bool
        Whether members are compressed; those that are not can be memory-mapped later.
    """

    def __init__(self, file: BinaryIO, *, compressed: bool = False) -> None:
        self._method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
        self._zip = zipfile.ZipFile(file, "w", allowZip64=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._zip.close()

    def add(self, name: str, array: npt.NDArray[Any]) -> None:
        """Write a member."""
        self.add_pieces(name, array.shape, array.dtype, [array])

    def add_pieces(
        self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], pieces: Iterable[npt.NDArray[Any]]
    ) -> None:
        """Write a member of which only pieces along the first axis are at hand."""
        info = zipfile.ZipInfo(f"{name}.npy")  # of no date: the same arrays give the same bytes
        info.compress_type = self._method
        with self._zip.open(info, "w", force_zip64=True) as member:
            header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_2_0(member, header)
            for piece in pieces:
                member.write(np.ascontiguousarray(piece, dtype=dtype).tobytes())


def write_members(file: BinaryIO, members: Mapping[str, npt.NDArray[Any]], *, compressed: bool = False) -> None:
    """Write arrays as an .npz file."""
    with Archive(file, compressed=compressed) as archive:
        for name, array in members.items():
            archive.add(name, array)
