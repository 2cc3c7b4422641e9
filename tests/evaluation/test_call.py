"""Evaluation in one call: every pose once, the joints that count, options, and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from posecal.data.pose_data import PoseData
from posecal.engine import chunks
from posecal.engine.block import Block
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError
from posecal.evaluation import evaluate
from posecal.metrics import diversity, min_mpjpe, mpjpe, mpjve, radius
from posecal.report.report import Report
from posecal.stats.skill import climatology, with_reference
from tests.helpers import oracles
from tests.helpers.random_worlds import JOINTS, World, skewed, world
from tests.helpers.sums import accumulate

Array = npt.NDArray[np.floating]

N, M, K = 5, 12, 4


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(0, N, M, K)


@pytest.fixture
def some() -> World:
    return world(2, M=M)


# --- of arrays -------------------------------------------------------------------------------------------------------


def test_the_report_s_numbers_are_the_means_of_the_functions_of_arrays(arrays: tuple[Array, Array]) -> None:
    report = evaluate(*arrays, root_joint="none")
    np.testing.assert_allclose(report.value("min_mpjpe"), min_mpjpe(*arrays).mean())
    np.testing.assert_allclose(report.value("mpjpe"), mpjpe(*arrays).mean())
    np.testing.assert_allclose(report.value("pa_min_mpjpe"), min_mpjpe(*arrays, align="similarity").mean())
    np.testing.assert_allclose(report.value("diversity"), diversity(*arrays).mean())
    np.testing.assert_allclose(report.value("radius_50"), radius(*arrays).mean())


def test_a_mask_says_which_joints_count(arrays: tuple[Array, Array]) -> None:
    where = np.random.default_rng(1).random((M, K)) < 0.7
    where[3] = False
    report = evaluate(*arrays, where=where, root_joint="none")
    np.testing.assert_allclose(report.value("min_mpjpe"), np.nanmean(min_mpjpe(*arrays, where=where)))
    row = next(row for row in report.rows if row.metric == "min_mpjpe")
    assert row.poses == M - 1


def test_named_joints_make_the_hip_the_root(some: World) -> None:
    report = evaluate(some.x, some.y, joints=JOINTS)
    np.testing.assert_allclose(report.value("min_mpjpe"), min_mpjpe(some.x, some.y, root=JOINTS.index("Hip")).mean())
    assert "origin=Hip" in report.signature


@pytest.mark.parametrize(("root_joint", "root"), [("Head", JOINTS.index("Head")), ("5", 5), ("none", None)])
def test_another_root_may_be_named(some: World, root_joint: str, root: int | None) -> None:
    report = evaluate(some.x, some.y, joints=JOINTS, root_joint=root_joint)
    np.testing.assert_allclose(report.value("min_mpjpe"), min_mpjpe(some.x, some.y, root=root).mean())


def test_the_one_unnamed_joint_that_rests_at_the_origin_is_the_root(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    y[:, 2] = 0
    assert "origin=joint_2" in evaluate(x, y).signature


@pytest.mark.parametrize(("unit", "factor"), [("m", 1000), ("cm", 10), ("1/0.0036", 1 / 0.0036)])
def test_lengths_are_turned_into_millimetres(arrays: tuple[Array, Array], unit: str, factor: float) -> None:
    x, y = arrays
    report = evaluate(x / factor, y / factor, unit=unit, root_joint="none")
    np.testing.assert_allclose(report.value("min_mpjpe"), min_mpjpe(x, y).mean())


def test_other_layouts_are_declared(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    report = evaluate(x.transpose(1, 0, 3, 2), y, axes="MNDK", root_joint="none")
    np.testing.assert_allclose(report.value("min_mpjpe"), min_mpjpe(x, y).mean())


def test_whole_numbers_are_lengths_too(arrays: tuple[Array, Array]) -> None:
    x, y = (array.astype(np.int16) for array in arrays)
    np.testing.assert_allclose(evaluate(x, y, root_joint="none").value("mpjpe"), mpjpe(x, y).mean())


def test_a_protocol_may_be_a_preset_s_name(some: World) -> None:
    report = evaluate(some.x, some.y, joints=JOINTS, protocol="gfpose", labels={"action": some.action})
    assert {row.metric for row in report.rows if row.joint is None} == {"min_mpjpe", "pa_min_mpjpe", "diversity"}
    assert "align=reflection" in report.signature


def test_groups_are_over_their_poses(some: World) -> None:
    report = evaluate(some.x, some.y, labels={"action": some.action}, by=["action"], root_joint="none")
    for action in np.unique(some.action):
        kept = some.action == action
        expected = min_mpjpe(some.x[:, kept], some.y[kept]).mean()
        np.testing.assert_allclose(report.value("min_mpjpe", group=f"action={action}"), expected)


def test_scores_and_frames_per_second_reach_their_metrics(some: World) -> None:
    names = "weighted_pose_mpjpe, mode_mpjpe, mpjve"
    report = evaluate(
        some.x,
        some.y,
        labels={"sequence": some.sequence},
        scores=some.scores,
        fps=50,
        protocol=Protocol(metrics=names, velocity="second"),
        root_joint="none",
    )
    everywhere = np.ones(some.y.shape[:2], dtype=bool)
    for of in ("weighted_pose", "mode"):
        expected = oracles.pose_errors(oracles.one_pose(some.x, of, some.scores), some.y, everywhere).mean()
        np.testing.assert_allclose(report.value(f"{of}_mpjpe"), expected)
    velocity = mpjve(some.x, some.y, sequence=some.sequence, fps=50)
    np.testing.assert_allclose(report.value("mpjve"), np.nanmean(velocity))


def test_one_hypothesis_has_an_accuracy(arrays: tuple[Array, Array]) -> None:
    x, y = arrays
    report = evaluate(x[:1], y, root_joint="none")
    np.testing.assert_allclose(report.value("min_mpjpe"), mpjpe(x[:1], y).mean())
    assert "ece" not in {row.metric for row in report.rows}


def test_occluded_joints_are_scored_by_themselves(some: World) -> None:
    report = evaluate(some.x, some.y, occluded=some.occluded, protocol=Protocol(where="occluded"), root_joint="none")
    expected = np.nanmean(min_mpjpe(some.x, some.y, where=some.occluded))
    np.testing.assert_allclose(report.value("min_mpjpe"), expected)


# --- a reference -----------------------------------------------------------------------------------------------------


def test_skills_are_relative_to_climatology_arrays_or_pose_data(some: World) -> None:
    given = {"unit": "mm", "axes": "NMKD", "labels": {"sequence": some.sequence}, "root_joint": "none"}
    data = PoseData(some.x, some.y, **given)  # type: ignore[arg-type]
    other = some.y + 90 * np.random.default_rng(4).standard_normal((N + 3, *some.y.shape))
    scores: dict[str, float] = {}
    for name, reference, pairs in (
        ("climatology", "climatology", climatology(data)),
        ("arrays", other, PoseData(other, some.y, **given)),  # type: ignore[arg-type]
    ):
        expected = Report(accumulate(with_reference(data, pairs), Protocol(metrics="scores")))["crps_skill"]
        report = evaluate(some.x, some.y, reference=reference, metrics="scores", scores=some.scores, **given)  # type: ignore[arg-type]
        assert report["crps_skill"] == expected
        assert evaluate(data, reference=pairs, metrics="scores")["crps_skill"] == expected
        scores[name] = expected
    assert evaluate(data, reference="climatology", metrics="scores")["crps_skill"] == scores["climatology"]
    assert scores["arrays"] != scores["climatology"]
    with pytest.raises(PoseDataError, match=r'^reference: expected "climatology" or PoseData where the data are PoseD'):
        evaluate(data, reference=other, metrics="scores")


# --- which poses -----------------------------------------------------------------------------------------------------


def with_label(some: World, **labels: npt.ArrayLike) -> PoseData:
    pairs = some.pairs
    return pairs.replace(labels={**pairs.labels, **{name: np.array(v).astype(str) for name, v in labels.items()}})


@pytest.mark.parametrize("yes", ["yes", "1", "True", "true", "YES"])
def test_only_the_frames_of_a_label_are_scored(some: World, yes: str) -> None:
    hard = np.arange(M) % 3 == 0
    totals = accumulate(with_label(some, hard=np.where(hard, yes, "no")), Protocol(frames="hard"))
    expected = some.select(np.flatnonzero(hard)).totals(Protocol())
    assert totals.poses.sum() == hard.sum()
    np.testing.assert_allclose(totals.sums["errors"].sum(axis=0), expected.sums["errors"].sum(axis=0))


def test_a_step_over_frames_that_are_left_out_is_no_velocity(some: World) -> None:
    one = replace(some, sequence=np.full(M, "one"))
    hard = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1, 0, 1, 1], dtype=bool)
    protocol = Protocol(frames="hard", metrics="mpjve")
    totals = accumulate(with_label(one, hard=np.where(hard, "yes", "no")), protocol)
    known = hard & np.concatenate([[False], hard[:-1]])
    expected = mpjve(one.x, one.y, root=one.root)[known]
    assert totals.counts["mpjve"].sum() == known.sum() == 4
    np.testing.assert_allclose(totals.sums["mpjve"].sum(), expected.sum())


@pytest.mark.parametrize("window", [1, 4000, 10**9])
@pytest.mark.parametrize("block", [1, 3000, 10**9])
def test_every_pose_is_in_one_block_in_the_order_of_the_poses(
    some: World, window: int, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunks, "WINDOW_BYTES", window)
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", block)
    blocks = list(chunks.map_blocks(some.pairs, lambda block: block))
    one = Block(some.x, some.y, root=some.root)
    for name in ("offsets", "truth"):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in blocks]), getattr(one, name))
    np.testing.assert_array_equal(np.concatenate([block.scores for block in blocks]), some.scores.T)


def test_a_velocity_is_of_both_poses_across_windows(some: World, monkeypatch: pytest.MonkeyPatch) -> None:
    where = np.random.default_rng(5).random(some.y.shape[:2]) < 0.7
    where[:, some.joints.index("Hip")] = True
    offsets = oracles.relative(some.x, some.root) - oracles.relative(some.y, some.root)
    monkeypatch.setattr(chunks, "WINDOW_BYTES", 1)
    totals = accumulate(some.pairs.replace(where=where), Protocol(metrics="mpjve, acceleration_error"))
    for order, name in ((1, "mpjve"), (2, "acceleration_error")):
        expected = oracles.motion(offsets, where, list(some.sequence), order)
        np.testing.assert_allclose(totals.sums[name].sum(), np.nansum(expected))
        assert totals.counts[name].sum() == (~np.isnan(expected)).sum() > 0


@pytest.mark.parametrize("metrics", ["acceleration_error", "jitter"])
def test_what_is_not_finite_before_a_block_is_refused_as_elsewhere(
    some: World, metrics: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    x = some.x.copy()
    x[:, 1:3, 3] = np.inf  # in a row: their difference is no number
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 3 * x[:, 0].nbytes)
    with pytest.raises(PoseDataError, match=r"non-finite coordinates in 2 of .* \(first: frame 1, joint"):
        evaluate(x, some.y, unit="mm", axes="NMKD", labels={"sequence": some.sequence}, metrics=metrics)


def test_sums_are_kept_per_sequence(some: World) -> None:
    totals = accumulate(some.pairs, Protocol(metrics="mpjpe"))
    errors = mpjpe(some.x, some.y, root=some.root)
    for sequence, sums, poses in zip(totals.cells["sequence"], totals.sums["errors"], totals.poses, strict=True):
        kept = some.sequence == sequence
        assert poses == kept.sum()
        np.testing.assert_allclose(sums[1], errors[kept].sum())


def test_a_sequence_that_comes_again_is_one_cell() -> None:
    some = world(3, M=M)
    again = replace(some, sequence=np.array((["a"] * 3 + ["b"] * 3) * 2))
    totals = accumulate(again.pairs, Protocol(metrics="mpjpe"))
    assert totals.cells["sequence"].tolist() == ["a", "b"]
    assert totals.poses.tolist() == [6, 6]


@pytest.mark.parametrize("threads", [1, 3])
def test_progress_counts_the_poses_that_are_done(some: World, threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 1)
    seen: list[int] = []
    accumulate(some.pairs, threads=threads, progress=seen.append)
    assert seen == list(range(1, M + 1))


def test_only_statistics_that_are_asked_for_are_added_up(some: World) -> None:
    assert set(accumulate(some.pairs, Protocol(metrics="pck")).sums) == {"truth", "pck"}
    assert {"errors_by_n", "pck_curve", "cps_curve"} <= set(accumulate(some.pairs).sums)


def test_a_name_with_all_in_it_does_not_ask_for_all(some: World) -> None:
    found = accumulate(some.pairs, Protocol(metrics="fall"), preranks={"fall": lambda pool: pool[:, 0, 2]})
    assert set(found.sums) == {"truth", "standardized_errors", "fall"}


def test_poses_are_grouped_by_their_predicted_spread(some: World) -> None:
    totals = accumulate(some.pairs, Protocol(metrics="mpjpe"), by=["predicted_spread:2"])
    x, moving = oracles.relative(some.x, some.root), np.arange(len(JOINTS)) != some.root
    spread = oracles.deviations(x, 1)[:, moving].mean(axis=1)
    wide = spread >= np.median(spread)
    errors = mpjpe(some.x, some.y, root=some.root)
    for name, cells in totals.groups("predicted_spread:2"):
        kept = wide if name.startswith("2") else ~wide
        np.testing.assert_allclose(totals.sums["errors"][cells].sum(axis=0)[1], errors[kept].sum())


def test_a_pre_rank_of_one_s_own_is_ranked(some: World) -> None:
    """Of the height of the second joint, as its coordinate's own rank."""
    own = {"height": lambda pool: pool[:, 0, 2]}
    totals = accumulate(some.pairs, Protocol(metrics="height, coordinate_pit"), preranks=own)
    joint = next(k for k in range(len(JOINTS)) if k != some.root)
    np.testing.assert_allclose(totals.sums["height"][:, 0], totals.sums["coordinate_pit"][:, joint, 2])


