"""Saved results: the sums of an evaluation in a compressed .npz file, and the poses of its gallery, if it has one."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.archive import read_archive
from posecal.data.remarks import remark_as_json, remark_of_json
from posecal.data.root import Root
from posecal.data.write import write_file, write_members
from posecal.engine.gallery import Gallery
from posecal.engine.metric import Metric
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, PoseFileError, checked_type, refuse_unreadable

FORMAT = 4
"""The version of the file format."""

_LARGEST = 1e30
"""No sum of millions of squares of kilometres is larger."""


def save_totals(totals: Totals, path: str | os.PathLike[str]) -> None:
    """Write the sums into a compressed ``.npz`` file, whole or not at all.

    Parameters
    ----------
    totals : Totals
        The sums.
    path : path
        The file; one that is there is replaced.

    Raises
    ------
    PoseFileError
        Where the file can't be written.
    """
    checked_type(totals, "totals", Totals)
    _check_path(path)
    about = {
        "posecal": totals.version,
        "format": FORMAT,
        "spec": asdict(totals.spec),
        "protocol": totals.protocol.options,
        "remarks": [remark_as_json(remark) for remark in totals.remarks],
        "n_frames": totals.n_frames,
        "has_sequences": totals.has_sequences,
        "prepared_hashes": totals.prepared_hashes,
        "own_metrics": [metric.description for metric in totals.own_metrics],
        "statistics": list(totals.sums),
        "per_pose": list(totals.per_pose),
        "labels": list(totals.cells),
    }
    members: dict[str, npt.NDArray[np.generic]] = {"poses": totals.poses}
    members |= {f"cell/{name}": values for name, values in totals.cells.items()}
    for name in totals.sums:
        members[f"sum/{name}"], members[f"count/{name}"] = totals.sums[name], totals.counts[name]
    members |= {f"per_pose/{name}": values for name, values in totals.per_pose.items()}
    members["cell_of"] = totals.cell_of.astype(np.int32)
    members["pose_hashes"] = totals.pose_hashes
    if totals.gallery is not None:
        members |= {f"gallery/{name}": values for name, values in vars(totals.gallery).items()}
    about["shapes"] = _shapes(members)
    members["about"] = np.array(json.dumps(about))
    members["digest"] = np.array(digest_of(members))
    write_file(path, lambda file: write_members(file, members, compressed=True))


def load_totals(path: str | os.PathLike[str]) -> Totals:
    """Read what :func:`save_totals` wrote.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    Totals
        The sums.

    Raises
    ------
    PoseFileError
        For files that can't be read or are no results.
    """
    _check_path(path)
    name = Path(path).name
    sentence = "no result of posecal evaluate --save, or not a whole one."
    with refuse_unreadable(path, sentence):
        members: dict[str, Any] = {**read_archive(path, sentence)}
        digest, about = str(members.pop("digest", "")), json.loads(str(members["about"]))
        if about["format"] != FORMAT:
            raise PoseFileError(
                f"{name}: format {about['format']} of posecal {about['posecal']}; expected {FORMAT}. Evaluate again."
            )
        totals = Totals(
            spec=DataSpec(**_tuples(about["spec"])),
            protocol=_protocol(about["protocol"]),
            version=about["posecal"],
            cells=_part(members, "cell/"),
            poses=members["poses"],
            remarks=tuple(map(remark_of_json, about["remarks"])),
            n_frames=about["n_frames"],
            has_sequences=about["has_sequences"],
            sums=_part(members, "sum/"),
            counts=_part(members, "count/"),
            per_pose=_part(members, "per_pose/"),
            cell_of=members["cell_of"],
            pose_hashes=members["pose_hashes"],
            own_metrics=tuple(Metric.from_description(texts) for texts in about["own_metrics"]),
            prepared_hashes=about.get("prepared_hashes", {}),  # of files before it
            gallery=Gallery(**gallery) if (gallery := _part(members, "gallery/")) else None,
        )
        if about.get("shapes", _shapes(members)) != _shapes(members):  # of files before it there are none
            raise ValueError("members of other shapes")
        _check_members(totals, about)
        if digest != digest_of(members):
            raise PoseFileError(f"{name}: was changed since posecal wrote it (its digest is another). Evaluate again.")
    return totals


def _protocol(options: dict[str, str]) -> Protocol:
    try:
        return Protocol().changed(options)
    except PoseDataError as error:
        raise ValueError(error.message) from None


def digest_of(members: Mapping[str, npt.NDArray[np.generic]]) -> str:
    """Give the SHA-256 of all members: their names, types, shapes and bytes, in the order of their names."""
    found = hashlib.sha256()
    for name in sorted(members):
        array = np.ascontiguousarray(members[name])
        found.update(f"{name} {array.dtype.str} {members[name].shape}\n".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def _shapes(members: Mapping[str, npt.NDArray[np.generic]]) -> dict[str, list[int]]:
    """Give the shape of every member but the description itself."""
    return {name: [*array.shape] for name, array in members.items() if name != "about"}


def _check_path(path: object) -> None:
    """Refuse what is no path."""
    if not isinstance(path, str | os.PathLike):
        raise PoseDataError(f"path: {type(path).__name__}; expected the path of a saved result.")


def _check_members(totals: Totals, about: dict[str, Any]) -> None:
    """Raise KeyError or ValueError where a file lacks a member, or one has another length than the rest."""
    for members, key in (
        (totals.cells, "labels"),
        (totals.sums, "statistics"),
        (totals.counts, "statistics"),
        (totals.per_pose, "per_pose"),
    ):
        if {*about.get(key, members)} != members.keys():
            raise KeyError(key)
    if "sequence" not in totals.cells or totals.sums.keys() != totals.counts.keys():
        raise KeyError("sequence")
    _check_types(totals)
    of_cells = [totals.poses, *totals.cells.values(), *totals.sums.values(), *totals.counts.values()]
    lengths = {len(values) for values in of_cells}, {len(values) for values in totals.per_pose.values()}
    outside = totals.cell_of.max(initial=-1) >= len(totals.poses) or totals.cell_of.min(initial=0) < 0
    outside |= any(array.ndim != 1 for array in (totals.poses, totals.cell_of, *totals.cells.values()))
    if len(lengths[0]) > 1 or not lengths[1] <= {len(totals.cell_of)} or outside:
        raise ValueError("members of other lengths")
    if totals.pose_hashes.dtype != np.uint64 or totals.pose_hashes.shape[1:] != (2,):
        raise ValueError("pose_hashes of another type or shape")
    if totals.gallery is not None:
        totals.gallery.check(totals.spec)
    if (totals.poses < 0).any() or len({*totals.spec.joints}) < len(totals.spec.joints):
        raise ValueError("negative numbers of poses, or repeated joints")
    for key, counts in totals.counts.items():
        if counts.ndim not in (1, 2) or counts.shape != totals.sums[key].shape[: counts.ndim]:
            raise ValueError(f"{key}: counts {counts.shape} of sums {totals.sums[key].shape}")
        most = totals.poses.reshape(-1, *[1] * (counts.ndim - 1))
        if (counts < 0).any() or (counts > most).any() or not (np.abs(totals.sums[key]) < _LARGEST).all():
            raise ValueError(f"{key}: counts beyond the poses, or sums that are not finite")
    for key, values in totals.per_pose.items():
        if (np.abs(values) > _LARGEST).any():
            raise ValueError(f"{key}: values that are not finite")


def _check_types(totals: Totals) -> None:
    """Raise TypeError where a member, or something that is said of the data, is of another type."""
    spec: Any = totals.spec
    kinds = {field.name: type(field.default) for field in fields(spec) if field.default not in (None, MISSING)}
    kinds |= {"n_hypotheses": int, "joints": tuple}
    wrong = [name for name, kind in kinds.items() if type(getattr(spec, name)) is not kind]
    words: list[Any] = [totals.version, *totals.remarks, *spec.joints, *spec.labels, *spec.preranks, *spec.apart]
    words += [*totals.prepared_hashes, *totals.prepared_hashes.values()]
    arrays: dict[str, list[npt.NDArray[Any]]] = {
        "i": [totals.poses, totals.cell_of, *totals.counts.values()],
        "U": [*totals.cells.values()],
        "f": [*totals.sums.values(), *totals.per_pose.values()],
    }
    wrong += [
        kind for kind, members in arrays.items() for array in members if array.dtype.kind != kind or array.itemsize < 4
    ]
    root, fps = spec.root, spec.fps
    if not (root is None or isinstance(root, Root) or (type(root) is int and 0 <= root < len(spec.joints))):
        wrong.append("root")
    if not (fps is None or (isinstance(fps, float | int) and 0 < fps < np.inf)) or spec.n_hypotheses < 1:
        wrong.append("fps or N")
    wrong += [repr(word) for word in words if not isinstance(word, str)]
    numbers: list[Any] = [totals.has_sequences, totals.n_frames]
    if wrong or [*map(type, numbers)] != [bool, int]:
        raise TypeError(f"other types: {wrong}")


def is_result(path: str | os.PathLike[str]) -> bool:
    """Whether a file looks like a saved result, rather than an array of poses."""
    with suppress(PoseFileError), refuse_unreadable(path), zipfile.ZipFile(path) as archive:
        return "about.npy" in archive.namelist()
    return False


def _part(members: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {key.removeprefix(prefix): value for key, value in members.items() if key.startswith(prefix)}


def _tuples(spec: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in spec.items()}
