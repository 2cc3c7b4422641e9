"""Sums that are known, of four cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from posecal.engine.metric import DataSpec, Metric, Statistic, entry
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals

SUBJECT = DataSpec(7, ("Head", "Hip"), 1, ("sequence", "action"), 25.0)

HEIGHT = Statistic("height", lambda block: block.truth[:, 0, 0])
JOINTS = Statistic("joints", lambda block: block.truth[..., 0], per_joint=True)


def metric(statistic: Statistic = HEIGHT, **changes: object) -> Metric:
    """A metric of which only the parts matter that are tested."""
    words = dict.fromkeys(("name", "label", "unit", "brief", "definition"), "")
    whole = Metric(**words, direction="none", family="spread", statistic=statistic, finish=entry())
    return replace(whole, **changes)  # type: ignore[arg-type]


def totals(protocol: Protocol | None = None, **changes: object) -> Totals:
    """Four cells of 3, 1, 2 and 4 poses in three sequences and two actions.

    Their heights add up to 30, 8, 14 and 0, of as many poses each; of the second joint only cells 0 and 2 have any.
    """
    found = Totals(
        spec=SUBJECT,
        protocol=protocol or Protocol(),
        version="1.0",
        cells={"sequence": np.array(["a", "b", "b", "c"]), "action": np.array(["sit", "sit", "walk", "walk"])},
        poses=np.array([3, 1, 2, 4]),
    )
    found.add("height", np.arange(4), np.array([30.0, 8, 14, 0]), np.array([3, 1, 2, 4]))
    columns = np.array([[30.0, 3], [8, 0], [14, 1], [0, 0]])
    found.add("joints", np.arange(4), columns, np.array([[3, 1], [1, 0], [2, 1], [4, 0]]))
    return replace(found, **changes)  # type: ignore[arg-type]


SIT, WALK = np.array([True, True, False, False]), np.array([False, False, True, True])


KEPT = Statistic("kept", lambda block: block.truth[:, 0, :2], per_pose=True)


def keeping() -> tuple[Totals, Metric]:
    """Two values of five poses in cells 0, 0, 1, 3 and 3, of which one is not known."""
    values = np.array([[1.0, 2], [3, 4], [5, 6], [7, math.nan], [9, 10]])
    found = totals(per_pose={"kept": values}, cell_of=np.array([0, 0, 1, 3, 3]))
    return found, metric(KEPT, finish=lambda kept: float(kept.sum()))
