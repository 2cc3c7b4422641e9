"""How often 95 % intervals hold the number that endless data would show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import stats

from posecal.registry import metrics_of
from posecal.stats.jackknife import jackknife, leave_one_out, sequence_sizes
from tests.evidence import Table
from tests.helpers.clip_worlds import Design, clips, data_sets
from tests.helpers.samplers import pairs_of, report_of

METRICS = (
    "min_mpjpe",
    "pck",
    "coverage_80",
    "signed_area",
    "energy_score",
    "spread_error_correlation",
    "ause",
    "aurc",
    "nll",
)
DESIGNS = (Design(6), Design(10), Design(20), Design(6, half_in_one=True), Design(10, half_in_one=True))
BATCH = 200
"""So many data sets are drawn at once, from one seed."""

OF_ACTIONS = Design(10, average="action"), Design(10, half_in_one=True, average="action")


def true_values(sequences: int = 40_000) -> dict[str, float]:
    """Give each number over so many sequences of two frames each."""
    hypotheses, truth, log_prob = clips([2] * sequences, seed=9)
    report = report_of(pairs_of(hypotheses, truth, log_prob=log_prob), ", ".join(METRICS))
    return {name: report[name] for name in METRICS}


def covered(
    design: Design, replicates: int, truth: dict[str, float], seed: int = 0
) -> Iterator[tuple[str, float, float, float]]:
    """Give three shares for each metric.

    Of plain t intervals with S - 1 degrees of freedom and of posecal's those that hold the truth; of the plain ones
    those with an end outside of the possible range.
    """
    totals, data = data_sets(design, replicates, ", ".join(METRICS), seed)
    for name, metric in metrics_of(totals.protocol, totals.spec).items():
        if name not in truth:
            continue
        held = np.zeros((3, replicates))
        for number, cells in enumerate(data):
            value, without = totals.value(metric, cells), leave_one_out(totals, metric, cells)
            now = jackknife(value, without, sequence_sizes(totals, metric, cells), metric.bounds)
            reach = now.error * stats.t(len(without) - 1).ppf(0.975)
            held[0, number] = abs(value - truth[name]) <= reach
            held[1, number] = now.low <= truth[name] <= now.high
            held[2, number] = value - reach < metric.bounds[0] or value + reach > metric.bounds[1]
        yield name, *held.mean(axis=1).tolist()


def _rows(replicates: int) -> list[tuple[str, ...]]:
    truth = true_values()
    designs = {str(design): dict(_named(design, replicates, truth)) for design in DESIGNS}
    actions = {str(design): dict(_named(design, replicates, truth)) for design in OF_ACTIONS}
    rows = []
    for name in METRICS:
        cells = (designs[str(design)][name] for design in DESIGNS)
        left = designs[str(DESIGNS[0])][name][2]
        rows.append((f"`{name}`, {truth[name]:.3g}", *map(_cell, cells), f"{left:.0%}"))
    for name in ("min_mpjpe", "pck", "coverage_80"):
        by_design = ("" if str(design) not in actions else _cell(actions[str(design)][name]) for design in DESIGNS)
        rows.append((f"`{name}`, mean over two actions", *by_design, ""))
    return rows


def _named(
    design: Design, replicates: int, truth: dict[str, float]
) -> Iterator[tuple[str, tuple[float, float, float]]]:
    sizes = [min(BATCH, replicates - start) for start in range(0, replicates, BATCH)]
    parts = [[*covered(design, size, truth, seed)] for seed, size in enumerate(sizes)]
    for name, *of_batches in zip([name for name, *_ in parts[0]], *parts, strict=True):
        shares = np.average([shares for _, *shares in of_batches], axis=0, weights=sizes)
        yield name, tuple(shares.tolist())


def _cell(shares: tuple[float, float, float]) -> str:
    return f"{shares[0]:.1%} → {shares[1]:.1%}"


TABLES = [
    Table(
        "intervals",
        ("number and its true value", *(f"{d} sequences" for d in DESIGNS[:3]), *map(str, DESIGNS[3:]), "left before"),
        _rows,
        1000,
    )
]
