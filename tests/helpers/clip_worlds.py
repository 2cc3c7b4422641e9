"""Data sets of correlated frames whose sequences differ in difficulty, many at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from posecal.engine.totals import Totals
from tests.helpers.samplers import pairs_of, report_of

Array = npt.NDArray[np.floating]

FRAMES = 50
"""Of a sequence; where one sequence holds half of the frames, it is as long as the others together."""


@dataclass(frozen=True)
class Design:
    """What is simulated.

    Attributes
    ----------
    sequences : int
        Of each data set.
    half_in_one : bool
        Whether the first sequence holds half of the frames.
    average : str
        Option of the protocol. With ``action``, every second sequence is of another action.
    """

    sequences: int
    half_in_one: bool = False
    average: str = "poses"

    @property
    def lengths(self) -> list[int]:
        """Frames of each sequence."""
        S = self.sequences
        return [FRAMES * (S - 1) if self.half_in_one and s == 0 else FRAMES for s in range(S)]

    def __str__(self) -> str:
        return f"{self.sequences}{', one holds half' * self.half_in_one}"


def autoregressive(lengths: Sequence[int], shape: tuple[int, ...], random: np.random.Generator) -> Array:
    """Draw standard normals of sequences of frames whose neighbours correlate by 0.95, (frames, …)."""
    parts = []
    for length in lengths:
        noise = random.standard_normal((length, *shape))
        noise[1:] *= math.sqrt(1 - 0.95**2)
        parts.append(signal.lfilter([1.0], [1.0, -0.95], noise, axis=0))
    return np.concatenate(parts)


def clips(lengths: Sequence[int], seed: int, N: int = 4, K: int = 3) -> tuple[Array, Array, Array]:
    """Draw hypotheses and truths of sequences: the model knows half of what makes a sequence difficult.

    The third array is the log density of the model's Gaussian at each truth, nats.

    The scale of the truth about the model's mean is 40 mm times a log-normal number for each sequence, of which the
    logarithm has a standard deviation of 0.5; the model's own is 40 mm times the root of that number, times another
    for each frame.
    """
    random = np.random.default_rng(seed)
    log_scale = np.repeat(0.5 * random.standard_normal(len(lengths)), lengths)
    truth = 40 * np.exp(log_scale)[:, None, None] * autoregressive(lengths, (K, 3), random)
    spread = 40 * np.exp(log_scale / 2 + 0.2 * autoregressive(lengths, (), random))[:, None, None]
    hypotheses = spread * random.standard_normal((N, len(truth), K, 3))
    log_prob = -((truth / spread) ** 2 / 2 + np.log(spread) + np.log(2 * np.pi) / 2).sum(axis=(1, 2))
    return hypotheses.astype(np.float32), truth.astype(np.float32), log_prob


def data_sets(design: Design, replicates: int, metrics: str, seed: int) -> tuple[Totals, list[npt.NDArray[np.intp]]]:
    """Evaluate many data sets at once: their sums, and the cells of each."""
    lengths = design.lengths * replicates
    number = np.repeat(np.arange(len(lengths)), lengths)
    labels = {
        "sequence": np.char.mod("%06d", number),
        "replicate": np.char.mod("%04d", number // design.sequences),
        "action": np.char.mod("%d", number % 2),
    }
    hypotheses, truth, log_prob = clips(lengths, seed)
    pairs = pairs_of(hypotheses, truth, labels=labels, log_prob=log_prob)
    report = report_of(pairs, metrics, by=["replicate"], average=design.average)
    cells = [cells for group, cells in report.groups.items() if group is not None and cells is not None]
    return report.totals, cells
