"""Files that can't be answered for: one message, exit code 3, and nothing written or changed."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.engine.storage import digest_of
from tests.helpers.reports import world
from tests.helpers.shell import Array, done, frame_ids, gt_members, hypotheses, hyps_members, refused


def with_hyps(**members: Any) -> None:
    """Write bad.npz: the hypotheses, with other members."""
    kept = {key: value for key, value in {**hyps_members(), **members}.items() if value is not None}
    np.savez("bad.npz", **kept)


def with_bytes(change: Any) -> None:
    Path("bad.npz").write_bytes(change(Path("hyps.npz").read_bytes()))


def bad_value(value: float) -> Array:
    found = hypotheses()
    found[2, 5, 3, 1] = value
    return found


BROKEN: dict[str, tuple[Any, str]] = {
    "missing": (lambda: None, r"bad\.npz: no such file\."),
    "folder": (lambda: Path("bad.npz").mkdir(), r"bad\.npz: is a folder; expected an \.npz or \.npy file\."),
    "empty": (lambda: with_bytes(lambda _: b""), r"bad\.npz: empty file; expected an \.npz or \.npy file\."),
    "no zip": (lambda: with_bytes(lambda _: b"hello"), r"bad\.npz is neither an \.npz nor an \.npy file; expected num"),
    "cut in the middle": (
        lambda: with_bytes(lambda whole: whole[: len(whole) // 2]),
        r"bad\.npz: can't be read \(.*\)\. Was it cut off\? Copy it again\.",
    ),
    "cut at the end": (
        lambda: with_bytes(lambda whole: whole[:-10]),
        r"bad\.npz: can't be read \(.*\)\. Was it cut off\? Copy it again\.",
    ),
    "corrupted": (
        lambda: with_bytes(lambda whole: whole[:4000] + bytes(64) + whole[4064:]),
        r"bad\.npz: can't be read \(Bad CRC-32 for file 'hypotheses\.npy'\)\. Was it cut off\? Copy it again\.",
    ),
    "objects": (
        lambda: with_hyps(hypotheses=np.array([1, None], dtype=object)),
        r"bad\.npz: hypotheses is an array of Python objects, and posecal never unpickles\. Save numbers: ",
    ),
    "text": (lambda: with_hyps(hypotheses=np.array([["a"]])), r"bad\.npz: hypotheses: dtype <U1; expected real numb"),
    "complex": (lambda: with_hyps(hypotheses=hypotheses() + 0j), r"bad\.npz: hypotheses: dtype complex.*; expected re"),
    "no poses": (
        lambda: with_hyps(hypotheses=hypotheses()[:, :0]),
        r"bad\.npz: nothing in it; its shape is \(6, 0, 17",
    ),
    "no hypotheses": (lambda: with_hyps(hypotheses=hypotheses()[:0]), r"bad\.npz: nothing in it; its shape is \(0, 36"),
    "fewer joints": (
        lambda: with_hyps(hypotheses=hypotheses()[:, :, 1:], joints=None),
        r"bad\.npz has K = 16 joints and gt\.npz 17; expected as many, or joints named in both and --joints common\.",
    ),
    "fewer poses": (
        lambda: with_hyps(hypotheses=hypotheses()[:, 1:], frame_id=None),
        r"bad\.npz has M = 35 poses and gt\.npz 36; expected as many\. Give both a frame_id to match them by \(bad",
    ),
    "NaN": (
        lambda: with_hyps(hypotheses=bad_value(np.nan)),
        r"bad\.npz has non-finite coordinates in 1 of 36 frames \(first: frame sequence 01/5, joint RFoot\)\. Mask",
    ),
    "infinity": (lambda: with_hyps(hypotheses=bad_value(-np.inf)), r"bad\.npz has non-finite coordinates in 1 of 36"),
    "metres": (
        lambda: with_hyps(hypotheses=hypotheses() / 1000, unit=None),
        r"bad\.npz looks like metres: joints lie 0\.\d+ from the middle of the pose; expected some 400 \(mm\)\. Pass -",
    ),
    "another unit": (lambda: with_hyps(unit="inch"), r"bad\.npz: unit: 'inch'; expected mm, cm, m, or the millimetres"),
    "unknown joints": (
        lambda: with_hyps(joints=np.array([f"j{k}" for k in range(17)])),
        r"bad\.npz and gt\.npz have no joint in common \(j0, j1, j2 and 14 more against Hip, RHip, RKnee and 14 more\)",
    ),
    "duplicate ids": (
        lambda: with_hyps(frame_id=np.array([*frame_ids()[:-1], frame_ids()[0]])),
        r"bad\.npz has 1 of 36 frame_id more than once \(first: sequence 00/0\)\. Give each frame once\.",
    ),
    "other ids": (
        lambda: with_hyps(frame_id=np.arange(36)),
        r"bad\.npz and gt\.npz have no frame_id in common \(0, 1,",
    ),
    "other axes": (
        lambda: with_hyps(hypotheses=hypotheses().swapaxes(0, 1), axes=None),
        r"bad\.npz \(36, 6, 17, 3\) and gt\.npz \(36, 17, 3\): expected .*\. The shapes fit --axes MNKD\.",
    ),
    "as many hypotheses as poses": (
        lambda: with_hyps(hypotheses=np.repeat(hypotheses(), 6, axis=0), axes=None),
        r"the shapes don't tell the axes apart \(N = M = 36\)\. Pass --axes NMKD or --axes MNKD\.",
    ),
    "scores of another shape": (
        lambda: with_hyps(scores=np.ones((5, 36))),
        r"bad\.npz: scores \(5, 36\); expected \(N, M\) = \(6, 36\)\.",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_hypotheses_are_refused_in_one_message(kind: str) -> None:
    make, words = BROKEN[kind]
    make()
    for name in ("kept.npz", "kept.svg", "kept.html"):
        Path(name).write_text("what was here before")
    said = refused("evaluate", "bad.npz", "gt.npz", "--save=kept.npz", "--plot=kept.svg", "--html=kept.html")
    assert re.match(f"posecal: .*{words}", said), said
    assert "Traceback" not in said


def test_a_truth_that_is_not_finite_is_refused() -> None:
    members = gt_members()
    members["truth"][[4, 9], 6] = np.nan
    np.savez("bad.npz", **members)
    assert "bad.npz has non-finite coordinates in 2 of 36 frames (first: " in refused("evaluate", "hyps.npz", "bad.npz")


def test_files_in_the_wrong_order_look_swapped() -> None:
    assert refused("evaluate", "gt.npz", "hyps.npz").startswith(
        "posecal: 2 problems: - gt.npz holds truth (36, 17, 3) and no hypotheses or hyps. The two files look swapped."
    )
    np.save("h.npy", hypotheses())
    np.save("g.npy", world().truth)
    assert refused("evaluate", "g.npy", "h.npy").endswith("The two look swapped.")


def test_velocities_per_second_need_frames_per_second() -> None:
    said = refused("evaluate", "hyps.npz", "gt.npz", "--set=velocity=second", "--metrics=mpjve")
    assert said == "posecal: velocity: second needs the frames per second. Store fps in the truth's file."


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["report", "hyps.npz"], "hyps.npz: no result of posecal evaluate --save, or not a whole one."),
        (["report", "nothing.npz"], "nothing.npz: no such file."),
        (["report", "result.npz", "--by", "acton"], "by: 'acton' is not a label of these poses. Did you mean action?"),
        (["merge", "result.npz", "gt.npz", "-o", "x.npz"], "gt.npz: no result of posecal evaluate --save, or not a "),
        (["merge", "result.npz", "result.npz", "-o", "x.npz"], "result.npz and result.npz hold the same poses: 36 "),
        (["plot", "joints", "gt.npz", "-o", "x.svg"], "gt.npz: no result of posecal evaluate --save, or not a whole "),
        (["plot", "poses", "hyps.npz", "gt.npz", "-o", "x.svg", "--joint=Tail"], "joint: 'Tail' is not among the joi"),
        (["plot", "poses", "hyps.npz", "gt.npz", "-o", "x.svg", "--frames=99"], "frames: '99' is neither a frame id "),
        (["evaluate", "hyps.npz", "gt.npz", "--by", "acton"], "by: 'acton' is not a label of these poses. Did you me"),
        (["evaluate", "hyps.npz", "gt.npz", "--root-joint", "Tail"], "--root-joint: 'Tail' is not among the joints."),
        (["evaluate", "hyps.npz", "gt.npz", "--joints", "Hed"], "joints: 'Hed' is not among the poses' joints. Did y"),
        (["evaluate", "hyps.npz", "gt.npz", "--hypotheses", "7"], "--hypotheses: 7; expected 1 to N = 6, the hypoth"),
        (["evaluate", "hyps.npz", "gt.npz", "--unit", "cm"], "2 problems: - hyps.npz declares 'mm' itself; expected "),
        (["evaluate", "hyps.npz", "gt.npz", "--axes", "MNKD"], "hyps.npz declares 'NMKD' itself; expected no --axes M"),
    ],
    ids=lambda value: "-".join(value)[:60] if isinstance(value, list) else "",
)
def test_what_the_files_do_not_hold_is_refused(words: list[str], said: str) -> None:
    assert refused(*words).startswith(f"posecal: {said}")


def test_results_of_other_numbers_of_hypotheses_do_not_merge() -> None:
    done("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "3", "--save", "three.npz")
    said = refused("merge", "result.npz", "three.npz", "-o", "x.npz")
    assert said == "posecal: result.npz and three.npz were not made alike: N 6 against 3."


@pytest.mark.parametrize(
    "words",
    [
        ["report", "bad.npz"],
        ["compare", "bad.npz", "good.npz"],
        ["plot", "pck", "bad.npz", "-o", "out.svg"],
        ["plot", "comparison", "bad.npz", "good.npz", "-o", "out.svg"],
    ],
)
def test_a_result_whose_sums_are_too_few_is_refused_though_its_digest_is_right(words: list[str]) -> None:
    done("evaluate", "hyps.npz", "gt.npz", "--save", "good.npz")
    with np.load("good.npz") as stored:
        members = {key: stored[key] for key in stored if key != "digest"}
    about = json.loads(str(members["about"]))
    for name in ("errors", "pck_curve", "inside_exchangeable"):
        members[f"sum/{name}"] = members[f"sum/{name}"][..., :0]
        about["shapes"][f"sum/{name}"] = [*members[f"sum/{name}"].shape]
    members["about"] = np.array(json.dumps(about))
    np.savez("bad.npz", **members, digest=np.array(digest_of(members)))
    assert re.match(
        r"posecal: bad\.npz.*: its members don't fit each other \(.*\)\. Evaluate again\. If", refused(*words)
    )
    assert not Path("out.svg").exists()
