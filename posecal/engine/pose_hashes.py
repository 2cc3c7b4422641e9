"""Hashes of true poses, by which shards of one test set find the poses that they share."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.clips import given_labels
from posecal.data.fitted_poses import FEWEST_COORDINATES, pose_words, row_hashes
from posecal.data.pose_data import PoseData
from posecal.data.remarks import Count, Remark
from posecal.data.stored_poses import Labels
from posecal.engine.cells import SPREAD
from posecal.engine.sums import slices

PoseHashes = npt.NDArray[np.uint64]

MOST_HASHES = 65_536
"""Of more poses the smallest hashes are kept: what two sets share is then found by a sample of it."""

_MOST_PARTS = 1000

_OF_FRAMES = np.uint64(0x9E3779B97F4A7C15)
"""An odd number that tells names of frames from labels."""


def pose_hashes(truth: FloatArray, labels: Labels, frame_id: npt.NDArray[np.str_] | None) -> PoseHashes:
    """Hash the poses, (M, 2): truth and labels of each, and the name of its frame, 0 where it has none.

    Poses of few coordinates, of which many may be equal, have 0 alone unless their frames have names.
    """
    hashes = np.zeros((len(truth), 2), dtype=np.uint64)
    if truth[0].size < FEWEST_COORDINATES and frame_id is None:
        return hashes
    hashes[:, 0] = row_hashes(pose_words(truth))
    for name, values in labels.items():
        hashes[:, 0] += _hash_of_label(name, values)
    if frame_id is not None:
        hashes[:, 1] = row_hashes(frame_id)
    return hashes


def pose_keys(data: PoseData) -> npt.NDArray[np.uint64]:
    """Give a number of each pose, (M,), by its truth, labels and the name of its frame, whatever it comes with.

    Numbers of clips, which follow from their place, are no such labels.
    """
    keys = np.zeros(len(data.truth), dtype=np.uint64)
    for part in slices(len(keys), data.truth[:1].nbytes):
        keys[part] = row_hashes(pose_words(data.truth[part]))
    for name, values in given_labels(data).items():
        keys += _hash_of_label(name, values)
    if data.has_frame_id:
        keys += row_hashes(data.frame_id) * _OF_FRAMES
    return keys


def are_told_apart(data: PoseData) -> bool:
    """Whether poses whose keys are equal are the same ones: not those of few coordinates, of frames without names."""
    return data.has_frame_id or data.truth[0].size >= FEWEST_COORDINATES


def add_hashes(parts: list[PoseHashes], more: PoseHashes) -> None:
    """Add the hashes of more poses; after many parts they are put together."""
    parts.append(more)
    if len(parts) > _MOST_PARTS:
        parts[:] = [smallest_hashes(parts)]


def smallest_hashes(parts: Sequence[PoseHashes]) -> PoseHashes:
    """Put hashes other than 0 together, in ascending order; of more than :data:`MOST_HASHES` the smallest."""
    hashes = np.concatenate([np.zeros((0, 2), dtype=np.uint64), *parts])
    hashes = hashes[hashes.any(axis=1)]
    if len(hashes) > MOST_HASHES:  # most of many need not be sorted
        hashes = hashes[hashes[:, 0] <= np.partition(hashes[:, 0], MOST_HASHES)[MOST_HASHES]]
    return hashes[np.lexsort(hashes.T[::-1])][:MOST_HASHES]


def repeated_remarks(hashes: PoseHashes, poses: int, name: str) -> list[str]:
    """Remark on poses, by the sorted hashes of all or of a sample, that equal another in truth, labels and frame.

    Nothing is said where most do, as where cameras without a label see one moment.
    """
    number, repeated = len(hashes), int((hashes[1:] == hashes[:-1]).all(axis=1).sum())
    if not 0 < repeated < number / 2:
        return []
    is_sample = number == MOST_HASHES < poses
    return [
        Remark(
            f"{name}: {'about ' * is_sample}",
            Count(round(repeated * poses / number) if is_sample else repeated, "frame", of=poses),
            " with truth and labels of another count twice. Were they repeated to fill a batch? Leave them out, or "
            "give all frames a frame_id.",
        )
    ]


def dropped_remarks(number: int) -> list[str]:
    """Remark on poses that were dropped because frames of their names came before."""
    more = " came more than once, by frame_id; each frame is counted once."
    return [Remark(Count(number, "pose"), more)] if number else []


def shared_poses(parts: Sequence[PoseHashes]) -> tuple[int, int, int]:
    """Find the first two sets that share poses.

    Poses that equal others of their own set, as those of cameras that see one moment do, are not looked at.

    Parameters
    ----------
    parts : sequence of array (H, 2)
        The sorted hashes of each set.

    Returns
    -------
    first, second, number : int
        The two sets and how many poses they share; 0 where no two do.
    """
    alone = [_without_repeated(part) for part in parts]
    hashes, part = np.concatenate(alone), np.repeat(np.arange(len(alone)), [len(some) for some in alone])
    if np.unique(hashes[:, 0]).size == len(hashes):
        return 0, 0, 0
    order = np.lexsort((part, hashes[:, 1], hashes[:, 0]))
    hashes, part = hashes[order], part[order]
    (pose, frame), (next_pose, next_frame) = hashes[:-1].T, hashes[1:].T
    same = (pose == next_pose) & (part[1:] != part[:-1]) & ((frame == next_frame) | (frame == 0))
    pairs = np.sort(np.stack([part[:-1][same], part[1:][same]]), axis=0)
    if not pairs.size:
        return 0, 0, 0
    first, second = min(zip(*pairs.tolist(), strict=True))
    return first, second, int(((pairs[0] == first) & (pairs[1] == second)).sum())


def _without_repeated(hashes: PoseHashes) -> PoseHashes:
    equal = (hashes[1:] == hashes[:-1]).all(axis=1)
    is_alone = np.ones(len(hashes), dtype=bool)
    is_alone[1:][equal] = is_alone[:-1][equal] = False
    return hashes[is_alone]


def _hash_of_label(name: str, values: npt.NDArray[np.str_]) -> npt.NDArray[np.uint64]:
    if SPREAD.match(name):  # of the hypotheses
        return np.zeros(len(values), dtype=np.uint64)
    return row_hashes(values) * np.uint64(2 * zlib.crc32(name.encode(errors="surrogatepass")) + 1)
