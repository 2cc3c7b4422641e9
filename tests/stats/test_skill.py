"""Skill: how much better than drawing the poses of others, and what ignoring the image is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posecal.engine import chunks
from posecal.engine.block import Block, block_length
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.metrics.proper import joint_energies
from posecal.report.report import Report
from posecal.stats import skill
from posecal.stats.skill import ClimatologyPool, climatology, with_reference
from tests.helpers.random_worlds import skewed
from tests.helpers.samplers import gaussian, pairs_of, sequences
from tests.helpers.sums import accumulate

Array = np.ndarray
SCORES = Protocol(metrics="scores, ece")
LABELS = np.array(["b", "a", "a", "c", "b", "c", "a", "d"])


def read(pairs: object) -> Array:
    return pairs.hypotheses.read(0, len(pairs.truth))  # type: ignore[attr-defined, no-any-return]


def test_climatology_draws_true_poses_of_other_sequences_all_alike() -> None:
    x, y = skewed(0, 3, 8, 2)
    found = read(climatology(pairs_of(x, y, labels={"sequence": LABELS}), 600))
    for m in range(8):
        drawn = [int(np.flatnonzero((pose == y).all(axis=(1, 2)))[0]) for pose in found[:, m]]
        others = np.flatnonzero(LABELS[m] != LABELS)
        counts = np.bincount(drawn, minlength=8)[others]
        assert counts.sum() == 600
        share = 1 / len(others)
        np.testing.assert_allclose(counts / 600, share, atol=4 * np.sqrt(share * (1 - share) / 600))


def test_without_sequences_any_other_pose_is_drawn() -> None:
    x, y = skewed(1, 3, 6, 2)
    found = read(climatology(pairs_of(x, y), 100))
    assert found.shape == (100, 6, 2, 3)
    for m in range(6):
        drawn = {int(np.flatnonzero((pose == y).all(axis=(1, 2)))[0]) for pose in found[:, m]}
        assert drawn == set(range(6)) - {m}


def test_climatology_has_as_many_hypotheses_and_is_the_same_every_time() -> None:
    pairs = pairs_of(*skewed(2, 7, 9, 2))
    np.testing.assert_array_equal(read(climatology(pairs)), read(climatology(pairs)))
    assert climatology(pairs).shape == pairs.shape
    assert climatology(pairs).names == ("climatology", "truth")
    assert (read(climatology(pairs, seed=1)) != read(climatology(pairs))).any()
    poses = np.array([3, 1])
    np.testing.assert_array_equal(read(climatology(pairs).select(poses)), read(climatology(pairs))[:, poses])


def test_parts_draw_what_the_whole_draws_in_any_order(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = skewed(5, 3, 40, 3)
    labels = {"sequence": np.array([f"s{m // 5}" for m in range(40)])}
    whole = pairs_of(x, y, labels=labels)
    parts = [whole.select(rows) for rows in (np.arange(1, 40, 2), np.arange(0, 40, 2))]
    for most in (100, 17):  # all poses, or some
        monkeypatch.setattr(skill, "MOST_POSES", most)
        pool = ClimatologyPool.joined([ClimatologyPool.of(part) for part in parts])
        assert len(pool.keys) == min(40, most)
        assert pool.hash == ClimatologyPool.of(whole).hash
        expected = read(climatology(whole, 30))
        np.testing.assert_array_equal(read(climatology(parts[0], 30, pool=pool)), expected[:, 1::2])
        for m in range(40):
            drawn = [int(np.flatnonzero((pose == y).all(axis=(1, 2)))[0]) // 5 for pose in expected[:, m]]
            assert m // 5 not in drawn


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"n_hypotheses": -1}, r"^n_hypotheses: -1; expected a whole number, at least 1\.$"),
        ({"n_hypotheses": 0}, r"^n_hypotheses: 0; expected a whole number, at least 1\.$"),
        ({"n_hypotheses": 2.0}, r"^n_hypotheses: 2\.0; expected a whole number, at least 1\.$"),
        ({"seed": "a"}, r"^seed: 'a'; expected a whole number, at least 0\.$"),
        ({"seed": -1}, r"^seed: -1; expected a whole number, at least 0\.$"),
        ({"seed": True}, r"^seed: True; expected a whole number, at least 0\.$"),
    ],
)
def test_numbers_that_are_none_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        climatology(pairs_of(*skewed(2, 7, 9, 2)), **changes)


def test_climatology_is_of_pose_data() -> None:
    with pytest.raises(PoseDataError, match=r"^pairs: ndarray; expected PoseData\.$"):
        climatology(np.zeros((3, 4, 2, 3)))  # type: ignore[arg-type]


def test_one_sequence_has_no_others_to_draw_from() -> None:
    pairs = pairs_of(*skewed(3, 2, 5, 2), labels={"sequence": ["a"] * 5})
    with pytest.raises(PoseDataError, match=r"^truth: one sequence; climatology samples complete poses of other seq"):
        climatology(pairs)


def test_a_sequence_that_has_all_complete_poses_has_no_others_to_draw_from() -> None:
    x, y = skewed(3, 2, 5, 2)
    where = np.array([[True, True]] * 3 + [[True, False]] * 2)
    pairs = pairs_of(x, y, where=where, labels={"sequence": ["a"] * 3 + ["b"] * 2})
    with pytest.raises(PoseDataError, match=r"^truth: too few true poses without missing joints; climatology samples"):
        climatology(pairs)


def test_a_reference_has_at_least_two_hypotheses() -> None:
    x, y = skewed(3, 2, 5, 2)
    pairs = pairs_of(x, y)
    assert with_reference(pairs, pairs_of(x[:2], y)).reference is not None
    with pytest.raises(PoseDataError, match=r"^hypotheses: N = 1; fair scores need at least 2\."):
        with_reference(pairs, pairs_of(x[:1], y))


# --- skills -----------------------------------------------------------------------------------------------------------


def skilled(x: Array, y: Array, S: int) -> Report:
    pairs = pairs_of(x, y, labels={"sequence": sequences(len(y), S)})
    return Report(accumulate(with_reference(pairs, climatology(pairs)), SCORES, threads=1))


def test_a_skill_is_the_share_of_the_reference_s_score_that_is_saved() -> None:
    x, y = gaussian(4, 8, 40, 3)
    pairs = pairs_of(x, y, labels={"sequence": sequences(40, 8)})
    ours, theirs = (Report(accumulate(p, SCORES, threads=1)) for p in (pairs, climatology(pairs)))
    found = skilled(x, y, 8)
    for score in ("energy_score", "joint_energy_score", "crps", "variogram_score"):
        name = score.removesuffix("_score") + "_skill"
        if theirs.value(score) > 0:
            np.testing.assert_allclose(found.value(name), 1 - ours.value(score) / theirs.value(score), rtol=1e-9)
    row = next(row for row in found.rows if row.metric == "energy_skill")
    assert 0.5 < row.low < row.value < row.high < 1
    assert "S_ref: the same of climatology, fair in its N=8" in row.definition


def test_a_model_that_ignores_the_image_is_calibrated_and_has_no_skill() -> None:
    random = np.random.default_rng(5)
    M, N, S = 240, 20, 60
    y, x = random.normal(0, 80, (M, 4, 3)), random.normal(0, 80, (N, M, 4, 3))  # the prior, whatever is seen
    found = skilled(x, y, S)
    row = next(row for row in found.rows if row.metric == "energy_skill")
    assert row.low < 0.01
    assert abs(row.value) < 0.05
    assert found.test("ece").p > 0.01
    knowing, truth = gaussian(6, N, M, 4)
    assert skilled(knowing, truth, S).value("energy_skill") > 0.5


def test_the_brier_skill_is_about_the_model_s_own_median_for_both() -> None:
    x, y = gaussian(7, 9, 30, 3)
    other = 200 * np.random.default_rng(8).standard_normal((14, 30, 3, 3)) + y  # another N
    where = np.random.default_rng(9).random((30, 3)) < 0.8
    pairs, reference = (pairs_of(h, y, where=where, labels={"sequence": sequences(30, 6)}) for h in (x, other))
    protocol = SCORES.changed({"pck_threshold": "90"})
    found = Report(accumulate(with_reference(pairs, reference), protocol, threads=2))

    def score(hypotheses: Array, m: int) -> float:
        centre, joints = np.median(x[:, m], axis=0), where[m]

        def near(pose: Array, centre: Array) -> bool:
            return bool((np.linalg.norm(pose - centre, axis=-1)[joints] < 90).all())

        def centre_of(i: int) -> Array:
            return np.median(np.delete(x[:, m], i, axis=0), axis=0) if hypotheses is x else centre

        n, p = len(hypotheses), np.mean([near(pose, centre_of(i)) for i, pose in enumerate(hypotheses[:, m])])
        return float((p - near(y[m], centre)) ** 2 - p * (1 - p) / (n - 1))

    counted = np.flatnonzero(where.any(axis=1))
    ours, theirs = (np.mean([score(hypotheses, m) for m in counted]) for hypotheses in (x, other))
    assert theirs > 0
    np.testing.assert_allclose(found.value("brier_skill"), 1 - ours / theirs, rtol=1e-9)
    row = next(row for row in found.rows if row.metric == "brier_skill")
    assert "compared with the model's own median" in row.definition


def test_skills_can_be_grouped_by_what_only_the_model_says() -> None:
    x, y = gaussian(10, 20, 60, 3)
    pairs = pairs_of(x, y, labels={"sequence": sequences(60, 12)})
    found = Report(
        accumulate(with_reference(pairs, climatology(pairs)), SCORES, by=["predicted_spread"], threads=1),
        "predicted_spread",
    )
    groups = {row.group for row in found.rows if row.metric == "energy_skill"}
    assert len(groups) == 4  # three terciles and all


def test_a_reference_on_other_poses_is_refused() -> None:
    x, y = gaussian(7, 4, 20, 2)
    pairs = pairs_of(x, y)
    with pytest.raises(PoseDataError, match=r"^hypotheses and hypotheses hold other frames: 15 and 20 \(first: 15\)"):
        with_reference(pairs, pairs_of(x[:, :15], y[:15]))
    with pytest.raises(PoseDataError, match=r"were evaluated against different true poses"):
        with_reference(pairs, pairs_of(x, y + 1))
    with pytest.raises(PoseDataError, match=r'joint 1\. Score those in both with shared_joints="common"'):
        with_reference(pairs, pairs_of(x[:, :, :1], y[:, :1]))
    with pytest.raises(PoseDataError, match=r"have other root joints: joint 1 and none; expected the same"):
        with_reference(pairs, pairs_of(x, y, root_joint="1"))
    with pytest.raises(PoseDataError, match=r"N = 1; fair scores need at least 2\. Give a reference with more"):
        with_reference(pairs, pairs_of(x[:1], y))


def test_without_scores_the_reference_is_not_read() -> None:
    x, y = gaussian(12, 4, 20, 2)
    pairs = pairs_of(x, y)
    found = accumulate(with_reference(pairs, pairs_of(x, y)), Protocol(metrics="ece"))
    assert found.signature == accumulate(pairs, Protocol(metrics="ece")).signature
    assert "reference=hypotheses,N=4" in accumulate(with_reference(pairs, pairs_of(x, y)), SCORES).signature


def test_a_perfect_reference_leaves_no_skill_to_have() -> None:
    x, y = gaussian(13, 4, 20, 3)
    found = Report(accumulate(with_reference(pairs_of(x, y), pairs_of(np.repeat(y[None], 3, axis=0), y)), SCORES))
    for name in ("energy_skill", "joint_energy_skill", "crps_skill", "variogram_skill"):
        assert np.isnan(found.value(name))


def test_no_more_of_a_reference_is_read_at_once_than_fits_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = gaussian(14, 2, 900, 2)
    many = np.repeat(x, 50, axis=0)
    length = block_length(many.shape, many.dtype)
    monkeypatch.setattr(chunks, "WINDOW_BYTES", many[:, : 2 * length + 1].nbytes)
    reference, read = pairs_of(many, y), []
    source = reference.hypotheses

    class Watched:
        n_hypotheses, itemsize = source.n_hypotheses, source.itemsize

        def read(self, start: int, stop: int) -> Array:
            read.append(stop - start)
            return source.read(start, stop)

    watched = reference.replace(hypotheses=Watched())
    accumulate(with_reference(pairs_of(x, y), watched), SCORES, threads=1)
    assert sum(read) == 900
    assert max(read) == 2 * length < 900


def test_the_reference_keeps_to_the_frames_and_joints_that_are_scored() -> None:
    x, y = gaussian(15, 8, 30, 3)
    other = 60 * np.random.default_rng(16).standard_normal((5, 30, 3, 3)) + y
    seen = np.random.default_rng(17).random((30, 3)) < 0.7
    kept = np.arange(0, 30, 2)
    protocol = SCORES.changed({"where": "visible", "frames": "good"})
    good = np.where(np.arange(30) % 2, "no", "yes")
    x[:, ~seen], other[:, ~seen], y[~seen] = np.nan, np.nan, np.nan
    pairs, reference = (pairs_of(h, y, labels={"good": good}, occluded=~seen) for h in (x, other))
    found = Report(accumulate(with_reference(pairs, reference), protocol))
    ours, theirs = (
        float(np.nanmean(joint_energies(Block(h[:, kept], y[kept], seen[kept]))[:, -1])) for h in (x, other)
    )
    np.testing.assert_allclose(found.value("energy_skill"), 1 - ours / theirs, rtol=1e-9)


def test_climatology_draws_no_pose_that_lacks_a_joint() -> None:
    x, y = skewed(18, 3, 8, 2)
    y[[1, 4], 1] = np.nan
    found = read(climatology(pairs_of(x, y, labels={"sequence": LABELS}), 300))
    assert np.isfinite(found).all()
    for m in range(8):
        drawn = {int(np.flatnonzero((pose == y).all(axis=(1, 2)))[0]) for pose in found[:, m]}
        assert drawn == {i for i in range(8) if LABELS[i] != LABELS[m] and i not in {1, 4}}
    y[:, 0, 0] = np.nan
    with pytest.raises(PoseDataError, match=r"^truth: too few true poses without missing joints; climatology samples"):
        climatology(pairs_of(x, y, labels={"sequence": LABELS}))


def test_a_reference_that_is_not_finite_is_refused_by_its_name() -> None:
    x, y = gaussian(11, 4, 20, 2)
    broken = x.copy()
    broken[1, 7, 1] = np.nan
    pairs = pairs_of(x, y)
    reference = pairs_of(broken, y).replace(names=("other.npz", "truth"))
    with pytest.raises(
        PoseDataError, match=r"^other\.npz has non-finite coordinates in 1 of 20 frames \(first: frame 7"
    ):
        accumulate(with_reference(pairs, reference), SCORES)
