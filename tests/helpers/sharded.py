"""A world of video sequences, cut into shards in every way, and the difference between two reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal import PoseData, Report

JOINTS = ("Hip", "RHip", "RKnee", "LHip", "LKnee", "Spine", "Neck")
OPTIONS: dict[str, Any] = {"metrics": "all", "by": ["action", "predicted_spread"], "reference": "climatology"}
"""Every number that there is: rank tests, velocities, scores with climatology's skill, groups by label and spread."""

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Frames:
    """Hypotheses (N, M, K, 3) and truth (M, K, 3) of sequences, with their names."""

    hypotheses: Array
    truth: Array
    sequence: Array
    frame_id: Array

    def data(self, rows: Any = slice(None), *, has_names: bool = True, **options: Any) -> PoseData:
        labels = {"sequence": self.sequence[rows], "action": action_of(self.sequence[rows])}
        names = {"frame_id": self.frame_id[rows]} if has_names else {}
        given = {"unit": "mm", "axes": "NMKD", "joints": JOINTS, "labels": labels, **names, **options}
        return PoseData(self.hypotheses[:, rows], self.truth[rows], **given)

    def save(self, folder: Any, name: str, rows: Any = slice(None)) -> tuple[str, str]:
        """Write the files of a shard."""
        about: dict[str, Any] = {"unit": "mm", "joints": JOINTS, "frame_id": self.frame_id[rows]}
        labels = {"sequence": self.sequence[rows], "action": action_of(self.sequence[rows])}
        paths = str(folder / f"hyps-{name}.npz"), str(folder / f"gt-{name}.npz")
        np.savez(paths[0], hypotheses=self.hypotheses[:, rows], axes="NMKD", **about)
        np.savez(paths[1], truth=self.truth[rows], **labels, **about)
        return paths


def action_of(sequence: Array) -> Array:
    return np.array(["walk" if int(name.split()[1]) % 2 else "sit" for name in sequence])


def frames(M: int = 192, S: int = 16, N: int = 6, seed: int = 0, dtype: str = "f4") -> Frames:
    random = np.random.default_rng(seed)
    K = len(JOINTS)
    truth = random.normal(0, 200, (K, 3)) + np.cumsum(random.normal(0, 8, (M, K, 3)), axis=0)
    centre = truth + random.normal(0, 40, (M, K, 3))
    spread = random.uniform(20, 70, (M, 1, 1))
    hypotheses = centre + spread * random.normal(size=(N, M, K, 3))
    clip = np.arange(M) * S // M
    sequence = np.array([f"clip {s}" for s in clip])
    frame_id = np.array([f"clip {s}/{m:06d}.jpg" for m, s in enumerate(clip)])
    return Frames(hypotheses.astype(dtype), truth.astype(dtype), sequence, frame_id)


def cuts(M: int = 192, S: int = 16) -> dict[str, list[Array]]:
    """Shards of a sequence each, uneven ones, ones that cut sequences, and ones of every so manieth frame."""
    rows = np.arange(M)
    starts = [int(np.argmax(rows * S // M == s)) for s in range(1, S)]
    return {
        f"{S} of one sequence": np.split(rows, starts),
        "6 uneven": np.split(rows, [starts[0], *(starts[i] for i in (1, 2, 8, 12))]),
        "7 that cut sequences": np.split(rows, [M // 7 * i + i % 3 for i in range(1, 7)]),
        "5 strided": [rows[start::5] for start in range(5)],
    }


def largest_difference(one: Report, other: Report) -> tuple[int, float]:
    """Rows of two reports, which are of the same names, and the largest relative difference of a number."""
    left, right = one.table, other.table
    assert len(left) == len(right)
    largest = 0.0
    for column in left:
        if left[column].dtype.kind != "f":
            assert left[column].equals(right[column]), column
            continue
        a, b = left[column].to_numpy(), right[column].to_numpy()
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b), err_msg=str(column))
        largest = max(largest, float(np.nanmax(np.abs(a - b) / np.maximum(1, np.abs(a)), initial=0)))
    return len(left), largest
