"""JSON of OpenPose, Panoptic, InterHand2.6M and mmpose, or of nested lists."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from posecal.conversion.tracks import Tracks
from posecal.data.arrays import FloatArray
from posecal.data.remarks import Count
from posecal.data.skeleton import JOINT_SETS
from posecal.errors import PoseDataError, attempt, first_few, option, refuse_unreadable

BY_NUMBER = "joints are those of "
"""How a line begins that says which joints a file means that does not name them."""


class NoPersonError(PoseDataError):
    """A frame without people, or without the one that is asked for."""


def left_out(number: int, person: str | int | None) -> str:
    """Say how many frames are left out for want of a person."""
    return f"left out: {Count(number, 'frame')} without {'people' if person is None else f'person {person}'}"


def read_json(path: Path, like: str, person: str | int | None = None) -> Tracks:
    """Read a document of one of the tools above, as its keys say; of several people in a frame, the one asked for."""
    with refuse_unreadable(path, "is no JSON ({})."):
        document = json.loads(path.read_text(encoding="utf-8"))
    readers = {"openpose": _openpose, "panoptic": _panoptic, "mmpose": _mmpose, "interhand": _interhand}
    found = like if like in readers else _kind(document)
    if person is not None and found in ("lists", "interhand"):
        raise PoseDataError(f"person: {person} for {path.name}, which has one in each frame; expected none.")
    if found == "lists":
        return Tracks(_array(document, path.name), is_array=True)
    if found not in readers:
        keys = ", ".join([*document][:6]) if isinstance(document, dict) else type(document).__name__
        raise PoseDataError(
            f"{path.name}: holds {keys}; expected people, bodies, instance_info, frames, or nested lists."
        )
    with refuse_unreadable(path, f"is not as {found} writes it ({{}})."):
        return readers[found](document, path.name, person)


def _kind(document: Any) -> str:
    if isinstance(document, list):
        return "mmpose" if document and isinstance(document[0], dict) else "lists"
    if not isinstance(document, dict):
        return ""
    keys = {"people": "openpose", "bodies": "panoptic", "instance_info": "mmpose", "meta_info": "mmpose"}
    by_key = next((kind for key, kind in keys.items() if key in document), "")
    first = next(iter(document.values()), None)
    is_interhand = isinstance(first, dict) and any(isinstance(v, dict) and "world_coord" in v for v in first.values())
    return by_key or ("interhand" if is_interhand else "")


def _array(values: Any, name: str) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError):
        raise PoseDataError(
            f"{name}: lists of unequal lengths, or no numbers; expected the same joints in each frame."
        ) from None


def _one(people: list[Any], name: str, asked: str | int | None) -> Any:
    """Give the person of a frame: the only one, or the one asked for, by id, track_id or else place in the list."""
    known = [str(one.get("id", one.get("track_id", place))) for place, one in enumerate(people)]
    kind = next((key for key in ("id", "track_id") if people and key in people[0]), "place in the list")
    if not people:
        raise NoPersonError(f"{name}: 0 people in a frame; expected one.")
    if asked is not None:
        if str(asked) not in known:
            raise NoPersonError(f"{name}: no person {asked} in a frame; it holds {first_few(known)} (by {kind}).")
        return people[known.index(str(asked))]
    if len(people) > 1:
        raise PoseDataError(
            f"{name}: {len(people)} people in a frame; expected one. Pass {option('person', known[0])}, or another of "
            f"{first_few(known, 12)} (by {kind})."
        )
    return people[0]


def _openpose(document: Any, name: str, person: str | int | None) -> Tracks:
    one = _one(document["people"], name, person)
    for key, size in (("pose_keypoints_3d", 4), ("pose_keypoints_2d", 3)):
        if one.get(key):
            values = _array(one[key], name).reshape(1, -1, size)
            joint_set = {25: "body-25", 18: "coco-18"}.get(values.shape[1], "")
            assumed = [f"{BY_NUMBER}{joint_set}, by their number"] if joint_set else []
            joints = JOINT_SETS.get(joint_set, ())
            unit = "px" if size == 3 else ""
            return Tracks(values[..., :-1], joints, unit, confidence=values[..., -1], assumed=assumed)
    raise PoseDataError(f"{name}: no pose_keypoints_3d or pose_keypoints_2d; expected keypoints of the person.")


def _panoptic(document: Any, name: str, person: str | int | None) -> Tracks:
    values = _array(_one(document["bodies"], name, person)["joints19"], name).reshape(1, 19, 4)
    joints = JOINT_SETS["panoptic-19"]
    assumed = [f"{BY_NUMBER}panoptic-19", "lengths are in cm, as the data set has them"]
    frames = [str(document["frame"])] if "frame" in document else []
    return Tracks(values[..., :3], joints, "cm", confidence=values[..., 3], frame_id=frames, assumed=assumed)


def _mmpose(document: Any, name: str, person: str | int | None) -> Tracks:
    frames = document["instance_info"] if isinstance(document, dict) else document
    found = [frame.get("instances", frame) for frame in frames]
    seen = [m for m, some in enumerate(found) if some]
    if not seen:
        raise NoPersonError(f"{name}: no people in {len(frames)} frames; expected one in some.")
    problems: list[Any] = []
    each = [attempt(problems, _one, found[m] if isinstance(found[m], list) else [found[m]], name, person) for m in seen]
    serious = [problem for problem in problems if not isinstance(problem, NoPersonError)]
    if serious or len(problems) == len(seen):
        raise (serious or problems)[0]
    people = [one for one in each if one is not None]
    frame_id = [str(frames[m].get("frame_id", m)) for m, one in zip(seen, each, strict=True) if one is not None]
    assumed = [left_out(len(found) - len(people), person)] if len(people) < len(found) else []
    poses = _array([person["keypoints"] for person in people], name)
    scores = [person.get("keypoint_scores") for person in people]
    meta = document.get("meta_info", {}) if isinstance(document, dict) else {}
    named = meta.get("keypoint_id2name", {})
    joints = [str(named[key]) for key in sorted(named, key=int)] if named else []
    confidence = None if None in scores else _array(scores, name)
    unit = "px" if poses.shape[-1] == 2 else ""
    return Tracks(poses, joints, unit, confidence=confidence, frame_id=frame_id, assumed=assumed)


def _interhand(document: Any, name: str, _person: str | int | None) -> Tracks:
    captures = [
        (f"{capture}/{frame}", capture, entry)
        for capture, frames in document.items()
        for frame, entry in frames.items()
    ]
    poses = _array([entry["world_coord"] for _, _, entry in captures], name)
    seen = _array([np.reshape(entry["joint_valid"], -1) for _, _, entry in captures], name) > 0
    poses[~seen] = np.nan
    labels = {"sequence": np.array([capture for _, capture, _ in captures])}
    is_both = poses.shape[1] == 42
    joints, assumed = (JOINT_SETS["interhand-42"], [f"{BY_NUMBER}interhand-42"]) if is_both else ((), [])
    return Tracks(poses, joints, "mm", frame_id=[key for key, _, _ in captures], labels=labels, assumed=assumed)
