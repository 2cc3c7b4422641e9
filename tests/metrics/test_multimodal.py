"""MMADE, MMFDE and APDE are what plain loops over sets of truths give, which the last observed poses make."""

from __future__ import annotations

import numpy as np
import pytest

import posecal
from posecal.errors import PoseDataError
from posecal.metrics import apde, mmade, mmfde
from tests.metrics.test_displacement import Motion, apart, distance, motion

WORLD = motion(3, C=8)
THRESHOLD = 550.0
NAMES = ["mmade", "mmfde", "apde"]


def sets_of(world: Motion, threshold: float = THRESHOLD) -> list[list[int]]:
    poses = world.observed
    return [[s for s in range(len(poses)) if distance(poses[s], poses[c]) < threshold] for c in range(len(poses))]


def plain(world: Motion, sets: list[list[int]]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {name: [] for name in NAMES}
    for c, alike in enumerate(sets):
        x, frames = world.x[:, c], range(world.y.shape[1])
        ade = [min(np.mean([distance(h[t], world.y[s, t]) for t in frames]) for h in x) for s in alike]
        fde = [min(distance(h[-1], world.y[s, -1]) for h in x) for s in alike]
        found["mmade"].append(float(np.mean(ade)))
        found["mmfde"].append(float(np.mean(fde)))
        found["apde"].append(abs(apart(x) - apart(world.y[alike])) if len(alike) > 1 else np.nan)
    return found


SETS = sets_of(WORLD)
EXPECTED = plain(WORLD, SETS)
DECLARED = {"axes": "NMTKD", "unit": "mm", "root_joint": "none", "metrics": NAMES}


def report_of(world: Motion = WORLD, **options: object) -> posecal.Report:
    protocol = posecal.Protocol(**{"mm_threshold": THRESHOLD, **options.pop("protocol", {})})  # type: ignore[arg-type, dict-item]
    declared = {**DECLARED, "observed": world.observed, "protocol": protocol, **options}
    return posecal.evaluate(world.x, world.y, **declared)  # type: ignore[arg-type]


def test_the_sets_of_this_world_differ_and_one_is_of_one_clip() -> None:
    assert len({len(alike) for alike in SETS}) > 2
    assert min(map(len, SETS)) == 1


@pytest.mark.parametrize("function", [mmade, mmfde, apde])
def test_each_clip_has_what_plain_loops_give(function: object) -> None:
    found = function(WORLD.x, WORLD.y, WORLD.observed, threshold=THRESHOLD, axes="NMTKD", unit="mm")  # type: ignore[operator]
    np.testing.assert_allclose(found, EXPECTED[function.__name__], rtol=1e-9)  # type: ignore[attr-defined]


def test_the_report_holds_their_means_over_clips() -> None:
    report = report_of()
    for name in NAMES:
        assert report[name] == pytest.approx(np.nanmean(EXPECTED[name]), rel=1e-9)


def test_clips_alone_in_their_set_can_be_left_out() -> None:
    report = report_of(protocol={"mm_alone": "drop"})
    several = [c for c, alike in enumerate(SETS) if len(alike) > 1]
    assert report["mmade"] == pytest.approx(np.mean([EXPECTED["mmade"][c] for c in several]))
    assert report.count("mmfde") == len(several) < len(SETS)


def test_sets_of_single_clips_give_the_errors_of_the_truth() -> None:
    report = report_of(protocol={"mm_threshold": 1.0}, metrics="ade, fde, mmade, mmfde, apde")
    assert report["mmade"] == pytest.approx(report["ade"], rel=1e-12)
    assert report["mmfde"] == pytest.approx(report["fde"], rel=1e-12)
    assert np.isnan(report["apde"])


def test_poses_are_compared_relative_to_the_root_in_one_unit() -> None:
    moved = Motion(WORLD.x / 1000 + 5, WORLD.y / 1000 - 3, WORLD.observed / 1000 + 2)
    relative = Motion(*(a - a[..., :1, :] for a in (WORLD.x, WORLD.y, WORLD.observed)))
    report = report_of(moved, unit="m", root_joint=0)
    for name, values in plain(relative, sets_of(relative)).items():
        assert report[name] == pytest.approx(np.nanmean(values), rel=1e-7)


def test_a_file_holds_the_observed_poses(tmp_path: object) -> None:
    np.savez(f"{tmp_path}/gt.npz", truth=WORLD.y, observed=WORLD.observed, axes="MTKD", unit="mm")
    np.savez(f"{tmp_path}/hyps.npz", hypotheses=WORLD.x, axes="NMTKD", unit="mm")
    options = {"root_joint": "none", "metrics": NAMES, "protocol": posecal.Protocol(mm_threshold=THRESHOLD)}
    report = posecal.evaluate(f"{tmp_path}/hyps.npz", f"{tmp_path}/gt.npz", **options)  # type: ignore[arg-type]
    assert report.scalars() == report_of().scalars()


def test_batches_need_the_true_clips_that_were_prepared() -> None:
    data = posecal.PoseData(WORLD.x, WORLD.y, observed=WORLD.observed, axes="NMTKD", unit="mm", root_joint="none")
    options = {**DECLARED, "protocol": posecal.Protocol(mm_threshold=THRESHOLD)}
    evaluation = posecal.Evaluation(prepared=posecal.prepare(data), **options)  # type: ignore[arg-type]
    for part in (slice(0, 3), slice(3, 8)):
        evaluation.update(WORLD.x[:, part], WORLD.y[part])
    report = evaluation.compute()
    assert report.scalars() == pytest.approx(report_of().scalars(), rel=1e-12)
    unprepared = posecal.Evaluation(**options)  # type: ignore[arg-type]
    with pytest.raises(PoseDataError, match="mmade needs the last observed pose of each clip"):
        unprepared.update(WORLD.x, WORLD.y)


def test_shards_that_found_their_own_sets_are_merged_without_them() -> None:
    parts = [
        report_of(
            Motion(WORLD.x[:, part], WORLD.y[part], WORLD.observed[part]),
            metrics=[*NAMES, "ade"],
            labels={"sequence": np.arange(8)[part]},
        ).totals
        for part in (slice(0, 4), slice(4, 8))
    ]
    merged = posecal.Report(posecal.merge_totals(parts))
    assert {*merged.metrics} == {"ade"}
    assert any("mmade, mmfde and apde are left out" in remark for remark in merged.remarks)


def test_without_observed_poses_they_are_refused_by_name_and_one_line_by_default() -> None:
    with pytest.raises(PoseDataError, match=r"metrics: mmade needs the last observed pose of each clip \(a member"):
        report_of(observed=None)
    remarks = report_of(observed=None, metrics="default").remarks
    assert [r for r in remarks if r.startswith("left out: mmade, mmfde, apde, which need the last observed pose")]


@pytest.mark.parametrize(
    ("observed", "message"),
    [
        (WORLD.observed[:5], r"observed \(5, 4, 3\); expected the last observed pose of each clip, \(M, K, D\) with M"),
        (WORLD.observed[:, :3], r"observed \(8, 3, 3\); expected the last observed pose"),
        (np.where(np.arange(8)[:, None, None] == 2, np.nan, WORLD.observed), "observed has non-finite coordinates"),
    ],
)
def test_observed_poses_that_do_not_fit_are_refused(observed: object, message: str) -> None:
    with pytest.raises(PoseDataError, match=message):
        report_of(observed=observed)


def test_observed_poses_without_clips_are_refused() -> None:
    x, y = WORLD.x.reshape(5, 32, 4, 3), WORLD.y.reshape(32, 4, 3)
    with pytest.raises(PoseDataError, match="observed without clips; expected axes with a T, or a label clip"):
        posecal.evaluate(x, y, unit="mm", observed=WORLD.observed)


def test_functions_refuse_clips_of_other_lengths_and_other_observed_poses() -> None:
    x, y = WORLD.x.reshape(5, 32, 4, 3), WORLD.y.reshape(32, 4, 3)
    with pytest.raises(PoseDataError, match=r"^clip: 12 to 20 frames; expected one length"):
        mmade(x, y, WORLD.observed[:2], clip=np.repeat([0, 1], [12, 20]), unit="mm")
    with pytest.raises(PoseDataError, match=r"^observed \(7, 4, 3\): expected a pose for each clip"):
        mmfde(WORLD.x, WORLD.y, WORLD.observed[:7], axes="NMTKD", unit="mm")
    with pytest.raises(PoseDataError, match=r"\(1, 4, 3\)\. Without clip=, all poses are one clip\.$"):
        mmade(x, y, WORLD.observed, axes="NMKD", unit="mm")


def test_batches_with_observed_poses_are_told_to_be_prepared() -> None:
    evaluation = posecal.Evaluation(metrics="mmade", unit="mm", axes="NMTKD", truth_axes="MTKD")
    with pytest.raises(PoseDataError, match=r"in batches, also prepared=posecal\.prepare\(poses\)"):
        evaluation.update(WORLD.x, WORLD.y)
