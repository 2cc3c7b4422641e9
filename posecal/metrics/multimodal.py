"""Errors and diversity against a set of truths, clips that follow alike observations: MMADE, MMFDE, APDE."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.arguments import quantity_of
from posecal.data.arrays import BoolArray, FloatArray, checked_number, real_array
from posecal.data.stored_poses import in_millimetres
from posecal.engine.block import Block
from posecal.engine.finish import entry
from posecal.engine.metric import Metric
from posecal.engine.scope import Scope
from posecal.engine.sums import slices
from posecal.engine.true_clips import KEY, TrueClips
from posecal.errors import PoseDataError
from posecal.geometry.distances import half_mean_distances
from posecal.metrics.clips import at_last, clip_statistic, half_distance, of_clips
from posecal.metrics.displacement import CLIP, DLOW, displacement_metrics

NEEDS_TRUE_CLIPS = frozenset({"multimodal_errors", "multimodal_apd"})
"""The statistics that need the true clips that are evaluated together."""


def multimodal_errors(block: Block, body: BoolArray, length: int, threshold: float, alone: bool) -> FloatArray:
    """MMADE and MMFDE of the clip, (T, 2), mm: at its last frame, NaN before, and where its set has no other clip."""
    found = np.full((len(block.truth), 2), np.nan)
    others = _others(block, body, length, threshold)
    if others is None or (len(others) == 1 and not alone):
        return found
    offsets = block.offsets[:, body].reshape(length, -1, block.n_hypotheses).astype(np.float64)
    squares = np.asarray((offsets**2).sum(axis=1))[:, None]
    ade: list[FloatArray] = []
    fde: list[FloatArray] = []
    for part in slices(len(others), squares.nbytes):
        apart = others[part].swapaxes(0, 1)  # (T, A, KD)
        distances = np.sqrt(np.maximum(squares + (apart**2).sum(axis=2)[..., None] - 2 * apart @ offsets, 0))
        ade.append(distances.mean(axis=0).min(axis=1))
        fde.append(distances[-1].min(axis=1))
    found[-1] = np.concatenate(ade).mean(), np.concatenate(fde).mean()
    return found


def multimodal_apd(block: Block, body: BoolArray, length: int, threshold: float) -> FloatArray:
    """Difference of APD from that of the set of truths, (T,), mm: at the last frame, NaN before and for sets of one."""
    others = _others(block, body, length, threshold)
    if others is None or len(others) == 1:
        return at_last(np.nan, block)
    points = others.reshape(1, 1, len(others), -1).swapaxes(2, 3)
    of_truth, of_hypotheses = 2 * half_mean_distances(points)[0, 0], 2 * half_distance(block, body)
    return at_last(abs(of_hypotheses - float(of_truth)), block)


def _others(block: Block, body: BoolArray, length: int, threshold: float) -> FloatArray | None:
    """Give the true clips of the set of a clip minus its own truth, (A, T, KD); None where a frame or joint lacks."""
    nothing: tuple[TrueClips | None, str] = None, ""
    clips, name = block.share(KEY, lambda: nothing)
    whole = len(block.truth) == length and bool(block.follows[1:].all() and block.where[:, body].all())
    others = None if clips is None or not whole else clips.of(name, block.truth, threshold, body)
    return None if others is None else (others - block.truth)[:, :, body].reshape(len(others), length, -1)


def mmade(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    observed: npt.ArrayLike,
    *,
    threshold: float = 500.0,
    clip: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Multimodal ADE of each clip: the mean of :func:`ade` over its set of truths.

    .. math:: \frac{1}{|S|} \sum_{s \in S} \min_n \frac{1}{T} \sum_t \lVert x_{nt} - y_{st} \rVert_2

    S: the clip itself, and all others whose last observed pose is nearer than a threshold to its own.

    Parameters
    ----------
    hypotheses, truth, clip, root, axes, unit
        As for :func:`ade`.
    observed : array (C, K, D)
        The last observed pose before each clip, in the unit of the truth.
    threshold : float
        A distance of whole poses, mm.

    Returns
    -------
    array (C,)
        Errors, mm; lower is better.

    Raises
    ------
    PoseDataError
        As :func:`ade`, and for observed poses or a threshold that don't fit.

    Notes
    -----
    Depends on which clips are evaluated together. Differs from the published code: CoMusion leaves out clips that are
    alone in their set, as the option ``mm_alone`` does.

    References
    ----------
    Yuan and Kitani, arXiv:2003.08386 (DLow).

    Examples
    --------
    Two clips of one frame after the same pose, true at 0 and 4, each predicted by one hypothesis, at 1.

    >>> import numpy as np
    >>> truth = np.array([0.0, 4.0]).reshape(2, 1, 1)
    >>> mmade(np.ones((1, 2, 1, 1)), truth, np.zeros((2, 1, 1)), clip=[0, 1], axes="NMKD", unit="mm")
    array([2., 2.])
    """
    return _multimodal(0, hypotheses, truth, observed, threshold, clip, root, axes, unit)


