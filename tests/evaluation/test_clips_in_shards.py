"""Shards of clips of predicted motion give the numbers of one run."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from tests.helpers.sharded import JOINTS, largest_difference
from tests.helpers.sharded_clips import CUTS, HOW, HYPOTHESES, OBSERVED, OPTIONS, RECORDING, TRUTH, C, T, X, Y, clips


def assert_equal(found: posecal.Report, one: posecal.Report) -> None:
    rows, difference = largest_difference(one, found)
    assert rows > 100
    assert difference < 1e-10
    assert {"ade", "fde", "apd", "mmade", "mmfde", "apde", "clip_energy_score", "energy_skill"} <= {*found.metrics}
    assert found.signature == one.signature
    assert {*found.remarks} == {*one.remarks}
    assert {*found.totals.labels} == {*one.totals.labels}
    assert len(found.totals.poses) == len(one.totals.poses)
    assert found.totals.spec.has_clip_numbers == one.totals.spec.has_clip_numbers


@pytest.mark.parametrize(
    ("cut", "labels"),
    [
        ("strided", "none"),
        ("strided", "names that come back"),
        pytest.param("uneven", "recordings", marks=pytest.mark.slow),
    ],
)
def test_every_row_is_that_of_one_run(cut: str, labels: str) -> None:
    named = {} if labels == "none" else {"sequence": RECORDING}
    named |= {"clip": np.arange(C) % 3} if labels == "names that come back" else {}
    parts = CUTS[cut]
    order = np.concatenate([np.arange(C)[part] for part in parts])
    one = posecal.evaluate(clips(order, **named), **OPTIONS)
    assert_equal(posecal.evaluate_shards([clips(part, **named) for part in parts], threads=1, **OPTIONS), one)


def files(folder: Path, part: slice, name: str) -> tuple[str, str]:
    paths = str(folder / f"hyps-{name}.npz"), str(folder / f"gt-{name}.npz")
    about: dict[str, Any] = {"unit": "mm", "joints": JOINTS}
    np.savez(paths[0], hypotheses=HYPOTHESES[:, part], axes="NMTKD", **about)
    np.savez(paths[1], truth=TRUTH[part], axes="MTKD", observed=OBSERVED[part], sequence=RECORDING[part], **about)
    return paths


@pytest.mark.slow
def test_files_in_processes_give_the_numbers_of_one_file(tmp_path: Path) -> None:
    options: dict[str, Any] = {"protocol": posecal.Protocol(mm_threshold=350), "by": "horizon"}
    one = posecal.evaluate(*files(tmp_path, slice(None), "all"), **options)
    pairs = [files(tmp_path, part, str(n)) for n, part in enumerate(CUTS["uneven"])]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = posecal.evaluate_shards(pairs, map=pool.map, **options)
    assert largest_difference(one, found)[1] < 1e-10
    assert found.value("ade", "horizon=3") == pytest.approx(one.value("ade", "horizon=3"), rel=1e-12)


def test_one_file_of_truth_goes_with_all_shards(tmp_path: Path) -> None:
    names = np.array([f"{c}/{t}" for c in range(C) for t in range(T)]).reshape(C, T)
    np.savez(tmp_path / "gt.npz", truth=TRUTH, axes="MTKD", unit="mm", frame_id=names.ravel(), observed=OBSERVED)
    pairs = []
    for number, part in enumerate([slice(None), *CUTS["strided"]]):
        pairs.append((tmp_path / f"hyps-{number}.npz", tmp_path / "gt.npz"))
        stored = {"hypotheses": HYPOTHESES[:, part], "frame_id": names[part].ravel()}
        np.savez(pairs[-1][0], **stored, axes="NMTKD", unit="mm")  # type: ignore[arg-type]
    options: dict[str, Any] = {"metrics": "default, mmade", "by": "clip", "threads": 1}
    one = posecal.evaluate(*pairs[0], **options)
    found = posecal.evaluate_shards(pairs[1:], **options)
    assert found["mmade"] == pytest.approx(one["mmade"], rel=1e-12)
    for clip in range(C):  # by their numbers in the one file
        assert found.value("ade", f"clip={clip}") == pytest.approx(one.value("ade", f"clip={clip}"), rel=1e-12)


def test_clips_that_several_shards_hold_are_counted_once() -> None:
    options: dict[str, Any] = {"metrics": "ade, mmade, mpjpe", "threads": 1}
    shards = [clips(slice(0, 9)), clips(slice(7, 16))]
    with pytest.raises(PoseDataError, match=r"^duplicates: 10 poses are in an earlier shard as well"):
        posecal.evaluate_shards(shards, **options)
    found = posecal.evaluate_shards(shards, duplicates="drop", **options)
    assert found.scalars() == pytest.approx(posecal.evaluate(clips(slice(None)), **options).scalars(), rel=1e-12)


def test_what_does_not_fit_is_refused() -> None:
    half, rest = clips(slice(0, 8)), slice(8, 16)
    shorter = posecal.PoseData(HYPOTHESES[:, rest, :4], TRUTH[rest, :4], observed=OBSERVED[rest], **HOW)
    with pytest.raises(PoseDataError, match=r"^shard 2: clip_length 4 against 5 of shard 1; expected the same"):
        posecal.evaluate_shards([half, shorter])
    by_label = {"unit": "mm", "axes": "NMKD", "joints": JOINTS, "labels": {"clip": np.repeat(np.arange(C), T)}}
    with pytest.raises(
        PoseDataError, match=r"^shard 1: clips by a label clip, which may lie in several files; expected axes"
    ):
        posecal.evaluate_shards([posecal.PoseData(X, Y, **by_label)])
    named = [clips(slice(0, 8), clip=np.arange(C)), clips(rest, clip=np.arange(C) - 2)]
    with pytest.raises(PoseDataError, match=r"^clip: 2 of shard 2 \(first: 6, 7\) are in shard 1 as well"):
        posecal.evaluate_shards(named, metrics="ade", threads=1)
    with pytest.raises(PoseDataError, match=r"^observed: an array of poses; expected it in PoseData of each shard"):
        posecal.evaluate_shards([(HYPOTHESES, TRUTH)], observed=OBSERVED, **HOW)


def test_results_of_clips_of_other_lengths_are_not_merged() -> None:
    parts = [
        posecal.evaluate(HYPOTHESES[:, part, :t], TRUTH[part, :t], labels={"clip": [name] * 8}, metrics="ade", **HOW)
        for part, t, name in ((slice(0, 8), 5, "a"), (slice(8, 16), 4, "b"))
    ]
    with pytest.raises(PoseDataError, match=r"have clips of T = 5 and 4 frames \(0: none\); expected the same"):
        posecal.merge_totals([part.totals for part in parts])
