"""Remarks of batches and shards stand once, with counts that add up."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np

import posecal
from posecal.engine.merge import merge_totals
from posecal.engine.storage import load_totals, save_totals
from tests.helpers.batches import JOINTS, Arrays


def test_counts_of_remarks_add_up_over_batches_and_shards(world: Arrays, tmp_path: Path) -> None:
    """Five poses lose their root: two of the first batch, and all three of the second, of which nothing is left."""
    hypotheses, truth = world["hypotheses"], world["truth"]
    where = np.ones(truth.shape[:2], dtype=bool)
    where[[3, 7, 10, 11, 12], 0] = False
    made: dict[str, Any] = {"joints": JOINTS, "axes": "NMKD", "unit": "mm"}
    parts = [slice(0, 10), slice(10, 13), slice(13, 40)]
    together = posecal.Evaluation(**made)
    for part in parts:
        together.update(hypotheses[:, part], truth[part], where=where[part])
    said = "the root Hip does not count in 5 of 40 frames (first: 3, 7 and 3 more): left out, since"
    assert [remark.startswith(said) for remark in together.totals().remarks].count(True) == 1
    assert sum("root Hip" in remark for remark in together.compute().remarks) == 1

    shards = [posecal.Evaluation(**made) for _ in parts]
    for shard, part in zip(shards, parts, strict=True):
        shard.update(hypotheses[:, part], truth[part], where=where[part])
    save_totals(shards[0].totals(), tmp_path / "a.npz")
    save_totals(shards[2].totals(), tmp_path / "c.npz")
    merged = merge_totals([load_totals(tmp_path / name) for name in ("a.npz", "c.npz")])
    assert any("does not count in 2 of 37 frames (first: 3, 7)" in remark for remark in merged.remarks)
    shards[0].merge(shards[1])
    shards[0].merge(pickle.loads(pickle.dumps(shards[2])))
    assert any(remark.startswith(said) for remark in shards[0].totals().remarks)
    assert any(remark.startswith(said) for remark in pickle.loads(pickle.dumps(shards[0].totals())).remarks)


def test_frames_without_names_are_numbered_through_the_batches(world: Arrays) -> None:
    hypotheses = world["hypotheses"].copy()
    hypotheses[:, 25] = 0
    evaluation = posecal.Evaluation(axes="NMKD", unit="mm", joints=JOINTS, metrics="mpjpe")
    for start in range(0, 40, 10):
        evaluation.update(hypotheses[:, start : start + 10], world["truth"][start : start + 10])
    assert any("in 1 of 40 frames (first: 25) every hypothesis is one point" in r for r in evaluation.compute().remarks)


def test_remarks_with_numbers_of_the_batch_stand_once(world: Arrays) -> None:
    """Such as that bones are too long, which they are by another factor in each batch."""
    evaluation = posecal.Evaluation(axes="NMKD", unit="mm", joints=JOINTS)
    for start in range(0, 90, 10):
        part, factor = slice(start, start + 10), 5 + start
        evaluation.update(factor * world["hypotheses"][:, part], factor * world["truth"][part])
    (bones,) = [remark for remark in evaluation.totals().remarks if "median bone" in remark]
    assert bones.startswith("the median bone of truth is 2,")