def mmfde(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    observed: npt.ArrayLike,
    *,
    threshold: float = 500.0,
    clip: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Multimodal FDE of each clip: the mean of :func:`fde` over its set of truths.

    Parameters
    ----------
    hypotheses, truth, observed, threshold, clip, root, axes, unit
        As for :func:`mmade`.

    Returns
    -------
    array (C,)
        Errors, mm; lower is better.

    Raises
    ------
    PoseDataError
        As :func:`mmade`.

    Notes
    -----
    Differs from the published code: as :func:`mmade`.

    References
    ----------
    Yuan and Kitani, arXiv:2003.08386 (DLow).

    Examples
    --------
    The same, for clips of one frame.

    >>> import numpy as np
    >>> truth = np.array([0.0, 4.0]).reshape(2, 1, 1)
    >>> mmfde(np.ones((1, 2, 1, 1)), truth, np.zeros((2, 1, 1)), clip=[0, 1], axes="NMKD", unit="mm")
    array([2., 2.])
    """
    return _multimodal(1, hypotheses, truth, observed, threshold, clip, root, axes, unit)


def apde(
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    /,
    observed: npt.ArrayLike,
    *,
    threshold: float = 500.0,
    clip: npt.ArrayLike | None = None,
    root: int | None = None,
    axes: str | None = None,
    unit: str | float | None = None,
) -> FloatArray:
    r"""Difference of the :func:`apd` of the hypotheses of each clip from that of its set of truths: APDE.

    Parameters
    ----------
    hypotheses, truth, observed, threshold, clip, root, axes, unit
        As for :func:`mmade`.

    Returns
    -------
    array (C,)
        Absolute differences, mm; lower is better; NaN for clips that are alone in their set.

    Raises
    ------
    PoseDataError
        As :func:`mmade`.

    Notes
    -----
    Differs from the published code: the APD of sets comes from the clips themselves, not from a file beside the code.

    References
    ----------
    Barquero, Escalera and Palmero, arXiv:2211.14304 (BeLFusion).

    Examples
    --------
    The two truths after one pose are 4 apart, the two hypotheses of each clip 3.

    >>> import numpy as np
    >>> truth, hypotheses = np.array([0.0, 4.0]).reshape(2, 1, 1), np.array([1.0, 4.0]).reshape(2, 1, 1, 1)
    >>> options = {"clip": [0, 1], "axes": "NMKD", "unit": "mm"}
    >>> apde(np.repeat(hypotheses, 2, axis=1), truth, np.zeros((2, 1, 1)), **options)
    array([1., 1.])
    """
    return _multimodal(2, hypotheses, truth, observed, threshold, clip, root, axes, unit)


def _multimodal(
    which: int,
    hypotheses: npt.ArrayLike,
    truth: npt.ArrayLike,
    observed: npt.ArrayLike,
    threshold: float,
    clip: npt.ArrayLike | None,
    root: int | None,
    axes: str | None,
    unit: str | float | None,
) -> FloatArray:
    limit = checked_number(threshold, "threshold", lambda mm: 0 < mm < np.inf, "a length in mm, above 0")
    poses = in_millimetres(real_array(observed, "observed"), quantity_of(unit)[1])
    if not np.isfinite(poses).all():
        raise PoseDataError("observed: non-finite coordinates; expected the pose before each clip.")

    def statistic(block: Block, body: BoolArray, length: int) -> FloatArray:
        if which == 2:
            return multimodal_apd(block, body, length, limit)
        return multimodal_errors(block, body, length, limit, alone=True)[:, which]

    return of_clips(statistic, hypotheses, truth, clip, None, root, axes, unit, poses)


# --- metrics ----------------------------------------------------------------------------------------------------------


def motion_metrics(scope: Scope) -> Iterator[Metric]:
    """ADE, FDE, APD and the energy score of clips, and MMADE, MMFDE and APDE, where poses form clips."""
    p, N = scope.protocol, scope.spec.n_hypotheses
    if not scope.spec.clip_length:
        return
    yield from displacement_metrics(scope)
    norm = f"norm over {scope.counted(scope.body)} and all coordinates"
    sets = f"S: clips whose last observed poses are less than {p.mm_threshold:g} mm apart, {norm}"
    left_out = "; clips alone in S are left out"
    alone = p.mm_alone == "count"
    make = partial(CLIP, headline=True, needs=("positions", "observed poses", "true clips"))
    of_sets = clip_statistic(scope, "multimodal_errors", multimodal_errors, threshold=p.mm_threshold, alone=alone)
    reading = "Other clips stand for what might have come as well. Depends on which clips are evaluated together."
    for index, (name, over) in enumerate(
        (("ADE", "means over its frames of ‖x − s‖"), ("FDE", "‖x − s‖ at its last frame"))
    ):
        yield make(
            name=f"mm{name.lower()}",
            label=f"MM{name}",
            brief=f"{name} of a set of truths",
            definition=f"mean over clips and over s in S of the smallest of the N={N} {over}; {sets}"
            + left_out * (not alone),
            statistic=of_sets,
            finish=entry(index),
            reading=reading,
            source=DLOW,
        )
    if N > 1:
        yield make(
            name="apde",
            label="APDE",
            brief="difference of APD from that of a set of truths",
            definition=f"mean over clips of |APD of the hypotheses − APD of S|; {sets}{left_out}",
            statistic=clip_statistic(scope, "multimodal_apd", multimodal_apd, threshold=p.mm_threshold),
            finish=entry(),
            reading=reading,
            source="Barquero, Escalera and Palmero, arXiv:2211.14304 (BeLFusion)",
        )
