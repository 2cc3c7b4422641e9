"""Uncertainty of single poses: risk–coverage, failures and the Brier score, in worlds of a known answer; shards."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from posecal import Evaluation, PoseData, Report, climatology, evaluate, merge_totals, prepare
from posecal.engine.block import Block
from posecal.engine.sums import mean_of
from posecal.engine.totals import Totals
from posecal.metrics import aurc, ause, excess_aurc, failure_auroc
from posecal.metrics.brier import fair_brier
from tests.evidence import Table

Array = npt.NDArray[np.float64]
Row = tuple[str, ...]

POSES = 2000
THRESHOLD = 150.0


def errors_of_known_failures(random: np.random.Generator, kind: str) -> tuple[Array, Array]:
    """Spread and error of poses, of which a known share fails at each spread.

    The spread is uniform in 0 to 1. A pose of the spread s fails with the probability s, s² or ½; its error is 200 mm
    if it fails and 50 mm else.
    """
    spread = random.random(POSES)
    chance = {"s": spread, "s²": spread**2, "½": np.full(POSES, 0.5)}[kind]
    return spread, np.where(random.random(POSES) < chance, 200.0, 50.0)


def auroc_in_closed_form(kind: str) -> float:
    """∫ f(s) G(s) ds of the density f of failures and the distribution function G of successes.

    For s: ∫ 2s (2s − s²) ds = 4/3 − 1/2. For s²: ∫ 3s² (3s − s³)/2 ds = 9/8 − 1/4. For ½: ∫ s ds.
    """
    return {"s": 4 / 3 - 1 / 2, "s²": 9 / 8 - 1 / 4, "½": 1 / 2}[kind]


def aurc_in_closed_form(kind: str) -> float:
    """50 mm and 150 mm times the mean over coverages c of the mean chance of failure of spreads below c.

    For s: ∫ c/2 dc = 1/4. For s²: ∫ c²/3 dc = 1/9. For ½: ½.
    """
    return 50 + 150 * {"s": 1 / 4, "s²": 1 / 9, "½": 1 / 2}[kind]


def failure_rows(replicates: int) -> list[Row]:
    """AUROC and AURC against their closed forms."""
    rows = []
    for seed, kind in enumerate(("s", "s²", "½")):
        random = np.random.default_rng(seed)
        found = np.array(
            [
                (failure_auroc(*pair, THRESHOLD), aurc(*pair))
                for pair in (errors_of_known_failures(random, kind) for _ in range(replicates))
            ]
        )
        auroc, area = (mean_and_error(values) for values in found.T)
        right = f"{auroc_in_closed_form(kind):.4f}", f"{aurc_in_closed_form(kind):.2f} mm"
        rows.append((kind, f"{auroc[0]:.4f} ± {auroc[1]:.4f}", right[0], f"{area[0]:.2f} ± {area[1]:.2f} mm", right[1]))
    return rows


def mean_and_error(values: Array) -> tuple[float, float]:
    """Mean and its standard error."""
    return float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


def order_rows(_: int) -> list[Row]:
    """Areas of orders that are perfect, absent and reversed, of errors that are uniform in 0 to 100 mm.

    Kept in the order of their errors, the mean error at coverage c is 50 c mm, so that AURC is 25 mm; in no order it is
    50 mm at every coverage; from the largest it is 100 − 50 c, so that AURC is 75 mm.
    """
    error = (np.arange(20_000) + 0.5) / 200
    orders = {
        "perfect": (error, "25.00"),
        "always the same": (np.ones(20_000), "50.00"),
        "reversed": (-error, "75.00"),
    }
    rows = []
    for name, (spread, right) in orders.items():
        excess, share = excess_aurc(spread, error), ause(spread, error)
        shown = "–" if name == "always the same" else f"{share:.3f}"  # equal spreads in the order in which they come
        rows.append((name, f"{aurc(spread, error):.2f} mm", f"{right} mm", f"{excess:.2f} mm", shown))
    return rows


WORLDS = {"calibrated": (0.0, 1.0), "shifted by 70 mm": (70.0, 1.0), "half the spread": (0.0, 0.5)}
"""Shift of the truth, and the factor of the predicted spread."""


def brier_scores(world: str, n: int, poses: int) -> Array:
    """The score about the own median as it was, as it is, and of fresh hypotheses for the same event, (3, poses)."""
    random = np.random.default_rng(n)
    shift, factor = WORLDS[world]
    scale = random.lognormal(0, 0.6, (poses, 1, 1))
    y = scale * random.normal(0, 60, (poses, 4, 3)) + shift
    x, fresh = (scale * random.normal(0, 60 * factor, (size, poses, 4, 3)) for size in (n, 100))
    block = Block(x, y)
    before, right = (fair_brier(block, forecast=Block(some, y)) for some in (x, fresh))
    return np.stack([before, fair_brier(block), right])


def brier_rows(replicates: int) -> list[Row]:
    """Brier scores over N, of 250 poses a replicate."""
    rows = []
    for world in WORLDS:
        for n in (2, 3, 5, 10, 20, 100):
            before, now, right = brier_scores(world, n, 250 * replicates).mean(axis=1)
            rows.append((world, str(n), f"{before:.3f}", "–" if math.isnan(now) else f"{now:.3f}", f"{right:.3f}"))
    return rows


SEQUENCES = np.repeat([f"clip {number}" for number in range(12)], 25)


def shard_rows(_: int) -> list[Row]:
    """Numbers of three shards of four sequences against one run."""
    random = np.random.default_rng(5)
    place = random.normal(0, 200, (12, 5, 3))[np.repeat(np.arange(12), 25)]  # each sequence has its own pose
    y = place + random.normal(0, 100, (300, 5, 3))
    x = y + random.normal(0, 60, (20, 300, 5, 3)) + random.normal(0, 40, (300, 5, 3))
    whole = PoseData(x, y, labels={"sequence": SEQUENCES}, unit="mm")
    cuts = [np.arange(300)[start : start + 100] for start in (0, 100, 200)]

    def run(data: PoseData) -> Report:
        return evaluate(data, metrics="default, rank_tests, scores", reference="climatology", by="predicted_spread")

    def prepared_with_all(part: npt.NDArray[np.intp]) -> Evaluation:
        evaluation = Evaluation(unit="mm", axes="NMKD", metrics="default, rank_tests", prepared=prepare(whole))
        evaluation.update(x[:, part], y[part], sequence=SEQUENCES[part])
        return evaluation

    one, shards = run(whole), [run(whole.select(part)).totals for part in cuts]
    apart = Report(merge_totals(shards))
    prepared = Report(merge_totals([prepared_with_all(part).totals() for part in cuts]))

    reference = climatology(whole)
    against_one = [evaluate(whole.select(m), reference=reference.select(m), metrics="energy_skill") for m in cuts]
    skills = Report(merge_totals([report.totals for report in against_one]))

    def shown(report: Report, name: str) -> str:
        return f"{report[name]:.4f}" if name in report.metrics else "absent"

    rows = []
    for name in ("tarp_box", "energy_skill", "ece", "aurc"):
        before = _summed(shards, name) if name in {"tarp_box", "energy_skill"} else apart[name]
        shared = skills if name == "energy_skill" else prepared
        rows.append((name, shown(one, name), f"{before:.4f}", shown(apart, name), shown(shared, name)))
    groups = len({value for totals in shards for value in totals.cells["predicted_spread"]})
    return [*rows, ("groups by predicted_spread", f"{len(one.groups) - 1}", f"{groups}", "absent", "of cuts in mm")]


def _summed(shards: list[Totals], name: str) -> float:
    """Metric of the sums of all shards, as posecal 0.1.0 added them."""
    metric = Report(shards[0]).metrics[name]
    of_shards = [totals.of_cells(metric.statistic) for totals in shards]
    sums, counts = (np.concatenate(parts).sum(axis=0) for parts in zip(*of_shards, strict=True))
    return float(np.asarray(metric.finish(mean_of(sums, counts))))


TABLES = [
    Table(
        "failures",
        ("chance of a failure at spread s", "AUROC", "right", "AURC", "right"),
        failure_rows,
        500,
    ),
    Table("orders", ("order of 20,000 poses", "AURC", "right", "excess AURC", "AUSE"), order_rows, 1),
    Table(
        "brier",
        ("model", "N", "before: about the median of all", "now: of the others", "fresh hypotheses, the same event"),
        brier_rows,
        24,
    ),
    Table(
        "shards", ("", "one run", "before: merged", "now: merged", "now: of one range and climatology"), shard_rows, 1
    ),
]
