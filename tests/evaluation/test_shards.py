"""Shards give the numbers of one run, however the poses are cut."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.report.report import Report
from tests.helpers.own_metrics import DEPTH
from tests.helpers.sharded import OPTIONS, cuts, frames, largest_difference

WORLD = frames()
CUTS = cuts()


@pytest.fixture(scope="module")
def one() -> Report:
    return posecal.evaluate(WORLD.data(), **OPTIONS)


def assert_equal(found: Report, expected: Report) -> None:
    rows, difference = largest_difference(expected, found)
    assert rows > 100
    assert difference < 1e-10
    assert found.signature == expected.signature


@pytest.mark.slow
@pytest.mark.parametrize("cut", CUTS)
def test_every_row_is_that_of_one_run(cut: str, one: Report) -> None:
    found = posecal.evaluate_shards([WORLD.data(rows) for rows in CUTS[cut]], threads=1, **OPTIONS)
    assert_equal(found, one)
    assert {*found.remarks} == {*one.remarks}


@pytest.mark.slow
def test_processes_give_every_row_of_one_run(one: Report) -> None:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        shards = [WORLD.data(rows) for rows in CUTS["5 strided"]]
        assert_equal(posecal.evaluate_shards(shards, map=pool.map, **OPTIONS), one)


@pytest.mark.slow
def test_workers_of_a_dask_cluster_give_every_row_of_one_run(one: Report) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        shards = [WORLD.data(rows) for rows in CUTS["7 that cut sequences"]]
        assert_equal(posecal.evaluate_shards(shards, map=client.get_executor().map, **OPTIONS), one)


def test_shards_that_cut_sequences_need_no_names_of_frames() -> None:
    options: dict[str, Any] = {"metrics": "mpjve, acceleration_error, jitter", "threads": 1}
    shards = [WORLD.data(rows, has_names=False) for rows in CUTS["7 that cut sequences"]]
    assert_equal_numbers(posecal.evaluate_shards(shards, **options), posecal.evaluate(WORLD.data(), **options))


def test_strided_shards_without_names_of_frames_have_no_steps_between_them() -> None:
    shards = [WORLD.data(rows, has_names=False) for rows in CUTS["5 strided"]]
    found = posecal.evaluate_shards(shards, metrics="mpjve", threads=1)
    assert any("no numbers in frame_id tell the order" in remark for remark in found.remarks)
    with pytest.raises(posecal.PoseDataError, match=r"since segments are of consecutive ones\.$"):
        posecal.evaluate_shards(
            [WORLD.data(rows, has_names=False, root_joint="none") for rows in CUTS["5 strided"]], metrics="wa_mpjpe"
        )


@pytest.mark.parametrize("cut", ["7 that cut sequences", "5 strided"])
def test_segments_reach_over_the_bounds_of_shards(cut: str) -> None:
    options: dict[str, Any] = {"metrics": "wa_mpjpe, w_mpjpe", "protocol": posecal.Protocol(segment=8), "threads": 1}
    one = posecal.evaluate(WORLD.data(root_joint="none"), **options)
    shards = [WORLD.data(rows, root_joint="none") for rows in CUTS[cut]]
    assert_equal_numbers(posecal.evaluate_shards(shards, **options), one)


def test_poses_without_sequences_form_the_runs_of_one_run() -> None:
    world = frames(M=450)
    options: dict[str, Any] = {"metrics": "default, tarp_box, scores", "reference": "climatology", "threads": 1}
    parts = np.split(np.arange(450), [13, 200])
    whole, *shards = (world.data(rows, labels=None) for rows in (np.arange(450), *parts))
    found, one = posecal.evaluate_shards(shards, **options), posecal.evaluate(whole, **options)
    assert_equal_numbers(found, one)
    assert len(found.totals.poses) == len(one.totals.poses) == 57  # 450 poses in runs of 8


def test_masks_of_some_shards_and_frames_that_are_not_scored_are_those_of_one_run() -> None:
    where = np.random.default_rng(1).random(WORLD.truth.shape[:2]) < 0.8
    where[:, 0] = True
    where[:40] = True
    hard = np.where(np.arange(192) % 7 < 4, "yes", "no")
    hard[150:] = "no"

    def data(rows: Any) -> posecal.PoseData:
        labels = {"sequence": WORLD.sequence[rows], "hard": hard[rows]}
        mask = None if where[rows].all() else where[rows]
        return WORLD.data(rows, labels=labels, where=mask)

    options: dict[str, Any] = {"metrics": "default, mpjve", "protocol": posecal.Protocol(frames="hard"), "threads": 1}
    shards = [data(rows) for rows in np.split(np.arange(192), [30, 77, 160])]
    assert_equal_numbers(posecal.evaluate_shards(shards, **options), posecal.evaluate(data(np.arange(192)), **options))


def test_a_shard_without_an_occluded_joint_leaves_the_numbers_of_one_run() -> None:
    occluded = np.zeros(WORLD.truth.shape[:2], dtype=bool)
    occluded[100:130, 3:5] = True

    def data(rows: Any) -> posecal.PoseData:
        return WORLD.data(rows, occluded=occluded[rows])

    protocol = posecal.Protocol(where="occluded")
    options: dict[str, Any] = {"metrics": "default, mpjve", "protocol": protocol, "threads": 1}
    shards = [data(rows) for rows in np.split(np.arange(192), [60, 133])]
    assert_equal_numbers(posecal.evaluate_shards(shards, **options), posecal.evaluate(data(np.arange(192)), **options))
    with pytest.raises(posecal.PoseDataError, match=r"^where: no joint of truth is occluded; expected some"):
        posecal.evaluate_shards(shards[::2], **options)


def test_a_remark_of_shards_names_the_first_frames_and_counts_the_others() -> None:
    where = np.ones(WORLD.truth.shape[:2], dtype=bool)
    where[[3, 4, 5, 6, 70, 150], 0] = False  # the root
    shards = [WORLD.data(rows, where=where[rows]) for rows in np.split(np.arange(192), [60, 120])]
    found = posecal.evaluate_shards(shards, metrics="mpjpe", threads=1)
    names = ", ".join(WORLD.frame_id[3:6])
    lost = f"the root Hip does not count in 6 of 192 frames (first: {names} and 3 more)"
    assert [remark for remark in found.remarks if remark.startswith(lost)]
    assert {*found.remarks} == {*posecal.evaluate(WORLD.data(where=where), metrics="mpjpe").remarks}


def test_labels_that_split_a_sequence_over_shards_make_no_cells() -> None:
    labels = [{"sequence": WORLD.sequence[rows], "shard": str(n)} for n, rows in enumerate(CUTS["5 strided"])]
    shards = [WORLD.data(rows, labels=some) for rows, some in zip(CUTS["5 strided"], labels, strict=True)]
    found = posecal.evaluate_shards(shards, metrics="min_mpjpe", threads=1)
    assert len(found.totals.poses) == 16
    assert "shard" not in found.totals.labels
    grouped = posecal.evaluate_shards(shards, metrics="min_mpjpe", by="shard", threads=1)
    assert len(grouped.totals.poses) == 16 * 5


def test_draws_from_distributions_are_those_of_one_run() -> None:
    mean, sigma = WORLD.truth + 20, np.full(WORLD.truth.shape, 30.0)

    def data(rows: slice) -> tuple[posecal.GaussianPrediction, Any]:
        return posecal.GaussianPrediction(mean[rows], sigma=sigma[rows]), WORLD.truth[rows]

    options: dict[str, Any] = {"unit": "mm", "draws": 5, "metrics": "min_mpjpe", "threads": 1}
    one = posecal.evaluate(*data(slice(None)), **options)
    found = posecal.evaluate_shards([data(slice(0, 50)), data(slice(50, 192))], **options)
    assert found["min_mpjpe"] == pytest.approx(one["min_mpjpe"], rel=1e-12)


def test_a_metric_of_one_s_own_is_known_to_other_processes() -> None:
    metric = posecal.register(DEPTH)
    try:
        shards = [WORLD.data(rows) for rows in CUTS["6 uneven"]]
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            found = posecal.evaluate_shards(shards, metrics=metric.name, map=pool.map)
        assert found[metric.name] == pytest.approx(posecal.evaluate(WORLD.data(), metrics=metric.name)[metric.name])
    finally:
        posecal.unregister(metric.name)


def assert_equal_numbers(found: Report, one: Report) -> None:
    assert largest_difference(one, found)[1] < 1e-10


def test_the_best_of_batches_is_of_the_sequences_of_one_run() -> None:
    protocol = posecal.Protocol(best="batch:3")
    shards = [WORLD.data(rows) for rows in CUTS["7 that cut sequences"]]
    found = posecal.evaluate_shards(shards, metrics="min_mpjpe, mpjve", protocol=protocol, threads=1)
    one = posecal.evaluate(WORLD.data(), metrics="min_mpjpe, mpjve", protocol=protocol)
    assert_equal_numbers(found, one)


def test_hypotheses_of_another_model_are_a_reference_shard_by_shard() -> None:
    rows = CUTS["6 uneven"]
    other = replace(WORLD, hypotheses=WORLD.hypotheses[::-1] + 5)
    pairs = [(WORLD.hypotheses[:, r], WORLD.truth[r]) for r in rows]
    options: dict[str, Any] = {"unit": "mm", "axes": "NMKD"}
    references = [other.hypotheses[:, r] for r in rows]
    found = posecal.evaluate_shards(pairs, reference=references, metrics="scores", threads=1, **options)
    one = posecal.evaluate(
        WORLD.hypotheses, WORLD.truth, reference=other.hypotheses, metrics="scores", threads=1, **options
    )
    left, right = found.scalars(), one.scalars()
    assert left.keys() == right.keys() >= {"energy_skill"}
    for name, value in right.items():
        assert left[name] == pytest.approx(value, rel=1e-10), name
