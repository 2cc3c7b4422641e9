"""Limb lengths: how far those of the hypotheses are from the true ones, and how much they differ among hypotheses."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from posecal.data.arrays import BoolArray, FloatArray, squared_norms
from posecal.data.skeleton import Skeleton
from posecal.engine.block import Block
from posecal.engine.bounds import POSITIVE
from posecal.engine.finish import entry
from posecal.engine.metric import Metric, Statistic
from posecal.engine.scope import Scope

Bones = tuple[tuple[int, int], ...]


def limb_length_errors(block: Block, bones: Bones, joints: BoolArray | None = None) -> FloatArray:
    """Errors of limb lengths of each pose, and their standard deviation over the hypotheses.

    Parameters
    ----------
    block : Block
        B poses.
    bones : tuple of pairs of int
        Parent and child of each limb.
    joints : bool array (K,), optional
        The joints whose limbs count, both ends; all by default.

    Returns
    -------
    array (B, 2)
        Mean over limbs and hypotheses of | ‖x_c − x_p‖ − ‖y_c − y_p‖ |, and mean over limbs of the standard deviation
        of ‖x_c − x_p‖ over the hypotheses, mm; NaN for poses without a limb that counts.
    """
    parents, children = np.array(bones).T
    counted = block.where if joints is None else block.where & joints
    known = counted[:, parents] & counted[:, children]
    true = block.truth[:, children] - block.truth[:, parents]
    limbs = true[..., None] + block.offsets[:, children] - block.offsets[:, parents]
    lengths = np.sqrt(squared_norms(limbs)).astype(np.float64)
    errors = block.mean_of_each(np.abs(lengths - np.linalg.norm(true, axis=-1)[..., None]))
    deviations = lengths.std(axis=-1)
    if block.weights is not None:
        deviations = np.sqrt(block.mean_of_each((lengths - block.mean_of_each(lengths)[..., None]) ** 2))
    number = known.sum(axis=1)
    sums = [np.where(known, values, 0).sum(axis=1) for values in (errors, deviations)]
    return np.where(number > 0, np.stack(sums) / np.maximum(number, 1), np.nan).T


# --- metrics --------------------------------------------------------------------------------------------------


def limb_metrics(scope: Scope) -> Iterator[Metric]:
    """Limb-length error and the spread of limb lengths, of skeletons that are known."""
    bones = tuple(
        bone
        for bone in Skeleton(scope.spec.joints, scope.spec.parents).bones
        if scope.fit[bone[0]] and scope.fit[bone[1]]
    )
    if not bones:
        return
    n, where = scope.spec.n_hypotheses, scope.protocol.where
    limbs = f"{len(bones)} limbs" if where == "all" else f"{len(bones)} limbs with both ends {where}"
    make = partial(
        Metric,
        unit="mm",
        family="accuracy",
        statistic=Statistic("limb_lengths", partial(limb_length_errors, bones=bones, joints=scope.fit)),
        needs=("positions",),
        source="Sun et al., arXiv:1704.00159",
    )
    yield make(
        name="limb_length_error",
        label="limb-length error",
        direction="lower",
        brief=f"mean of N={n}, {limbs}",
        definition=f"mean over poses, N={n} hypotheses and {limbs} of the absolute difference of a limb's length from "
        "the true one",
        finish=entry(0),
        range="0 at best",
        bounds=POSITIVE,
        reading="It depends on no alignment. Hypotheses with wrong limb lengths are no poses of this person.",
    )
    if n > 1:
        yield make(
            name="limb_length_deviation",
            label="limb-length deviation",
            direction="none",
            brief=f"over N={n}, {limbs}",
            definition=f"mean over poses and {limbs} of the standard deviation (n) of a limb's length over N={n} "
            "hypotheses",
            finish=entry(1),
            range="0 where all hypotheses have limbs of one length",
            bounds=POSITIVE,
            reading="A person has one length of each limb: what it is above 0 is uncertainty about the person's size.",
        )
