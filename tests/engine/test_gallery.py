"""The gallery holds the worst poses, whatever the batches and shards that they came in, and can be left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import posecal
from posecal.data.root import Root
from posecal.engine.gallery import FRAMES, MISSING, Gallery, number_shown, worst_rows
from posecal.engine.scope import DataSpec
from posecal.engine.storage import digest_of
from posecal.errors import PoseDataError, PoseFileError
from posecal.report.report import Report

N, M, K = 7, 90, 5
RANDOM = np.random.default_rng(3)
TRUTH = RANDOM.normal(0, 300, (M, K, 3)).round(1)
HYPOTHESES = (
    TRUTH + RANDOM.normal(0, 1, (N, M, K, 3)) * RANDOM.uniform(20, 90, (M, 1, 1)) + RANDOM.normal(0, 40, (M, K, 3))
)
CLIPS = np.array([f"clip {number}" for number in np.arange(M) // 10])


def evaluated(part: slice = slice(None), **options: object) -> Report:
    given = {"labels": {"sequence": CLIPS[part]}, "unit": "mm", "root_joint": 0, "axes": "NMKD", **options}
    return posecal.evaluate(HYPOTHESES[:, part], TRUTH[part], **given)  # type: ignore[arg-type]


def gallery_of(report: Report) -> Gallery:
    assert report.totals.gallery is not None
    return report.totals.gallery


def same(one: Gallery, other: Gallery) -> None:
    """Compare all but the order, which counts the frames of a shard."""
    first, second = np.argsort(one.frame_id), np.argsort(other.frame_id)
    for name, values in vars(one.select(first)).items():
        if name != "order":
            np.testing.assert_array_equal(values, vars(other.select(second))[name], err_msg=name)


def naive_rows(sequence: list[str], order: list[int], score: list[tuple[float, float]]) -> list[int]:
    """In rounds: of each sequence the worst pose that is left, at most one of 64 frames; the worst of a round first."""
    left = sorted(range(len(order)), key=lambda row: score[row], reverse=True)
    chosen: list[int] = []
    while left and len(chosen) < FRAMES:
        found: dict[str, int] = {}
        for row in left:
            found.setdefault(sequence[row], row)
        chosen += found.values()
        near = {(sequence[row], order[row] // 64) for row in chosen}
        left = [row for row in left if (sequence[row], order[row] // 64) not in near]
    return chosen[:FRAMES]


@pytest.mark.parametrize(("sequences", "poses"), [(1, 1000), (3, 400), (20, 60), (2, 3)])
def test_poses_are_those_of_a_plain_search(sequences: int, poses: int) -> None:
    random = np.random.default_rng(sequences)
    names = np.array([f"s{number}" for number in random.integers(sequences, size=poses)])
    order, numbers = np.arange(poses), random.uniform(0.01, 1, (poses, 4))
    numbers[:, 0] = random.integers(-5, 6, size=poses) / 10  # many are equal
    by_calibration, by_error = worst_rows(names, order, numbers)
    scores = list(zip(np.abs(numbers[:, 0]), np.abs(np.log(numbers[:, 2] / numbers[:, 1])), strict=True))
    assert by_calibration.tolist() == naive_rows(names.tolist(), order.tolist(), scores)
    errors = [(error, error) for error in numbers[:, 2].tolist()]
    assert by_error.tolist() == naive_rows(names.tolist(), order.tolist(), errors)


def test_a_pose_whose_number_is_unknown_is_not_chosen_by_it() -> None:
    numbers = np.array([[np.nan, np.nan, 3.0, 1.0], [-0.2, 1.0, 2.0, 1.0]])
    by_calibration, by_error = worst_rows(np.array(["a", "b"]), np.arange(2), numbers)
    assert (by_calibration.tolist(), by_error.tolist()) == ([1], [0, 1])


@pytest.mark.parametrize("labels", [True, False])
def test_batches_keep_the_poses_of_one_call(labels: bool) -> None:
    whole = gallery_of(evaluated() if labels else evaluated(labels=None))
    evaluation = posecal.Evaluation(unit="mm", root_joint=0, axes="NMKD")
    for start in (0, 7, 40, 41):
        part = slice(start, {0: 7, 7: 40, 40: 41}.get(start))
        names = {"sequence": CLIPS[part]} if labels else {}
        evaluation.update(HYPOTHESES[:, part], TRUTH[part], **names)
    batches = gallery_of(evaluation.compute())
    order = np.argsort(whole.numbers[:, 2]), np.argsort(batches.numbers[:, 2])
    for name in ("poses", "radii", "numbers", "sequence"):
        np.testing.assert_array_equal(vars(whole)[name][order[0]], vars(batches)[name][order[1]])


def test_shards_keep_the_poses_of_one_run() -> None:
    names = np.arange(M).astype(str)
    parts = [evaluated(part, frame_id=names[part]).totals for part in (slice(0, 30), slice(30, 35), slice(35, M))]
    same(gallery_of(Report(posecal.merge_totals(parts))), gallery_of(evaluated(frame_id=names)))


def test_poses_of_shards_without_sequences_are_named_after_these() -> None:
    parts = [evaluated(part, labels=None).totals for part in (slice(0, 40), slice(40, M))]
    assert {*gallery_of(Report(posecal.merge_totals(parts))).sequence.tolist()} == {"part 1", "part 2"}


def test_shards_of_which_one_has_no_gallery_have_none() -> None:
    parts = [evaluated(slice(0, 40)).totals, evaluated(slice(40, M), gallery=False).totals]
    assert posecal.merge_totals(parts).gallery is None


def test_what_is_kept_is_rounded_to_millimetres_relative_to_the_root() -> None:
    gallery = gallery_of(evaluated(frame_id=np.arange(M).astype(str)))
    for row, name in enumerate(gallery.frame_id.tolist()):
        x, y = (some - some[..., :1, :] for some in (HYPOTHESES[:, int(name)], TRUTH[int(name)]))
        np.testing.assert_array_equal(gallery.poses[row, 0], np.rint(y))
        np.testing.assert_array_equal(gallery.poses[row, 1], np.rint(np.median(x, axis=0)))
        np.testing.assert_array_equal(gallery.poses[row, 2:], np.rint(x))
        away = np.sort(np.linalg.norm(x - np.median(x, axis=0), axis=-1), axis=0)
        np.testing.assert_allclose(gallery.radii[row], away[[3, 6]].T, rtol=1e-12)  # 4 and 7 of 7 hold 50 and 90 %
        true = np.linalg.norm(y - np.median(x, axis=0), axis=-1)
        np.testing.assert_allclose(gallery.nearer[row], (away < true).mean(axis=0), rtol=1e-12)


def test_the_root_may_be_a_midpoint() -> None:
    gallery = gallery_of(evaluated(joints=["a", "b", "c", "d", "e"], root_joint="a+b"))
    middle = gallery.poses[:, :, [0, 1]].astype(float).mean(axis=2)
    assert np.abs(middle).max() <= 0.5
    assert evaluated(joints=["a", "b", "c", "d", "e"], root_joint="a+b").totals.spec.root == Root(((0, 1),))


def test_hypotheses_are_kept_as_often_as_their_weights() -> None:
    weights = np.zeros((N, M))
    weights[[1, 4]] = [[0.75], [0.25]]
    gallery = gallery_of(evaluated(weights=weights, frame_id=np.arange(M).astype(str)))
    first = int(gallery.frame_id[0])
    x = np.rint(HYPOTHESES[:, first] - HYPOTHESES[:, first, :1])
    np.testing.assert_array_equal(gallery.poses[0, 2:], x[[1, 1, 1, 1, 1, 4, 4]])  # places 1/14, 3/14 … 13/14


def test_joints_that_do_not_count_are_missing_and_may_hold_anything() -> None:
    where = np.ones((M, K), dtype=bool)
    where[:, 3] = False
    hypotheses = HYPOTHESES.copy()
    hypotheses[:, :, 3] = np.nan
    report = posecal.evaluate(hypotheses, TRUTH, where=where, unit="mm", root_joint=0, axes="NMKD")
    gallery = gallery_of(report)
    assert (gallery.poses[:, :, 3] == MISSING).all()
    assert (gallery.poses[:, :, [0, 1, 2, 4]] != MISSING).all()
    assert np.isnan(gallery.radii[:, 3]).all()


def test_coordinates_beyond_16_bits_and_other_units_have_a_step_of_their_own() -> None:
    far = gallery_of(posecal.evaluate(HYPOTHESES * 1000, TRUTH * 1000, unit="mm", root_joint=0, axes="NMKD"))
    assert np.abs(far.poses.astype(int)).reshape(len(far), -1).max(axis=1).tolist() == [32767] * len(far)
    near = gallery_of(posecal.evaluate(HYPOTHESES / 1e4, TRUTH / 1e4, unit="none", root_joint=0, axes="NMKD"))
    np.testing.assert_allclose(near.step * 1e7, far.step, rtol=1e-5)


@pytest.mark.parametrize(
    ("n", "k", "d", "unit", "shown"),
    [
        *((200, 17, 3, "mm", 50), (3, 17, 3, "mm", 3), (200, 133, 3, "mm", 12), (200, 6890, 3, "mm", 0)),
        *((200, 17, 2, "px", 50), (200, 17, 1, "", 0), (200, 3, 3, "deg", 0)),
    ],
)
def test_fewer_hypotheses_are_kept_of_many_joints_and_none_where_nothing_could_be_drawn(
    n: int, k: int, d: int, unit: str, shown: int
) -> None:
    assert number_shown(DataSpec(n, tuple(map(str, range(k))), unit=unit, n_coordinates=d)) == shown


def test_angles_meshes_and_those_who_want_none_have_no_gallery() -> None:
    assert evaluated(gallery=False).totals.gallery is None
    angles = posecal.evaluate(HYPOTHESES[..., :1], TRUTH[..., :1], unit="deg", axes="NMKD")
    assert angles.totals.gallery is None


def test_a_result_holds_the_gallery_unless_it_must_not(tmp_path: Path) -> None:
    report = evaluated()
    report.save(tmp_path / "with.npz")
    report.save(tmp_path / "without.npz", gallery=False)
    same(gallery_of(Report(posecal.load_totals(tmp_path / "with.npz"))), gallery_of(report))
    assert posecal.load_totals(tmp_path / "without.npz").gallery is None
    with np.load(tmp_path / "without.npz") as file:
        assert not [name for name in file.files if "gallery" in name]


@pytest.mark.parametrize("name", ["poses", "step", "sequence", "order"])
def test_a_gallery_of_another_shape_or_type_is_no_result(tmp_path: Path, name: str) -> None:
    evaluated().save(tmp_path / "result.npz")
    with np.load(tmp_path / "result.npz") as file:
        members = {key: file[key] for key in file.files if key != "digest"}
    wrong = {"poses": members["gallery/poses"][:, :-1], "step": -members["gallery/step"]}
    wrong |= {"sequence": members["gallery/order"], "order": members["gallery/order"][1:]}
    members[f"gallery/{name}"] = wrong[name]
    np.savez(tmp_path / "result.npz", **members, digest=digest_of(members))
    with pytest.raises(PoseFileError, match=r"no result of posecal evaluate --save, or not a whole one"):
        posecal.load_totals(tmp_path / "result.npz")


def test_a_gallery_is_kept_or_not() -> None:
    with pytest.raises(PoseDataError, match="gallery"):
        posecal.Evaluation(gallery="no")  # type: ignore[arg-type]


def test_a_gallery_changes_no_number() -> None:
    one, other = evaluated(), evaluated(gallery=False)
    assert one.signature == other.signature
    assert one.scalars() == other.scalars()
    assert replace(one.totals, gallery=None).sums.keys() == other.totals.sums.keys()
