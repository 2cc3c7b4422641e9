"""Conversion: read files, put them together, and write the file that posecal reads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posecal.conversion.containers import CONTAINERS
from posecal.conversion.documents import BY_NUMBER, NoPersonError, left_out, read_json
from posecal.conversion.tables import read_csv, read_trc
from posecal.conversion.tracks import Tracks
from posecal.data.arrays import BoolArray, FloatArray
from posecal.data.joint_names import joint_keys
from posecal.data.layout import Layout, MemoryArray
from posecal.data.units import quantity
from posecal.data.write import write_file, write_members
from posecal.errors import (
    PoseDataError,
    PoseFileError,
    attempt,
    did_you_mean,
    first_few,
    for_python,
    option,
    raise_all,
    refuse_unreadable,
)

TEXTS: dict[str, Callable[[Path, str], Tracks]] = {".csv": read_csv, ".tsv": read_csv, ".trc": read_trc}

FORMATS: dict[str, str] = {
    "wide": "CSV, a row per frame, columns Hip_x, Hip_y, Hip_z, …",
    "long": "CSV, a row per frame and joint, columns frame, joint, x, y, z and perhaps hypothesis, sequence",
    "angles": "CSV, a row per frame, columns frame, percent or time, an angle each, and perhaps hypothesis, trial",
    "deeplabcut": "DeepLabCut: .csv or .h5 with the rows scorer, bodyparts, coords",
    "anipose": "Anipose: .csv with Hip_x, Hip_y, Hip_z, Hip_error, Hip_score, …",
    "freemocap": "FreeMoCap: .csv with a row per frame",
    "mediapipe": "MediaPipe: .csv with x, y, z and visibility of each landmark",
    "openpose": "OpenPose: .json of a frame",
    "panoptic": "CMU Panoptic: .json of a frame, joints19",
    "interhand": "InterHand2.6M: .json of world coordinates",
    "mmpose": "mmpose: .npz of a data set, or .json of results",
}
"""What ``like`` names, beside the formats that the ending of a file tells: .trc, .c3d, .mat, .h5, .pt, .pkl, .npz."""

_ENDINGS = {
    "deeplabcut": (".csv", ".h5", ".hdf5"),
    "openpose": (".json",),
    "panoptic": (".json",),
    "interhand": (".json",),
    "mmpose": (".json", ".npz"),
}
"""Endings of the files of what ``like`` names; those of other tables are text."""

_OF_HYPOTHESES = ("scores", "weights")


def convert(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str] | None = None,
    *,
    like: str | None = None,
    role: Literal["truth", "hypotheses"] | None = None,
    each_file: Literal["frames", "hypothesis"] | None = None,
    dataset: str | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
    joints: str | Sequence[str] | None = None,
    fps: float | None = None,
    person: str | int | None = None,
    words: Callable[[str], str] = for_python,
) -> tuple[dict[str, Any], list[str]]:
    """Convert files of another tool into the members of the file that posecal reads.

    Parameters
    ----------
    files : path or sequence of paths
        Files of one format: the frames of one recording, or one hypothesis each.
    output : path, optional
        The ``.npz`` file to write.
    like : str, optional
        A name of the table in :doc:`/convert`, where the file does not show of which tool it is.
    role : str, optional
        ``truth`` or ``hypotheses``; by default hypotheses where there are several of a frame.
    each_file : str, optional
        What each of several files holds: more ``frames``, or one ``hypothesis`` of the same frames. By default frames
        where each file holds one.
    dataset : str, optional
        The array to read, of a file with several.
    axes : str, optional
        The layout of an array of a ``.mat``, ``.h5``, ``.pt``, ``.pkl`` or ``.npz`` file, such as ``MKD`` or ``M(KD)``.
    unit, joints, fps
        What the file does not state.
    person : str or int, optional
        One of several people in each frame of a ``.json`` file: its ``id`` or ``track_id`` in the file, or else
        its place in the list.
    words : callable
        How options are named in what was assumed: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.

    Returns
    -------
    members : dict
        Arrays by name, as :doc:`/file-format` lists them.
    assumed : list of str
        What was assumed because the file does not say it.

    Raises
    ------
    PoseDataError
        For files that are not what they should be, that don't fit together, or that contradict what is declared.
    PoseFileError
        For files that can't be read, or an output that can't be written.
    """
    paths = [Path(files)] if isinstance(files, str | os.PathLike) else [Path(path) for path in files]
    if like is not None and like not in FORMATS:
        raise PoseDataError(f"like: {like!r} is not known. {did_you_mean(like, FORMATS)}")
    if not paths:
        raise PoseDataError("files: none; expected at least one.")
    if output is not None and Path(output).suffix.lower() != ".npz":
        raise PoseFileError(f"{output}: {Path(output).suffix or 'no ending'}; expected a name that ends with .npz.")
    problems: list[Any] = []
    read = [attempt(problems, _read, path, like or "", dataset, axes, person) for path in paths]
    lacking = [problem for problem in problems if isinstance(problem, NoPersonError)]
    if len(problems) > len(lacking) or len(lacking) == len(paths) or each_file == "hypothesis":
        raise_all(problems)
    paths = [path for path, some in zip(paths, read, strict=True) if some is not None]
    tracks = [some for some in read if some is not None]
    first = tracks[0]
    poses, frame_id, assumed = _together(tracks, paths, each_file)
    if lacking:
        assumed.append(left_out(len(lacking), person))
    is_hypotheses = role == "hypotheses" or (role is None and poses.ndim == 4)
    if poses.ndim == 4 and not is_hypotheses:
        raise PoseDataError(f"role: truth for {len(poses)} poses of each frame; expected one, or hypotheses.")
    poses = poses[None] if is_hypotheses and poses.ndim == 3 else poses
    beside = first.beside if len(tracks) == 1 else {}
    unit = _declared("unit", unit, first.unit.strip().lower() or None, paths[0])
    known, n_absent = _known(poses)
    if "valid" in beside:
        known = known & (beside["valid"] if beside["valid"].ndim == 2 else beside["valid"][:, None]).astype(bool)
    names = _joint_names(joints, first, paths[0], poses.shape[-2])
    rate = _declared("fps", fps, first.fps or None, paths[0])
    members: dict[str, Any] = {
        "hypotheses" if is_hypotheses else "truth": poses.astype(np.float32 if is_hypotheses else np.float64),
        "axes": "NMKD" if is_hypotheses else "MKD",
        **({} if unit is None else {"unit": str(unit)}),
        **({} if names is None else {"joints": np.array(names)}),
        **({} if frame_id is None else {"frame_id": np.array(frame_id)}),
        **({} if rate is None else {"fps": float(rate)}),
        **({} if known.all() and (len(tracks) > 1 or first.confidence is None) else {"valid": known}),
        **(first.labels if len(tracks) == 1 else {}),
        **{word: value for word, value in beside.items() if word != "valid"},
    }
    if len(tracks) == 1 and first.confidence is not None:
        members["confidence"] = first.confidence
    assumed = [*dict.fromkeys([*(line for some in tracks for line in some.assumed), *assumed])]
    if joints is not None:
        assumed = [line for line in assumed if not line.startswith(BY_NUMBER)]
    what = f"{len(poses)} hypotheses" if is_hypotheses else "the truth"
    whose = "an angle" if poses.shape[-2:] == (1, 1) else f"{poses.shape[-2]} joints"
    assumed.append(f"{poses.shape[-3]:,} frames of {whose} are {what}")
    if unit is None:
        which = option("unit", "px") if poses.shape[-1] == 2 else option("unit")
        assumed.append(f"no unit is stated: evaluate takes mm, or refuses what can't be mm; {which} declares another")
    else:
        quantity(unit)
    if names is None:
        assumed.append("joints have no names")
    if not known.all():
        assumed.append(f"{(~known).sum():,} of {known.size:,} joints are not known (NaN), and not valid")
    if n_absent:
        assumed.append(f"{n_absent:,} of {poses.shape[0] * poses.shape[1]:,} hypotheses are absent from a frame (NaN)")
    if output is not None:
        arrays = {name: np.asarray(value) for name, value in members.items()}
        write_file(output, lambda file: write_members(file, arrays))
    return members, [words(line) for line in assumed]


def _read(path: Path, like: str, dataset: str | None, axes: str | None, person: str | int | None) -> Tracks:
    """Read a file by its ending."""
    ending = path.suffix.lower()
    if not path.is_file():
        raise PoseFileError(f"{path}: no such file.")
    if person is not None and ending != ".json":
        raise PoseDataError(f"person: {person} for {path.name}; expected a .json file of several people in a frame.")
    if like and ending not in _ENDINGS.get(like, (".csv", ".tsv")):
        raise PoseDataError(f"{path.name} is no file of {like}; expected {FORMATS[like]}. Leave {option('like')} out.")
    with refuse_unreadable(path):
        if ending == ".json":
            tracks = read_json(path, like, person)
        elif ending in TEXTS:
            tracks = TEXTS[ending](path, like)
        elif ending in CONTAINERS:
            tracks = CONTAINERS[ending](path, dataset)
        else:
            known = ", ".join([*TEXTS, ".json", *CONTAINERS])
            raise PoseDataError(f"{path.name}: a file {ending or 'without an ending'}; expected one of {known}.")
    if not tracks.poses.size:
        raise PoseDataError(f"{path.name}: nothing in it; its shape is {tracks.poses.shape}.")
    if not tracks.is_array and axes is not None:
        raise PoseDataError(f"{path.name} has no axes to declare; expected no {option('axes', axes)}. Leave it out.")
    if dataset is not None and ending not in CONTAINERS:
        raise PoseDataError(f"{path.name} holds no datasets; expected no {option('dataset', dataset)}. Leave it out.")
    if not tracks.is_array:
        return _without_unseen(tracks)
    shape, axes = tracks.poses.shape, _declared("axes", axes, tracks.axes or None, path)
    if ending in {".npz", ".npy"} and len(shape) == 3 and shape[2] == 4 and axes in {None, "MKD"}:
        axes = "MKC"
        tracks.assumed.append("the fourth column is a confidence")
    if axes is None and len(shape) == 4:
        choices = " or ".join(option("axes", text) for text in ("NMKD", "MNKD"))
        raise PoseDataError(f"{path.name}: an array {shape}, which does not say its order of axes. Pass {choices}.")
    text = axes or ("MKD" if len(shape) == 3 else "")
    if not text or (axes is None and shape[-1] not in {1, 2, 3}):
        raise PoseDataError(
            f"{path.name}: an array {shape}; expected (M, K, D), or its layout: {option('axes', 'M(KD)')}."
        )
    layout = Layout(text.replace("C", "D"), "NMKD" if "N" in text else "MKD")
    laid_out = layout.read(MemoryArray(tracks.poses), np.arange(layout.shape(shape)[-3]))
    tracks.poses = np.asarray(laid_out, dtype=np.float64)
    if "C" in text:
        tracks.poses, tracks.confidence = tracks.poses[..., :-1], tracks.poses[..., -1]
    if axes is None:
        tracks.assumed.append(f"an array {shape} is {text}")
    _keep_what_fits(tracks, is_transposed="N" in text and text.index("M") < text.index("N"))
    return _without_unseen(tracks)


def _keep_what_fits(tracks: Tracks, *, is_transposed: bool) -> None:
    """Keep what stands beside an array where it is of its frames, joints or hypotheses, as shapes show."""
    *n, m, k, _ = tracks.poses.shape
    shapes: dict[str, list[tuple[int, ...]]] = {
        "parents": [(k,)],
        "occluded": [(m, k)],
        "visible": [(m, k)],
        "valid": [(m, k), (m,)],
    }
    shapes |= dict.fromkeys(_OF_HYPOTHESES, [(m, *n) if is_transposed else (*n, m)] if n else [])
    others = {word: value for word, value in tracks.beside.items() if value.shape not in shapes.get(word, [(m,)])}
    tracks.beside = {word: value for word, value in tracks.beside.items() if word not in others}
    if is_transposed:
        tracks.beside |= {word: tracks.beside[word].T for word in _OF_HYPOTHESES if word in tracks.beside}
    if others:
        shown = first_few([f"{word} {value.shape}" for word, value in others.items()])
        tracks.assumed.append(f"what is not of its {m:,} frames or {k} joints is not converted: {shown}")


def _known(poses: FloatArray) -> tuple[BoolArray, int]:
    """Give the joints (M, K) that are known, and the number of hypotheses that are absent from a frame."""
    known = np.asarray(np.isfinite(poses).all(axis=-1))
    if poses.ndim == 3:
        return known, 0
    absent = np.asarray(np.isnan(poses).all(axis=(2, 3)))
    absent &= ~absent.all(axis=0)
    return np.asarray((known | absent[..., None]).all(axis=0)), int(absent.sum())


def _without_unseen(tracks: Tracks) -> Tracks:
    """Take joints without confidence as not known: tools write 0, or anything, where they saw none."""
    if tracks.confidence is not None and tracks.confidence.shape == tracks.poses.shape[:-1]:
        unseen = ~(tracks.confidence > 0)
        tracks.poses = np.where(unseen[..., None], np.nan, tracks.poses)
        if unseen.any():
            tracks.assumed.append("joints of a confidence of 0 or less are not known")
    return tracks


def _together(
    tracks: Sequence[Tracks], paths: Sequence[Path], each_file: str | None
) -> tuple[FloatArray, list[str] | None, list[str]]:
    """Put the poses of several files together: frame after frame, or hypothesis by hypothesis."""
    first = tracks[0]
    if len(tracks) == 1:
        return first.poses, [*first.frame_id] or None, []
    for path, some in zip(paths, tracks, strict=True):
        if list(some.joints) != list(first.joints) or some.poses.shape[-2:] != first.poses.shape[-2:]:
            raise PoseDataError(
                f"{path.name}: other joints than {paths[0].name}; expected the same, in the same order."
            )
        if (some.unit, some.fps) != (first.unit, first.fps):
            raise PoseDataError(f"{path.name}: another unit or frame rate than {paths[0].name}; expected the same.")
    single = all(len(some.poses) == 1 and some.poses.ndim == 3 for some in tracks)
    if each_file is None and not single:
        choices = " or ".join(option("each_file", value) for value in ("hypothesis", "frames"))
        raise PoseDataError(f"files: {len(tracks)} of several frames; expected what each is. Pass {choices}.")
    if each_file == "hypothesis":
        for path, some in zip(paths, tracks, strict=True):
            if some.poses.shape != first.poses.shape or list(some.frame_id) != list(first.frame_id):
                raise PoseDataError(f"{path.name}: other frames than {paths[0].name}; expected the same in every file.")
        return np.stack([some.poses for some in tracks]), [*first.frame_id] or None, []
    frames = [frame for path, some in zip(paths, tracks, strict=True) for frame in _frames(path, some)]
    if len({*frames}) < len(frames):
        raise PoseDataError(f"files: frames more than once (first: {first_few(frames)}); expected each frame once.")
    assumed = [] if each_file else [f"each of {len(tracks)} files is one frame"]
    return np.concatenate([some.poses for some in tracks]), frames, assumed


def _frames(path: Path, tracks: Tracks) -> list[str]:
    number = len(tracks.poses)
    if tracks.frame_id:
        return [f"{frame}" if number == 1 else f"{path.stem}/{frame}" for frame in tracks.frame_id]
    return [path.stem] if number == 1 else [f"{path.stem}/{frame}" for frame in range(number)]


def _declared(name: str, declared: Any, stored: Any, path: Path) -> Any:
    """Give what is declared, or what the file states; the two must not differ."""
    if declared is not None and stored is not None and str(declared) != str(stored):
        raise PoseDataError(f"{path.name} states {name} {stored}; expected no {option(name, declared)}. Leave it out.")
    return stored if declared is None else declared


def _joint_names(declared: str | Sequence[str] | None, tracks: Tracks, path: Path, size: int) -> Sequence[str] | None:
    """Give the names that are declared, or else the file's; where that has any itself, the two must not differ."""
    from posecal.data.skeleton import joint_set

    if declared is None:
        return tracks.joints or None
    names = joint_set(declared) if isinstance(declared, str) else tuple(declared)
    if len(names) != size:
        raise PoseDataError(f"joints: {len(names)} names for {size} joints; expected one each.")
    stored = tuple(tracks.joints)
    is_stated = any(not name[-1:].isdecimal() for name in stored)
    is_stated = is_stated and not any(line.startswith(BY_NUMBER) for line in tracks.assumed)
    if is_stated and joint_keys(names) != joint_keys(stored):
        what = option("joints", declared if isinstance(declared, str) else [*declared])
        raise PoseDataError(
            f"{path.name} names its joints itself ({first_few(stored)}); expected no {what}. Leave it out."
        )
    return names