def test_a_pre_rank_that_gives_something_else_is_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"prerank: gave \(3,\) for a pool of 6 poses; expected one finite number"):
        accumulate(some.pairs, Protocol(metrics="odd"), preranks={"odd": lambda pool: pool[0, 0]})


# --- what is refused -------------------------------------------------------------------------------------------------


def test_frames_of_a_label_that_is_not_there_are_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"frames: truth has no label 'hard'; expected a yes/no member \(M,\)"):
        accumulate(some.pairs, Protocol(frames="hard"))


def test_frames_of_which_there_is_none_are_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"frames: no pose of truth has the label hard; expected some\."):
        accumulate(with_label(some, hard=["no"] * M), Protocol(frames="hard"))


def test_occluded_joints_that_nobody_marked_are_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"where: truth does not say which joints are occluded; expected a member"):
        accumulate(some.pairs.replace(occluded=None), Protocol(where="occluded"))


def test_joints_that_are_not_scored_and_have_no_coordinates_take_no_part_in_the_fit(some: World) -> None:
    occluded = some.occluded & (np.arange(len(JOINTS)) != some.root)
    x, y = some.x.copy(), some.y.copy()
    x[1, occluded & (np.arange(M) % 2 == 0)[:, None]], y[occluded & (np.arange(M) % 2 == 1)[:, None]] = np.nan, np.inf
    holed = replace(some, x=x, y=y, occluded=occluded)
    found = accumulate(holed.pairs, Protocol(where="visible", metrics="pa_mpjpe, cps"))
    expected = accumulate(replace(holed, where=~occluded).pairs, Protocol(metrics="pa_mpjpe, cps"))
    for name in ("pa_errors", "cps"):
        np.testing.assert_array_equal(found.sums[name], expected.sums[name])


