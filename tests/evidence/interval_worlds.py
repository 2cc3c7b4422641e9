"""Data sets of correlated frames whose sequences differ in difficulty, for simulations of intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy import signal

from posecal.engine.totals import Totals
from tests.helpers.samplers import pairs_of, report_of

Array = npt.NDArray[np.floating]

FRAMES = 30
"""Of a sequence; where one sequence holds half of the frames, it is as long as the others together."""

METRICS = "min_mpjpe, pck, coverage_90, signed_area, spread_error_correlation, sparsification_area, energy_score"


@dataclass(frozen=True)
class Design:
    """What is simulated.

    Attributes
    ----------
    sequences : int
        Of each data set.
    half_in_one : bool
        Whether the first sequence holds half of the frames.
    difficulty : float
        Standard deviation of the logarithm of the sequences' difficulty.
    """

    sequences: int
    half_in_one: bool = False
    difficulty: float = 0.5

    @property
    def lengths(self) -> list[int]:
        """Frames of each sequence."""
        S = self.sequences
        return [FRAMES * (S - 1) if self.half_in_one and s == 0 else FRAMES for s in range(S)]


def autoregressive(lengths: Sequence[int], shape: tuple[int, ...], random: np.random.Generator) -> Array:
    """Draw standard normals of sequences of frames whose neighbours correlate by 0.95, (frames, …)."""
    parts = []
    for length in lengths:
        noise = random.standard_normal((length, *shape))
        noise[1:] *= math.sqrt(1 - 0.95**2)
        parts.append(signal.lfilter([1.0], [1.0, -0.95], noise, axis=0))
    return np.concatenate(parts)


def world(lengths: Sequence[int], difficulty: float, seed: int, N: int = 5, K: int = 2) -> tuple[Array, Array]:
    """Draw hypotheses and truths of sequences: the model knows half of what makes a sequence difficult.

    The scale of the truth about the model's mean is 40 mm times a log-normal number for each sequence; the model's own
    is 40 mm times the root of that number, times a log-normal number for each frame.
    """
    random = np.random.default_rng(seed)
    log_scale = np.repeat(difficulty * random.standard_normal(len(lengths)), lengths)
    truth = 40 * np.exp(log_scale)[:, None, None] * autoregressive(lengths, (K, 3), random)
    of_frame = 0.2 * autoregressive(lengths, (), random)
    spread = 40 * np.exp(log_scale / 2 + of_frame)[:, None, None]
    hypotheses = spread * random.standard_normal((N, len(truth), K, 3))
    return hypotheses.astype(np.float32), truth.astype(np.float32)


@cache
def data_sets(
    design: Design, replicates: int, seed: int = 0, average: str = "poses"
) -> tuple[Totals, tuple[Array, ...]]:
    """Evaluate many data sets at once: their sums, and the cells of each."""
    lengths = design.lengths * replicates
    hypotheses, truth = world(lengths, design.difficulty, seed)
    number = np.repeat(np.arange(len(lengths)), lengths)
    position = np.arange(len(number)) % 4
    labels = {
        "sequence": np.char.mod("%06d", number),
        "replicate": np.char.mod("%04d", number // design.sequences),
        "action": np.char.mod("%d", number % 2) if average == "action" else np.char.mod("%d", position * 0),
    }
    report = report_of(pairs_of(hypotheses, truth, labels=labels), METRICS, by=["replicate"], average=average)
    cells = [cells for group, cells in report.groups.items() if group is not None]
    return report.totals, tuple(cells)
