"""Recalibration maps in small JSON files, and their application to files of hypotheses."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

import posecal
from posecal.data.arrays import FloatArray
from posecal.data.stored_poses import Hypotheses
from posecal.data.write import Archive, write_file
from posecal.engine.chunks import WINDOW_BYTES
from posecal.errors import PoseFileError
from posecal.recalibration.dispersion import SpreadMap, rescaled
from posecal.recalibration.folds import values_for_joints
from posecal.recalibration.radius import RadiusMap, balls

FORMAT = 2
"""The version of the file format."""

Map = SpreadMap | RadiusMap


def write_map(map_: Map, path: str | os.PathLike[str]) -> None:
    """Write a map as JSON, whole or not at all.

    Raises
    ------
    PoseFileError
        Where the file can't be written.
    """
    about: dict[str, object] = {"posecal": posecal.__version__, "format": FORMAT}
    if isinstance(map_, SpreadMap):
        about |= {"kind": "spread", "factors": _by_joint(map_.joints, map_.factors)}
    else:
        unit = "standard deviations" if map_.scaled else "mm"
        about |= {"kind": "radius", "alpha": map_.alpha, "unit": unit, "radii": _by_joint(map_.joints, map_.radii)}
    about["root"] = None if map_.root is None else map_.joints[map_.root]
    about["fitted_on"] = {"poses": map_.poses, "sequences": map_.sequences}
    text = json.dumps(about, indent=1, ensure_ascii=False) + "\n"
    write_file(path, lambda file: file.write(text.encode()))


def _by_joint(joints: tuple[str, ...], values: FloatArray) -> dict[str, float | None]:
    return {joint: None if math.isnan(v) else float(v) for joint, v in zip(joints, values, strict=True)}


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
        For a file that can't be read or is no map of this version.
    """
    name = Path(path).name
    try:
        about: Any = json.loads(Path(path).read_text(encoding="utf-8"))
        if about["format"] != FORMAT:
            raise PoseFileError(f"{name}: format {about['format']}; expected {FORMAT}. Fit it again.")
        numbers = about[{"spread": "factors", "radius": "radii"}[about["kind"]]]
        values = np.array([math.nan if value is None else float(value) for value in numbers.values()])
        root = None if about["root"] is None else list(numbers).index(about["root"])
        fitted = int(about["fitted_on"]["poses"]), int(about["fitted_on"]["sequences"]), root
        if about["kind"] == "spread":
            if not (np.isfinite(values) & (values > 0)).all():
                raise PoseFileError(f"{name}: a factor is not above 0; expected positive numbers.")
            return SpreadMap(tuple(numbers), values, *fitted)
        alpha, scaled = float(about["alpha"]), {"mm": False, "standard deviations": True}[about["unit"]]
        if (values < 0).any() or np.isinf(values).any() or not 0 < alpha < 1:
            raise PoseFileError(f"{name}: a radius is below 0 or alpha is {alpha:g}; expected 0 < alpha < 1.")
        return RadiusMap(tuple(numbers), values, alpha, scaled, *fitted)
    except FileNotFoundError:
        raise PoseFileError(f"{path}: no such file.") from None
    except PoseFileError:
        raise
    except OSError as error:
        raise PoseFileError(f"{path}: can't be read ({error.strerror}).") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise PoseFileError(f"{name}: no map of posecal recalibrate fit, or not a whole one.") from None


def apply_map(
    map_: Map,
    hypotheses: Hypotheses,
    joints: tuple[str, ...],
    root: int | None,
    n_poses: int,
    path: str | os.PathLike[str],
    members: Mapping[str, npt.NDArray[np.generic]],
    progress: Callable[[int], object] | None = None,
) -> None:
    """Apply a map to hypotheses, into a file that posecal reads; some poses at a time, whole or not at all.

    Parameters
    ----------
    map_ : SpreadMap or RadiusMap
        The map.
    hypotheses : Hypotheses
        What it is applied to.
    joints : tuple of str
        Their joints.
    root : int or None
        The joint that spreads are relative to.
    n_poses : int
        M.
    path : path
        An ``.npz`` file: ``hypotheses`` (M, N, K, D), or ``centre`` (M, K, D) and ``radius`` (M, K), mm.
    members : mapping of arrays
        What else goes into the file: :attr:`posecal.data.stored_poses.StoredPoses.frame_members`, say.
    progress : callable, optional
        Called with the number of poses that are done.

    Raises
    ------
    PoseDataError
        Where the map lacks a joint.
    PoseFileError
        Where the file can't be written.
    """
    first = hypotheses.read(0, 1)
    n, _, k, d = first.shape
    values = map_.factors if isinstance(map_, SpreadMap) else map_.radii
    values = values_for_joints(map_.joints, values, joints, "hypotheses")
    window = max(1, WINDOW_BYTES // (n * k * d * first.dtype.itemsize))

    def windows() -> Iterator[FloatArray]:
        for start in range(0, n_poses, window):
            stop = min(start + window, n_poses)
            yield hypotheses.read(start, stop)
            if progress is not None:
                progress(stop)

    def write(file: BinaryIO) -> None:
        with Archive(file) as archive:
            common = {"joints": np.array(joints), "unit": np.array("mm"), **members}
            if isinstance(map_, SpreadMap):
                parts = (rescaled(found, values, root).swapaxes(0, 1) for found in windows())
                archive.add_pieces("hypotheses", (n_poses, n, k, d), first.dtype, parts)
                common["axes"] = np.array("MNKD")
            else:
                found = [balls(found, values, root, scaled=map_.scaled) for found in windows()]
                common["centre"] = np.concatenate([centre for centre, _ in found])
                common["radius"] = np.concatenate([radius for _, radius in found])
                common["alpha"] = np.array(map_.alpha)
            for name, array in common.items():
                archive.add(name, array)

    write_file(path, write)