def test_no_joint_to_score_is_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"where: no joint of truth is visible; expected some to score\."):
        accumulate(replace(some, occluded=np.ones_like(some.occluded)).pairs, Protocol(where="visible"))


@pytest.mark.parametrize("block", [1, 3000, 10**9])
@pytest.mark.parametrize("side", ["truth", "hypotheses"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_refused_with_its_frames_and_joint(
    some: World, side: str, value: float, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", block)
    x, y = some.x.copy(), some.y.copy()
    for m in (3, 7):
        if side == "truth":
            y[m, 5, 1] = value
        else:
            x[2, m, 5, 1] = value
    words = rf"{side} has non-finite coordinates in 2 of 12 frames \(first: frame 3, joint LWrist\)\. Mask those joints"
    with pytest.raises(PoseDataError, match=words):
        accumulate(replace(some, x=x, y=y).pairs)


def test_what_is_not_finite_is_passed_over_where_it_does_not_count(some: World) -> None:
    where = np.ones((M, len(JOINTS)), dtype=bool)
    where[3, 5] = False
    y = some.y.copy()
    y[3, 5] = np.nan
    masked = replace(some, where=where)
    expected = accumulate(masked.pairs).sums
    for name, sums in accumulate(replace(masked, y=y).pairs).sums.items():
        np.testing.assert_array_equal(sums, expected[name])


@pytest.mark.parametrize("where", [np.full((M, K), 2), np.ones((K, M), dtype=bool)])
def test_a_mask_of_another_type_or_shape_is_refused(arrays: tuple[Array, Array], where: npt.ArrayLike) -> None:
    with pytest.raises(PoseDataError, match=r"where: .*; expected bool \(M, K\) = \(12, 4\)"):
        evaluate(*arrays, where=where)


def test_arrays_of_no_real_numbers_are_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"truth: dtype complex128; expected real numbers such as float32\."):
        evaluate(arrays[0], arrays[1].astype(complex))


def test_an_unknown_preset_is_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"preset: 'gfpos' is not known\. Did you mean gfpose\?"):
        evaluate(*arrays, protocol="gfpos")


def test_a_label_to_group_by_that_is_not_there_is_refused(some: World) -> None:
    with pytest.raises(PoseDataError, match=r"by: 'camera' is not a label of these poses\. Known: "):
        accumulate(some.pairs, by=["camera"])


def test_an_average_over_a_label_that_is_not_there_is_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"^average: 'action' is not a label of these poses\."):
        evaluate(*arrays, protocol=Protocol(average="action"))


def test_an_average_over_runs_of_frames_is_refused(arrays: tuple[Array, Array]) -> None:
    with pytest.raises(PoseDataError, match=r"^average: 'sequence' is not a label of these poses\."):
        evaluate(*arrays, protocol=Protocol(average="sequence"))
