"""Tables of coordinates: CSV, wide or long, and those of DeepLabCut, Anipose, FreeMoCap and MediaPipe; TRC."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from posecal.conversion.tracks import AXES, Tracks, by_joint
from posecal.data.arrays import FloatArray
from posecal.errors import PoseDataError, first_few

_COLUMN = re.compile(r"^(?P<joint>.+?)(?:[\s_.:-]+|(?<=[a-z])(?=[XYZ])|(?<=\d))(?P<axis>[xyzXYZ])$")
_CONFIDENCE = re.compile(r"^(?P<joint>.+?)[\s_.:-]+(?:likelihood|confidence|score|visibility)$", re.IGNORECASE)
_SEEN = ("confidence", "likelihood", "visibility", "score")
_FRAME = ("frame", "frame_id", "frame_number", "fnum", "frames")
_CYCLE = ("percent", "time")
"""Names of the column of frames in tables of angles, beside those of others."""

_LABELS = ("sequence", "subject", "action", "camera")
_LONG = {"joint": ("joint", "keypoint", "bodypart", "marker", "landmark", "name"), "frame": _FRAME}


def read_csv(path: Path, like: str) -> Tracks:
    """Read a table with a row per frame, or with a row per frame and joint, of any of the tools above."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    first, second = [*text.splitlines(), "", ""][:2]
    how: dict[str, Any] = {"sep": max(",;\t", key=first.count)}
    if how["sep"] != "," and re.search(r"\d,\d", text):
        how["decimal"] = ","
    if like == "deeplabcut" or re.match(r"scorer[,;\t]", first):
        header = [1, 2, 3] if second.startswith("individuals") else [1, 2]
        return of_multiindex(_frame_of(text, path, header=header, index_col=0, **how), path.name)
    frame = _frame_of(text, path, **how)
    plain = {str(column).strip().lower(): column for column in frame.columns}
    if like == "angles":
        return _of_angles(frame, plain, path.name)
    joint = next((plain[word] for word in _LONG["joint"] if word in plain), None)
    is_long = joint is not None and {*AXES[:2]} <= {*plain}
    if like == "long" and not is_long:
        raise PoseDataError(f"{path.name}: no columns joint, x and y; expected those of a long table.")
    if like != "wide" and is_long:
        return _of_long(frame, plain, joint, path.name)
    return _of_wide(frame, plain, path.name)


def _frame_of(text: str, path: Path, **how: Any) -> Any:
    import pandas as pd

    widths = [len(row) for row in csv.reader(io.StringIO(text), delimiter=how["sep"]) if any(row)]
    usual = max(set(widths), key=widths.count, default=0)
    short = [number for number, width in enumerate(widths) if width != usual]
    if how["sep"] == "," and widths and min(widths[1:], default=0) > widths[0] + 1:
        raise PoseDataError(
            f"{path.name}: {usual} columns below {widths[0]} names; expected as many. Decimal commas? Write points, or "
            "semicolons between columns."
        )
    if short:
        raise PoseDataError(
            f"{path.name}: {len(short):,} of {len(widths):,} rows have another number of columns (first: row "
            f"{short[0] + 1}); expected as many in each. Was the file cut off?"
        )
    try:
        frame: Any = pd.read_csv(io.StringIO(text), skipinitialspace=True, **how)
    except (ValueError, pd.errors.ParserError, IndexError) as error:
        raise PoseDataError(f"{path.name}: is no table of numbers ({str(error).splitlines()[0]}).") from None
    if frame.empty:
        raise PoseDataError(f"{path.name}: no rows; expected one for each frame.")
    return frame


def _numbers(column: Any, name: str, what: Any) -> FloatArray:
    import pandas as pd

    found: FloatArray = pd.to_numeric(column, errors="coerce").to_numpy(np.float64)
    bad = np.isnan(found) & pd.Series(column).notna().to_numpy()
    if bad.any():
        first = pd.Series(column).iloc[int(np.argmax(bad))]
        raise PoseDataError(f"{name}: column {what} holds {first!r}; expected numbers, empty where one is not known.")
    return found


