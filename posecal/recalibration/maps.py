"""Recalibration maps in small JSON files, and their application to files of hypotheses."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import posecal
from posecal.data.alone import resolve_hypotheses
from posecal.data.arrays import FloatArray
from posecal.data.declarations import Declarations, quantity_of
from posecal.data.fitted_poses import smallest_hashes
from posecal.data.read import read_poses
from posecal.data.root import AnyRoot, Root, parse_root, root_name
from posecal.data.texts import json_text
from posecal.data.units import PERIODS, quantity
from posecal.data.weights import poses_last
from posecal.data.write import Archive, write_file
from posecal.engine.chunks import WINDOW_BYTES
from posecal.engine.storage import digest_of
from posecal.errors import PoseDataError, PoseFileError, option, refuse_unreadable
from posecal.evaluation.sources import Source
from posecal.recalibration.folds import (
    refuse_absent,
    refuse_another_unit,
    refuse_unusable,
    refuse_weights,
    values_for_joints,
)
from posecal.recalibration.radius import RadiusMap, balls
from posecal.recalibration.spread_map import SpreadMap, rescaled

FORMAT = 4
"""The version of the file format."""

Map = SpreadMap | RadiusMap


def write_map(map_: Map, path: str | os.PathLike[str], *, anyway: bool = False) -> None:
    """Write a map as JSON, whole or not at all.

    Parameters
    ----------
    map_ : SpreadMap or RadiusMap
        The map.
    path : path
        The file; one that is there is replaced.
    anyway : bool
        Whether to write a map that makes proper scores worse, or exchanges one side for the other.

    Raises
    ------
    PoseDataError
        For what is no map, and for a map to which there are objections, unless ``anyway``.
    PoseFileError
        Where the file can't be written.
    """
    if not anyway and isinstance(map_, SpreadMap):
        refuse_objections(map_.objections)
    values = {joint: None if math.isnan(value) else value for joint, value in _checked(map_).by_joint.items()}
    about: dict[str, object] = {"posecal": posecal.__version__, "format": FORMAT, "unit": map_.data_unit or "none"}
    if isinstance(map_, SpreadMap):
        changes = {name: list(pair) for name, pair in map_.changes.items()}
        about |= {"kind": "spread", "factors": values, "about_modes": list(map_.modal), "changes": changes}
        about["fitted_hashes"] = " ".join(f"{number:016x}" for number in map_.fitted_on.tolist())
    else:
        about |= {"kind": "radius", "alpha": map_.alpha, "scaled": map_.scaled, "radii": values}
    about["root"] = None if map_.root is None else root_name(map_.root, map_.joints)
    about["fitted_on"] = {"poses": map_.poses, "sequences": map_.sequences}
    about["digest"] = _digest(about)
    write_file(path, lambda file: file.write(f"{json_text(about, indent=1)}\n".encode()))


def refuse_objections(objections: Sequence[str], where: str = "the poses that it was fitted on") -> None:
    """Refuse a map to which there are objections.

    Raises
    ------
    PoseDataError
        With the objections.
    """
    if objections:
        raise PoseDataError(
            f"map: on {where}, {' and '.join(objections)}; expected a map that helps. Not written; to write it all "
            f"the same, pass {option('anyway', True)}."
        )


def _digest(about: dict[str, Any]) -> str:
    return digest_of({"map": np.array(json.dumps({**about, "digest": None}, sort_keys=True))})


def _checked(map_: Map) -> Map:
    if not isinstance(map_, Map):
        raise PoseDataError(f"map: {type(map_).__name__}; expected a SpreadMap or a RadiusMap, as fitting gives.")
    return map_


def read_map(path: str | os.PathLike[str]) -> Map:
    """Read and check a map.

    Parameters
    ----------
    path : path
        What :func:`write_map` wrote.

    Returns
    -------
    SpreadMap or RadiusMap
        The map.

    Raises
    ------
    PoseFileError
        For a file that can't be read, is no map of this version, or was changed since it was written.
    """
    name = Path(path).name
    with refuse_unreadable(path, "no map of posecal recalibrate fit, or not a whole one."):
        about: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
        if about["format"] != FORMAT:
            raise PoseFileError(f"{name}: format {about['format']}; expected {FORMAT}. Fit it again.")
        if about["digest"] != _digest(about):
            raise PoseFileError(f"{name}: was changed since posecal wrote it (its digest is another). Fit it again.")
        numbers = about[{"spread": "factors", "radius": "radii"}[about["kind"]]]
        values = np.array([math.nan if value is None else float(value) for value in numbers.values()])
        root = _root(about["root"], tuple(numbers))
        unit, _ = quantity({"mm": "mm", "deg": "deg", "px": "px", "none": "none"}[about["unit"]])
        fitted = int(about["fitted_on"]["poses"]), int(about["fitted_on"]["sequences"]), root, unit
        if about["kind"] == "spread":
            if not (np.isfinite(values) & (values > 0)).all():
                raise PoseFileError(f"{name}: a factor is not above 0; expected positive numbers.")
            modal = tuple(map(str, about["about_modes"]))
            if not set(modal) <= set(numbers):
                raise PoseFileError(f"{name}: about_modes names joints without a factor; expected joints of the map.")
            changes = {str(metric): (float(a), float(b)) for metric, (a, b) in about["changes"].items()}
            hashes = [int(text, 16) for text in about.get("fitted_hashes", "").split()]  # of files before: none
            fitted_on = smallest_hashes(np.array(hashes, dtype=np.uint64))
            return SpreadMap(tuple(numbers), values, *fitted, modal=modal, changes=changes, fitted_on=fitted_on)
        alpha, scaled = float(about["alpha"]), {False: False, True: True}[about["scaled"]]
        if (values < 0).any() or np.isinf(values).any() or not 0 < alpha < 1:
            raise PoseFileError(f"{name}: a radius is below 0 or alpha is {alpha:g}; expected 0 < alpha < 1.")
        return RadiusMap(tuple(numbers), values, alpha, scaled, *fitted)


def _root(text: str | None, joints: tuple[str, ...]) -> AnyRoot:
    try:
        return None if text is None else parse_root(text, joints)
    except PoseDataError as error:
        raise ValueError(error.message) from None


def apply_map(
    map_: Map,
    hypotheses: Source,
    path: str | os.PathLike[str],
    /,
    *,
    axes: str | None = None,
    unit: str | float | None = None,
    joints: str | tuple[str, ...] | None = None,
    root_joint: str | int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> int:
    """Apply a map to hypotheses, into a file that posecal reads; some poses at a time, whole or not at all.

    Parameters
    ----------
    map_ : SpreadMap or RadiusMap
        The map.
    hypotheses : array or path
        What it is applied to.
    path : path
        An ``.npz`` file: ``hypotheses`` (M, N, K, D), or ``centre`` (M, K, D) and ``radius`` (M, K), in mm, degrees,
        pixels or no unit; and whatever else the file of the hypotheses says about their frames.
    axes, unit, joints, root_joint
        Of hypotheses that don't declare them; as for :class:`posecal.PoseData`.
    progress : callable, optional
        Called with the number of poses that are done, and with the number of all.

    Returns
    -------
    int
        M, the number of poses.

    Raises
    ------
    PoseDataError
        Where the map lacks a joint or is of another quantity, for declarations that don't fit, and for hypotheses that
        an evaluation would refuse too.
    PoseFileError
        Where a file can't be read or written.
    """
    values = np.array([*_checked(map_).by_joint.values()])
    if root_joint is None and isinstance(map_.root, Root):  # which one pose can't show
        root_joint = root_name(map_.root, map_.joints)
    declared = Declarations(axes=axes, unit=unit, joints=joints, root_joint=root_joint)
    poses = read_poses(hypotheses, "hypotheses")
    source, names, root = resolve_hypotheses(poses, declared)
    refuse_another_unit(poses.name, quantity_of(poses, "unit", unit)[0], map_.data_unit)
    values = values_for_joints(map_.joints, values, names, poses.name)
    about_modes = None
    if isinstance(map_, SpreadMap):
        about_modes = values_for_joints(map_.joints, map_.about_modes, names, poses.name)
    valid = poses.valid if poses.valid is None or poses.valid.ndim == 2 else poses.valid[:, None]
    first, m, period = source.read(0, 1), len(source.rows), PERIODS.get(map_.data_unit)
    n, _, k, d = first.shape
    if poses.weights is not None:
        weights = poses_last(poses.weights, (n, m), source.layout.text, f"{poses.name}: weights")
        refuse_weights(weights, poses.name)
        refuse_absent(weights, poses.name)
    window = max(1, WINDOW_BYTES // first.nbytes)

    def windows() -> Iterator[FloatArray]:
        for start in range(0, m, window):
            stop = min(start + window, m)
            part = source.read(start, stop)
            refuse_unusable(poses.name, part, None if valid is None else valid[start:stop], start)
            yield part
            if progress is not None:
                progress(stop, m)

    def write(file: BinaryIO) -> None:
        members = {"joints": np.array(names), "unit": np.array(map_.data_unit or "none"), **poses.frame_members}
        with Archive(file) as archive:
            if isinstance(map_, SpreadMap):
                pieces = (rescaled(part, values, root, period, about_modes).swapaxes(0, 1) for part in windows())
                archive.add_pieces("hypotheses", (m, n, k, d), first.dtype, pieces)
                members["axes"] = np.array("MNKD")
                known = [some for some in (map_.fitted_on, poses.recalibrated_on) if some is not None]
                members["recalibrated_on"] = smallest_hashes(np.concatenate(known))
            else:
                parts = [balls(part, values, root, scaled=map_.scaled, period=period) for part in windows()]
                members["centre"], members["radius"] = map(np.concatenate, zip(*parts, strict=True))
                members["alpha"] = np.array(map_.alpha)
            for name, array in members.items():
                archive.add(name, array)

    write_file(path, write)
    return m
