"""What ``posecal evaluate`` answers: the report's own numbers, whatever form the files and the flags have."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.engine.protocol import Protocol
from posecal.errors import for_command_line
from tests.helpers.reports import world
from tests.helpers.shell import EVALUATE, JOINTS, done, hypotheses, hyps_members, refused, rows, run


def test_evaluate_writes_the_report_to_stdout_with_flags_in_its_remarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    found = run("evaluate", "hyps.npz", "gt.npz")
    report = posecal.evaluate("hyps.npz", "gt.npz")
    assert found.exit_code == 0
    assert found.stdout == report.render(words=for_command_line) + "\n"
    assert found.stderr == ""
    assert report.remarks
    for remark in report.remarks:
        assert f"note: {remark[:40]}" in found.stdout


@pytest.mark.slow
@pytest.mark.parametrize("form", ["markdown", "csv", "json"])
def test_other_formats_are_those_of_the_report(form: Any) -> None:
    text = done("evaluate", "hyps.npz", "gt.npz", "--format", form, "--by", "action", "--by", "occlusion")
    assert text == posecal.evaluate("hyps.npz", "gt.npz", by=["action", "occlusion"]).render(form) + "\n"


def test_options_reach_the_protocol() -> None:
    text = done(
        "evaluate", "hyps.npz", "gt.npz", "--format=json", "--set", "best=sequence", "--set=pck_threshold = 100",
        "--where", "occluded", "--joints", "h36m-16", "--metrics", "min_mpjpe,pck",
    )  # fmt: skip
    how = Protocol(best="sequence", pck_threshold=100.0, where="occluded", joints="h36m-16", metrics="min_mpjpe,pck")
    assert text == posecal.evaluate("hyps.npz", "gt.npz", protocol=how).render("json") + "\n"


def test_a_preset_can_be_changed() -> None:
    text = done("evaluate", "hyps.npz", "gt.npz", "--format=json", "--preset", "cgnf", "--set", "best=joint")
    how = posecal.PRESETS["cgnf"].protocol.changed({"best": "joint"})
    assert text == posecal.evaluate("hyps.npz", "gt.npz", protocol=how).render("json") + "\n"


def test_bare_arrays_of_another_layout_and_unit_are_declared_by_flags() -> None:
    np.save("hyps.npy", hypotheses().transpose(1, 0, 3, 2) / 1000)
    np.save("gt.npy", world().truth.transpose(0, 2, 1) / 10)
    text = done(
        "evaluate", "hyps.npy", "gt.npy", "--axes=MNDK", "--unit=m", "--truth-axes=MDK", "--truth-unit=cm",
        "--joint-names=h36m-17", "--format=json",
    )  # fmt: skip
    whole = rows(done("evaluate", "hyps.npz", "gt.npz", "--format=json"))
    for name in ("min_mpjpe", "pck", "ece", "diversity", "cps"):
        np.testing.assert_allclose(rows(text)[name, None, None], whole[name, None, None], rtol=1e-4)


def test_joints_in_common_are_scored_where_asked_for() -> None:
    members = hyps_members()
    names = np.array([*JOINTS[:-1], "Tail"])
    np.savez("other.npz", **{**members, "joints": names})
    assert "other.npz lacks 1 of the other's joints (RWrist)" in refused("evaluate", "other.npz", "gt.npz")
    found = run("evaluate", "other.npz", "gt.npz", "--joints", "common")
    assert "K = 16 joints" in found.stdout
    assert "note: 16 joints are in both; left out: RWrist, Tail." in found.stdout


def test_frames_that_are_missing_are_skipped_where_asked_for() -> None:
    members = hyps_members()
    some = {"hypotheses": members["hypotheses"][:, 3:], "frame_id": members["frame_id"][3:]}
    np.savez("few.npz", **{**members, **some})
    assert "few.npz lacks 3 of the 36 frames of gt.npz (first: " in refused("evaluate", "few.npz", "gt.npz")
    found = run("evaluate", "few.npz", "gt.npz", "--missing", "skip")
    assert "M = 33 poses" in found.stdout
    assert "note: few.npz lacks 3 of the 36 frames of gt.npz: skipped." in found.stdout


def test_the_first_hypotheses_are_taken_where_fewer_are_asked_for() -> None:
    np.savez("three.npz", **{**hyps_members(), "hypotheses": hypotheses()[:3]})
    fewer = done("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "3", "--format=csv")
    assert fewer == done("evaluate", "three.npz", "gt.npz", "--format=csv")


def test_one_hypothesis_has_an_accuracy_and_no_calibration() -> None:
    found = run("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "1")
    assert found.exit_code == 0
    assert "minMPJPE" in found.stdout
    assert "Calibration" not in found.stdout
    assert "note: calibration and spread need at least 2 hypotheses; there is 1." in found.stdout


def test_the_number_of_threads_changes_nothing() -> None:
    one, three = (done("evaluate", "hyps.npz", "gt.npz", "--format=json", "--threads", n) for n in ("1", "3"))
    assert one == three


@pytest.mark.parametrize("name", ["with blank.npz", "[bold]x.npz", "ünï·コ.npz", "$x_1$.npz", "-dash.npz"])
def test_files_may_have_odd_names(name: str) -> None:
    Path(name).write_bytes(Path("hyps.npz").read_bytes())
    assert done("evaluate", "--metrics=min_mpjpe", "--", name, "gt.npz")
    Path(name).unlink()
    assert refused("evaluate", "--", name, "gt.npz") == f"posecal: {name}: no such file."


@pytest.mark.parametrize(
    "by", ["sequence", "action", "predicted_spread", "predicted_spread:2", "predicted_spread=25,30", "occlusion"]
)
def test_poses_are_grouped_by_any_label_and_by_predicted_spread_and_occlusion(by: str) -> None:
    text = done(*EVALUATE, "--metrics=min_mpjpe", "--format=json", "--by", by)
    groups = {group for _, group, _ in rows(text) if group is not None}
    counts = {
        "sequence": 12,
        "action": 3,
        "predicted_spread": 3,
        "predicted_spread:2": 2,
        "predicted_spread=25,30": 3,
        "occlusion": 2,
    }
    assert len(groups) == counts[by]
    assert {group.partition("=")[0] for group in groups} == {by.replace("=", ":")}


def test_a_flag_that_is_given_wins_over_the_preset() -> None:
    text = done(*EVALUATE, "--preset=cgnf-occluded", "--where=all", "--metrics=mpjpe", "--format=json")
    like = ("--set", "joints=h36m-16", "--set", "root=drop")
    plain = done(*EVALUATE, *like, "--metrics=mpjpe", "--format=json")
    assert rows(text)["mpjpe", None, None] == rows(plain)["mpjpe", None, None]


def test_a_group_shows_metrics_that_the_whole_does_not() -> None:
    assert "MPJPE" in done(*EVALUATE, "--metrics=mpjpe", "--by=occlusion")


def test_a_saved_result_in_the_place_of_poses_is_refused_with_what_takes_it() -> None:
    assert "is a saved result and holds no poses. posecal report shows it" in refused(
        "evaluate", "result.npz", "gt.npz"
    )


def test_midpoints_and_skeletons_are_named_by_flags() -> None:
    with np.load("gt.npz") as file:
        names = file["joints"].tolist()
    text = json.dumps({"names": names, "parents": [-1, *[0] * (len(names) - 1)]})
    Path("star.json").write_text(text)
    assert f"relative to {names[0]}" in done("evaluate", "hyps.npz", "gt.npz", "--skeleton=star.json")
    of_hips = "--root-joint=LHip+right_hip"
    report = posecal.evaluate("hyps.npz", "gt.npz", root_joint="LHip+RHip", skeleton="star.json")
    assert done("evaluate", "hyps.npz", "gt.npz", of_hips, "--skeleton=star.json", "--format=json") == (
        report.render("json") + "\n"
    )
    Path("star.json").write_text(text.replace("[-1, 0", "[-1, 99"))
    assert "star.json: parent 99 of " in refused("evaluate", "hyps.npz", "gt.npz", "--skeleton=star.json")
    assert "none.json: no such file" in refused("evaluate", "hyps.npz", "gt.npz", "--skeleton=none.json")
    done("plot", "poses", "hyps.npz", "gt.npz", "--root-joint=none", "-o", "poses.svg")
    assert Path("poses.svg").stat().st_size > 0