def _of_wide(frame: Any, plain: dict[str, Any], name: str) -> Tracks:
    columns: dict[tuple[str, str], FloatArray] = {}
    confidence: dict[str, FloatArray] = {}
    passed = []
    for column in frame.columns:
        text = str(column).strip()
        if match := _CONFIDENCE.match(text):
            confidence[match["joint"]] = _numbers(frame[column], name, column)
        elif (match := _COLUMN.match(text)) and text.lower() not in _FRAME:
            columns[match["joint"], match["axis"].lower()] = _numbers(frame[column], name, column)
        elif text.lower() not in _FRAME:
            passed.append(text)
    joints, poses = by_joint(columns, name)
    frames: list[str] = next((_frame_names(frame[plain[word]]) for word in _FRAME if word in plain), [])
    assumed = [f"columns {first_few(passed)} are no coordinates and were left out"] if passed else []
    shown = np.stack([confidence[joint] for joint in joints], axis=1) if {*joints} <= {*confidence} else None
    return Tracks(poses, joints, frame_id=frames, confidence=shown, assumed=assumed)


def _of_long(frame: Any, plain: dict[str, Any], joint: Any, name: str) -> Tracks:
    import pandas as pd

    number = next((plain[word] for word in _FRAME if word in plain), None)
    if number is None:
        raise PoseDataError(f"{name}: no column frame; expected one beside {joint} and the coordinates.")
    if "sequence" in plain and (frame.groupby(number)[plain["sequence"]].nunique() > 1).any():
        frame[number] = frame[plain["sequence"]].astype(str) + "/" + pd.Series(_frame_names(frame[number]))
    draw = next((plain[word] for word in ("hypothesis", "sample") if word in plain), None)
    axes = [axis for axis in AXES if axis in plain]
    keys = [key for key in (draw, number, joint) if key is not None]
    repeated = frame.duplicated(keys)
    if repeated.any():
        row = int(np.argmax(repeated.to_numpy()))
        which = ", ".join(f"{key} {frame[key][row]}" for key in keys)
        raise PoseDataError(f"{name}: row {row + 2} repeats a joint of its frame ({which}); expected each once.")
    for axis in axes:
        frame[plain[axis]] = _numbers(frame[plain[axis]], name, axis)
    seen = next((plain[word] for word in _SEEN if word in plain), None)
    if seen is not None:
        frame.loc[~(_numbers(frame[seen], name, seen) > 0), [plain[axis] for axis in axes]] = np.nan
    frames, joints = pd.unique(frame[number]), pd.unique(frame[joint].astype(str))
    draws = [None] if draw is None else list(pd.unique(frame[draw]))
    index = pd.MultiIndex.from_product([frames, joints])
    parts = [
        (frame if each is None else frame[frame[draw] == each])
        .assign(_joint=frame[joint].astype(str))
        .set_index([number, "_joint"])[[plain[axis] for axis in axes]]
        .reindex(index)
        .to_numpy(np.float64)
        .reshape(len(frames), len(joints), len(axes))
        for each in draws
    ]
    poses = parts[0] if draw is None else np.stack(parts)
    labels: dict[str, Any] = {
        word: np.array(frame.groupby(number, sort=False)[plain[word]].first().astype(str).tolist())
        for word in _LABELS
        if word in plain
    }
    return Tracks(poses, list(joints), frame_id=_frame_names(frames), labels=labels)


