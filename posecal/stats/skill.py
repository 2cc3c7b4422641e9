"""References of skill scores: climatology, which knows nothing of the image, or another model.

A skill score is 1 - S / S_ref for a score S and that of a reference: 0 is no better than the reference, 1 is perfect.
Climatology is the reference that anyone has: hypotheses sampled from the true poses of other sequences.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.data.joint_names import joint_keys
from posecal.data.pose_data import PoseData
from posecal.data.root import root_name
from posecal.data.stored_poses import Rows
from posecal.engine.pose_hashes import pose_keys
from posecal.errors import PoseDataError, checked_integer, checked_type, option

Keys = npt.NDArray[np.uint64]

MOST_POSES = 16_384
"""Of more complete poses climatology samples so many."""


@dataclass(frozen=True)
class ClimatologyPool:
    """True poses that climatology samples, which are found in parts of a test set and put together.

    Attributes
    ----------
    truth : array (P, K, D)
        Complete true poses, by sequence: all of them, or of more than :data:`MOST_POSES` those of the smallest keys.
    keys : array of int (P,)
        What tells the poses apart, see :func:`posecal.engine.pose_hashes.pose_keys`.
    sequences : array of str (P,)
        Their sequences; empty where each pose is its own.
    """

    truth: FloatArray
    keys: Keys
    sequences: npt.NDArray[np.str_]

    @classmethod
    def of(cls, data: PoseData, keys: Keys | None = None) -> ClimatologyPool:
        """Find the poses of pose data."""
        complete = np.isfinite(data.truth).all(axis=(1, 2))
        if data.where is not None:
            complete &= data.where.all(axis=1)
        keys = pose_keys(data) if keys is None else keys
        sequences = data.labels.get("sequence", np.full(len(keys), ""))
        return cls.joined([cls(data.truth[complete], keys[complete], sequences[complete])])

    @classmethod
    def joined(cls, pools: Sequence[ClimatologyPool]) -> ClimatologyPool:
        """Put the poses of several parts together."""
        keys = np.concatenate([pool.keys for pool in pools])
        sequences = np.concatenate([pool.sequences for pool in pools])
        some = np.argsort(keys, kind="stable")[:MOST_POSES]
        order = some[np.lexsort((keys[some], sequences[some]))]
        return cls(np.concatenate([pool.truth for pool in pools])[order], keys[order], sequences[order])

    @property
    def hash(self) -> str:
        """Equal where two hold the same poses."""
        return f"{zlib.crc32(np.ascontiguousarray(self.truth).tobytes()):08x}"

    def own(self, data: PoseData, keys: Keys) -> tuple[Rows, Rows]:
        """Find the poses that are no others to those of pose data: where these begin, and how many they are."""
        names = data.labels.get("sequence")
        stored, wanted = (self.keys, keys) if names is None else (self.sequences, names)
        first = np.searchsorted(stored, wanted)
        number = np.searchsorted(stored, wanted, side="right") - first
        return first, np.minimum(number, 1) if names is None else number  # else each pose is its own sequence


@dataclass(frozen=True)
class ClimatologySample:
    """Hypotheses sampled from true poses, as they are read; those of a pose by its key, whichever come with it.

    Attributes
    ----------
    pool : ClimatologyPool
        What is sampled.
    keys : array of int (M,)
        Of the poses.
    first, own : arrays of int (M,)
        Which poses of the pool are no others: where these begin, and how many they are.
    n_hypotheses : int
        N.
    """

    pool: ClimatologyPool
    keys: Keys
    first: Rows
    own: Rows
    n_hypotheses: int

    @property
    def hash(self) -> str:
        """Equal where two are drawn from the same true poses."""
        return self.pool.hash

    @property
    def itemsize(self) -> int:
        """Bytes of a coordinate."""
        return self.pool.truth.dtype.itemsize

    def read(self, start: int, stop: int) -> FloatArray:
        """Read some poses, (N, stop - start, K, D) in mm."""
        others = len(self.pool.keys) - self.own[start:stop]
        donors = (_uniform(self.keys[start:stop], self.n_hypotheses) * others).astype(np.intp)
        donors += np.where(donors >= self.first[start:stop], self.own[start:stop], 0)  # past one's own sequence
        hypotheses: FloatArray = self.pool.truth[donors]
        return hypotheses

    @classmethod
    def joined(cls, samples: Sequence[ClimatologySample]) -> ClimatologySample:
        """Put samples of one pool after one another."""
        members: dict[str, Any] = {
            name: np.concatenate([getattr(s, name) for s in samples]) for name in ("keys", "first", "own")
        }
        return replace(samples[0], **members)

    def select(self, poses: Rows) -> ClimatologySample:
        """Keep some poses, by their numbers."""
        return replace(self, keys=self.keys[poses], first=self.first[poses], own=self.own[poses])


def _uniform(keys: Keys, n: int) -> FloatArray:
    """Draw from [0, 1), (n, M): what SplitMix64 gives from each of M keys on."""
    state = keys + np.arange(1, n + 1, dtype=np.uint64)[:, None] * np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(((state ^ (state >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53)


def climatology(
    pairs: PoseData, n_hypotheses: int | None = None, seed: int = 0, *, pool: ClimatologyPool | None = None
) -> PoseData:
    """Replace the hypotheses by random true poses of other sequences.

    Parameters
    ----------
    pairs : PoseData
        M poses. Without sequences, any other pose may be sampled; never one that lacks a joint.
    n_hypotheses : int, optional
        How many; as many as there were by default.
    seed : int
        Of the generator.
    pool : ClimatologyPool, optional
        The poses that are sampled, where these are a part of the test set; those of ``pairs`` by default.

    Returns
    -------
    PoseData
        The same truth with other hypotheses.

    Raises
    ------
    PoseDataError
        Where there are no complete poses of other sequences, and for numbers that are none.

    Notes
    -----
    Of more than 16,384 complete poses so many are sampled, chosen at random. Choice and draws depend on the poses,
    their labels and the names of their frames, not on the files or the order in which these come.
    """
    checked_type(pairs, "pairs", PoseData)
    n = pairs.shape[0] if n_hypotheses is None else checked_integer(n_hypotheses, "n_hypotheses", 1)
    checked_integer(seed, "seed", 0)
    keys = pose_keys(pairs)
    pool = ClimatologyPool.of(pairs, keys) if pool is None else pool
    first, own = pool.own(pairs, keys)
    if (own == len(pool.keys)).any():
        sequences = {*pairs.labels.get("sequence", keys).tolist(), *(pool.sequences.tolist() or keys.tolist())}
        what = "one sequence" if len(sequences) == 1 else "too few true poses without missing joints"
        raise PoseDataError(
            f"{pairs.names[1]}: {what}; climatology samples complete poses of other sequences. Give another file of "
            f"hypotheses as the {option('reference')}."
        )
    sample = ClimatologySample(pool, keys ^ np.uint64(np.random.PCG64(seed).random_raw()), first, own, n)
    own_members: dict[str, Any] = {"scores": None, "weights": None, "log_prob": None, "dimensions": 0}  # of the model
    return pairs.replace(hypotheses=sample, **own_members, names=("climatology", pairs.names[1]), remarks=())


def with_reference(pairs: PoseData, reference: PoseData) -> PoseData:
    """Add the hypotheses of a reference to a model's, so that skills are reported with the metrics ``scores``.

    Parameters
    ----------
    pairs, reference : PoseData
        Of the model and of the reference, on the same poses.

    Returns
    -------
    PoseData
        The model's, with the reference.

    Raises
    ------
    PoseDataError
        Where the two are not over the same frames, joints, root and true poses, or the reference has one hypothesis or
        weights.
    """
    model, other = pairs.names[0], reference.names[0]
    if reference.shape[0] < 2:
        raise PoseDataError(f"{other}: N = 1; fair scores need at least 2. Give a reference with more hypotheses.")
    if reference.weights is not None:
        raise PoseDataError(f"{other}: has weights; expected a reference whose hypotheses all count alike.")
    if joint_keys(pairs.joints) != joint_keys(reference.joints):
        differ = sorted(set(pairs.joints) ^ set(reference.joints)) or ["their order"]
        raise PoseDataError(
            f"{other} and {model} hold other joints: {', '.join(differ)}. Score those in both with "
            f"{option('shared_joints', 'common')}, for both."
        )
    if pairs.root != reference.root:
        roots = [root_name(p.root, p.joints) for p in (reference, pairs)]
        raise PoseDataError(
            f"{other} and {model} have other root joints: {' and '.join(roots)}; expected the same. Name it for both."
        )
    if not np.array_equal(pairs.frame_id, reference.frame_id):
        first, second = pairs.frame_id, reference.frame_id
        alone = [*first[~np.isin(first, second)], *second[~np.isin(second, first)], "their order"]
        raise PoseDataError(
            f"{other} and {model} hold other frames: {len(reference.truth):,} and {len(pairs.truth):,} (first: "
            f"{alone[0]}). A skill needs both on the same frames: evaluate those in both."
        )
    if not np.array_equal(pairs.truth, reference.truth, equal_nan=True):
        raise PoseDataError(f"{other} and {model} were evaluated against different true poses; expected the same.")
    remarks = [f"{other}: {remark}" for remark in reference.remarks if remark not in pairs.remarks]
    return pairs.replace(reference=reference, remarks=(*pairs.remarks, *remarks))