def _of_angles(frame: Any, plain: dict[str, Any], name: str) -> Tracks:
    """Read a table with a row per frame, or per frame and hypothesis, and a column for each angle."""
    number = next((plain[word] for word in (*_FRAME, *_CYCLE) if word in plain), None)
    if number is None:
        raise PoseDataError(f"{name}: no column {', '.join(_CYCLE)} or frame; expected one beside the angles.")
    for two in (("trial", "sequence"), ("sample", "hypothesis")):
        if {*two} <= {*plain}:
            raise PoseDataError(f"{name}: columns {' and '.join(two)}; expected one of them.")
    names = {plain[word]: word for word in (*_LABELS, "hypothesis", "sample") if word in plain}
    names |= {plain["trial"]: "sequence"} if "trial" in plain else {}
    names |= {number: "frame"}
    times = {plain[word] for word in (*_FRAME, *_CYCLE) if word in plain}
    left_out = [c for c in frame.columns if c not in names and (c in times or str(c).startswith("Unnamed:"))]
    frame = frame.drop(columns=left_out)
    angles = {column: _numbers(frame[column], name, column) for column in frame.columns if column not in names}
    table = (
        frame.assign(**angles).rename(columns=names).melt(id_vars=[*names.values()], var_name="joint", value_name="x")
    )
    if table.empty:
        raise PoseDataError(f"{name}: no column of an angle; expected some beside {first_few([*names])}.")
    tracks = _of_long(table, {word: word for word in table.columns}, "joint", name)
    if left_out:
        tracks.assumed.append(f"columns {first_few(left_out)} are no angles and were left out")
    return tracks


def _frame_names(values: Any) -> list[str]:
    """Name frames; whole numbers are written without a decimal point."""
    return [str(int(value)) if isinstance(value, float) and value.is_integer() else str(value) for value in values]


def of_multiindex(frame: Any, name: str) -> Tracks:
    """Read a table whose columns are named by body part and coordinate, as those of DeepLabCut and Anipose."""
    animals = list(dict.fromkeys(str(column[-3]) for column in frame.columns if len(column) > 2))
    if len(animals) > 1:
        raise PoseDataError(
            f"{name}: a table of {len(animals)} animals ({first_few(animals)}); expected one. Keep the columns of one."
        )
    columns: dict[tuple[str, str], FloatArray] = {}
    confidence: dict[str, FloatArray] = {}
    for column in frame.columns:
        joint, what = map(str, column[-2:])
        target = confidence if what in {"likelihood", "score"} else columns if what in AXES else None
        if target is confidence:
            confidence[joint] = _numbers(frame[column], name, column)
        elif target is columns:
            columns[joint, what] = _numbers(frame[column], name, column)
    joints, poses = by_joint(columns, name)
    shown = np.stack([confidence[joint] for joint in joints], axis=1) if {*joints} <= {*confidence} else None
    return Tracks(poses, joints, unit="px" if poses.shape[2] == 2 else "", confidence=shown)


def read_trc(path: Path, _like: str) -> Tracks:
    """Read the tracks of OpenSim and Pose2Sim: a head of five lines, tabs between numbers."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if len(lines) < 6 or "DataRate" not in lines[1]:
        raise PoseDataError(
            f"{path.name}: no head of a .trc file; expected DataRate, Units and markers in its first lines."
        )
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    joints = [word.strip() for word in lines[3].split("\t")[2:] if word.strip()]
    rows = [line.rstrip("\n").split("\t") for line in lines[5:] if line.strip()]
    width = 2 + 3 * len(joints)
    try:
        values = np.array(
            [[float(cell) if cell.strip() else np.nan for cell in (row + [""] * width)[:width]] for row in rows]
        )
        fps = float(head["DataRate"])
    except (ValueError, KeyError) as error:
        raise PoseDataError(f"{path.name}: {error}; expected numbers between tabs, and a DataRate.") from None
    other = [row for row in rows if len(row) not in {width, width + 1}]
    if other:
        raise PoseDataError(f"{path.name}: {len(other[0])} columns for {len(joints)} markers; expected {width}.")
    if head.get("NumFrames", "").isdigit() and len(rows) != int(head["NumFrames"]):
        raise PoseDataError(
            f"{path.name}: {len(rows):,} of {head['NumFrames']} frames are there. Was the file cut off?"
        )
    frames = [str(int(number)) for number in values[:, 0]]
    return Tracks(values[:, 2:].reshape(len(rows), len(joints), 3), joints, head.get("Units", "").strip(), fps, frames)
