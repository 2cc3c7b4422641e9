"""The command line as a user meets it: the same numbers, exit codes, one message, and nothing half-written."""

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import posecal
from posecal.cli import app
from posecal.demo import sample
from posecal.protocol import Protocol
from posecal.report import Report
from posecal.results import load_totals
from tests.reports import world

ROOT = Path(__file__).parents[1]
N = 6
JOINTS = posecal.JOINT_SETS["h36m-17"]
Array = np.ndarray[Any, np.dtype[Any]]


def hypotheses() -> Array:
    return sample(world(), N)


def frame_ids() -> Array:
    return np.array([f"{name}/{number}" for number, name in enumerate(world().sequence)])


def hyps_members() -> dict[str, Any]:
    return {
        "hypotheses": hypotheses(),
        "axes": "NMKD",
        "unit": "mm",
        "joints": np.array(JOINTS),
        "frame_id": frame_ids(),
    }


def gt_members() -> dict[str, Any]:
    here = world()
    return {
        "truth": here.truth.astype(np.float32),
        "unit": "mm",
        "joints": np.array(JOINTS),
        "frame_id": frame_ids(),
        "sequence": here.sequence,
        "action": here.action,
        "occluded": here.occluded,
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with hyps.npz, gt.npz and result.npz. Tests work elsewhere and only read it."""
    folder = tmp_path_factory.mktemp("files")
    np.savez(folder / "hyps.npz", **hyps_members())
    np.savez(folder / "gt.npz", **gt_members())
    posecal.evaluate(folder / "hyps.npz", folder / "gt.npz").save(folder / "result.npz")
    return folder


@pytest.fixture(autouse=True)
def _elsewhere(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder with links to the files."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)


def run(*words: str | Path) -> Any:
    """Run posecal in this process; whatever it can't answer for is raised."""
    done = CliRunner().invoke(app, [str(word) for word in words], prog_name="posecal")
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def done(*words: str | Path) -> str:
    """Run what must succeed, and give its stdout."""
    found = run(*words)
    assert found.exit_code == 0, found.stderr
    return found.stdout


def refused(*words: str | Path, code: int = 3) -> str:
    """Run what must be refused: nothing on stdout, nothing written, nothing changed. Give what is said, as one line."""
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    found = run(*words)
    assert found.exit_code == code, found.output
    assert found.stdout == ""
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", found.stderr).split())


def spawned(*words: str | Path, **how: Any) -> subprocess.Popen[bytes]:
    """Run posecal as a user's shell does."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-m", "posecal", *map(str, words)], env=environment, **how)


def rows(text: str) -> dict[tuple[str, str | None, str | None], float | None]:
    """The values of a report in JSON."""
    return {(row["metric"], row["group"], row["joint"]): row["value"] for row in json.loads(text)["rows"]}


# --- the main path --------------------------------------------------------------------------------------------


def test_evaluate_writes_the_report_to_stdout_and_remarks_to_stderr() -> None:
    found = run("evaluate", "hyps.npz", "gt.npz")
    report = posecal.evaluate("hyps.npz", "gt.npz")
    assert found.exit_code == 0
    assert found.stdout == f"{report}\n"
    assert found.stderr.splitlines() == [f"note: {remark}" for remark in report.remarks] != []


@pytest.mark.parametrize("form", ["markdown", "csv", "json"])
def test_other_formats_are_those_of_the_report(form: Any) -> None:
    text = done("evaluate", "hyps.npz", "gt.npz", "--format", form, "--by", "action", "--by", "sight")
    assert text == posecal.evaluate("hyps.npz", "gt.npz", by=["action", "sight"]).render(form) + "\n"


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
    assert "note: 16 joints are in both; left out: RWrist, Tail." in found.stderr


def test_frames_that_are_missing_are_skipped_where_asked_for() -> None:
    members = hyps_members()
    some = {"hypotheses": members["hypotheses"][:, 3:], "frame_id": members["frame_id"][3:]}
    np.savez("few.npz", **{**members, **some})
    assert "few.npz lacks 3 of the 36 frames of gt.npz (first: " in refused("evaluate", "few.npz", "gt.npz")
    found = run("evaluate", "few.npz", "gt.npz", "--missing", "skip")
    assert "M = 33 poses" in found.stdout
    assert "note: few.npz lacks 3 of the 36 frames of gt.npz: skipped." in found.stderr


def test_the_first_hypotheses_are_taken_where_fewer_are_asked_for() -> None:
    np.savez("three.npz", **{**hyps_members(), "hypotheses": hypotheses()[:3]})
    fewer = done("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "3", "--format=csv")
    assert fewer == done("evaluate", "three.npz", "gt.npz", "--format=csv")


def test_one_hypothesis_has_an_accuracy_and_no_calibration() -> None:
    found = run("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "1")
    assert found.exit_code == 0
    assert "minMPJPE" in found.stdout
    assert "Calibration" not in found.stdout
    assert "note: calibration and spread need at least 2 hypotheses; there is 1." in found.stderr


def test_the_number_of_threads_changes_nothing() -> None:
    one, three = (done("evaluate", "hyps.npz", "gt.npz", "--format=json", "--threads", n) for n in ("1", "3"))
    assert one == three


# --- what is written ------------------------------------------------------------------------------------------


def test_save_plot_and_html_write_these_files_and_no_others() -> None:
    before = {path.name for path in Path().iterdir()}
    plain = done("evaluate", "hyps.npz", "gt.npz")
    assert {path.name for path in Path().iterdir()} == before
    assert done("evaluate", "hyps.npz", "gt.npz", "--save=s.npz", "--plot=p.svg", "--html=h.html") == plain
    assert {path.name for path in Path().iterdir()} == before | {"s.npz", "p.svg", "h.html"}
    assert Path("p.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert Path("h.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert load_totals("s.npz").signature == load_totals("result.npz").signature


@pytest.mark.parametrize("form", ["text", "json"])
def test_a_saved_result_is_reported_as_it_was(form: str) -> None:
    words = ("--format", form, "--per-joint", "--definitions", "--by", "action")
    one = run("evaluate", "hyps.npz", "gt.npz", "--save", "kept.npz", *words)
    later = run("report", "kept.npz", *words)
    assert (later.stdout, later.stderr, later.exit_code) == (one.stdout, one.stderr, 0)


def test_results_of_shards_merge_into_that_of_the_whole() -> None:
    """Cut within a sequence: 36 poses of three frames a sequence into 0 … 9 and 10 … 35."""
    for name, part in (("a", slice(0, 10)), ("b", slice(10, 36))):
        ours, theirs = hyps_members(), gt_members()
        ours |= {"hypotheses": ours["hypotheses"][:, part], "frame_id": ours["frame_id"][part]}
        theirs |= {key: values[part] for key, values in theirs.items() if len(values) == 36}
        np.savez(f"h{name}.npz", **ours)
        np.savez(f"g{name}.npz", **theirs)
        done("evaluate", f"h{name}.npz", f"g{name}.npz", "--save", f"{name}.npz")
    found = run("merge", "b.npz", "a.npz", "-o", "all.npz")
    assert (found.exit_code, found.stdout) == (0, "")
    assert found.stderr == "all.npz: 36 poses of 2 results.\n"
    merged, whole = (rows(done("report", name, "--format=json", "--by=action")) for name in ("all.npz", "result.npz"))
    assert merged.keys() == whole.keys()
    for key, value in whole.items():
        expected = np.nan if value is None else value
        got = merged[key]
        np.testing.assert_allclose(np.nan if got is None else got, expected, rtol=1e-6, atol=1e-9, err_msg=str(key))


@pytest.mark.parametrize("kind", ["reliability", "joints", "errors", "correct"])
def test_a_saved_result_is_drawn(kind: str) -> None:
    assert done("plot", kind, "result.npz", "-o", "picture.svg") == ""
    from posecal.plot import draw, figure_bytes

    report = Report(load_totals("result.npz"))
    assert Path("picture.svg").read_bytes() == figure_bytes(draw(report, kind), ".svg")


def test_poses_are_drawn_by_frame_and_joint() -> None:
    ids = frame_ids()
    words = ("plot", "poses", "hyps.npz", "gt.npz", "-o", "poses.svg")
    done(*words, "--frames", f"{ids[4]}, 7", "--joint", "LFoot", "--most", "3")
    text = Path("poses.svg").read_text(encoding="utf-8")
    for said in (ids[4], ids[7], f"grey: 3 of {N} hypotheses", "pink: LFoot"):
        assert said in text


def test_presets_lists_every_preset_and_option() -> None:
    text = done("presets")
    for name in posecal.PRESETS:
        assert re.search(rf"^{name} ", text, re.MULTILINE)
    for option in Protocol().options:
        assert re.search(rf"^{option} ", text, re.MULTILINE)


def test_an_existing_output_is_replaced_whole() -> None:
    Path("s.npz").write_text("old" * 10**6)
    done(*EVALUATE, "--metrics=min_mpjpe", "--save", "s.npz")
    assert b"old" not in Path("s.npz").read_bytes()


# --- broken files ---------------------------------------------------------------------------------------------


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
        r"bad\.npz has M = 35 poses and gt\.npz 36; expected as many\. Store a frame_id in both to join them \(bad\.",
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
        r"bad\.npz has 1 of 36 frame_id more than once \(first: sequence 00/0\)\. Store each frame once\.",
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
        r"the shapes don't tell which axis is the hypotheses \(N = M = 36\)\. Pass --axes NMKD or --axes MNKD\.",
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
    assert refused("evaluate", "gt.npz", "hyps.npz") == (
        "posecal: gt.npz holds truth (36, 17, 3) and no hypotheses or hyps. The two files look swapped."
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
        (["merge", "result.npz", "result.npz", "-o", "x.npz"], "result.npz and result.npz hold the same poses (cell "),
        (["plot", "joints", "gt.npz", "-o", "x.svg"], "gt.npz: no result of posecal evaluate --save, or not a whole "),
        (["plot", "poses", "hyps.npz", "gt.npz", "-o", "x.svg", "--joint=Tail"], "joint: 'Tail' is not among the joi"),
        (["plot", "poses", "hyps.npz", "gt.npz", "-o", "x.svg", "--frames=99"], "frames: '99' is neither a frame id "),
        (["evaluate", "hyps.npz", "gt.npz", "--by", "acton"], "by: 'acton' is not a label of these poses. Did you me"),
        (["evaluate", "hyps.npz", "gt.npz", "--root-joint", "Tail"], "root joint: 'Tail' is not among the joints. Kn"),
        (["evaluate", "hyps.npz", "gt.npz", "--joints", "Hed"], "joints: 'Hed' is not among the poses' joints. Did y"),
        (["evaluate", "hyps.npz", "gt.npz", "--hypotheses", "7"], "hypotheses: 7; expected 1 to N = 6, the hypothese"),
        (["evaluate", "hyps.npz", "gt.npz", "--unit", "cm"], "2 problems: - hyps.npz declares 'mm' itself, and --uni"),
        (["evaluate", "hyps.npz", "gt.npz", "--axes", "MNKD"], "hyps.npz declares 'NMKD' itself, and --axes says 'MN"),
    ],
    ids=lambda value: "-".join(value)[:60] if isinstance(value, list) else "",
)
def test_what_the_files_do_not_hold_is_refused(words: list[str], said: str) -> None:
    assert refused(*words).startswith(f"posecal: {said}")


def test_results_of_other_numbers_of_hypotheses_do_not_merge() -> None:
    done("evaluate", "hyps.npz", "gt.npz", "--hypotheses", "3", "--save", "three.npz")
    said = refused("merge", "result.npz", "three.npz", "-o", "x.npz")
    assert said == "posecal: result.npz and three.npz were not made alike: N 6 against 3."


# --- wrong calls ----------------------------------------------------------------------------------------------

EVALUATE = ["evaluate", "hyps.npz", "gt.npz"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["evalute"], "No such command 'evalute'. Did you mean 'evaluate'?"),
        (["evaluate", "hyps.npz"], "Missing argument 'truth'."),
        ([*EVALUATE, "more.npz"], "Got unexpected extra argument"),
        ([*EVALUATE, "--bye", "action"], "No such option: --bye"),
        ([*EVALUATE, "--where", "hidden"], "'hidden' is not one of 'all', 'occluded', 'visible'"),
        ([*EVALUATE, "--format", "xml"], "'xml' is not one of 'text', 'markdown', 'csv', 'json'"),
        ([*EVALUATE, "--preset", "cgn"], "preset: 'cgn' is not known. Did you mean cgnf?"),
        ([*EVALUATE, "--set", "besst=frame"], "option: 'besst' is not known. Did you mean best?"),
        ([*EVALUATE, "--set", "best=fram"], "best: 'fram'; expected frame, sequence, batch:k (k clips) or joint."),
        ([*EVALUATE, "--set", "best"], "'best': expected OPTION=VALUE, such as best=sequence."),
        ([*EVALUATE, "--set", "pck_threshold=wide"], "pck_threshold: 'wide'; expected a length in mm."),
        ([*EVALUATE, "--metrics", "mpjp"], "metrics: mpjp not known. Did you mean mpjpe?"),
        ([*EVALUATE, "--metrics", ""], "metrics: ''; expected default, all, or names with commas."),
        ([*EVALUATE, "--axes", "NMKK"], "axes: 'NMKK' lacks D; expected each letter of NMKD once"),
        ([*EVALUATE, "--unit", "inch"], "unit: 'inch'; expected mm, cm, m, or the millimetres in one unit"),
        ([*EVALUATE, "--hypotheses", "0"], "'--hypotheses'"),
        ([*EVALUATE, "--threads", "0"], "'--threads'"),
        ([*EVALUATE, "--plot", "p.jpg"], "p.jpg: .jpg; expected a name that ends with .svg, .png or .pdf."),
        ([*EVALUATE, "--plot", "p"], "p: no ending; expected a name that ends with .svg, .png or .pdf."),
        ([*EVALUATE, "--html", "gt.npz"], "gt.npz is read already; expected another name."),
        ([*EVALUATE, "--skill", "r.npz", "--save", "r.npz"], "r.npz is read already; expected another name."),
        ([*EVALUATE, "--prerank", "p.py:height", "--save", "p.py"], "p.py is read already; expected another name."),
        ([*EVALUATE, "--save", "x", "--html", "./x"], "x is written already; expected another name."),
        (["merge", "result.npz", "-o", "./result.npz"], "result.npz is read already; expected another name."),
        (["merge", "result.npz"], "Missing option '--output'"),
        (["plot", "joint", "result.npz", "-o", "x.svg"], "No such command 'joint'. Did you mean 'joints'?"),
    ],
    ids=lambda value: "-".join(value)[-40:] if isinstance(value, list) else "",
)
def test_a_wrong_call_is_said_before_any_work(words: list[str], said: str) -> None:
    assert said in refused(*words, code=2)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("nowhere/x", r"nowhere/x: the folder nowhere does not exist\. Make it first\."),
        ("folder", r"folder: is a folder; expected the name of a file\."),
        ("/proc/x", r"/proc/x: can't be written \(.+\)\."),
        ("/dev/full", r"/dev/full: is a device or a pipe; expected the name of a file\."),
    ],
)
@pytest.mark.parametrize("door", ["--save", "--html"])
def test_an_output_that_can_not_be_written_is_said_before_any_work(door: str, place: str, words: str) -> None:
    Path("folder").mkdir()
    said = refused("evaluate", "nothing.npz", "nothing.npz", door, place)
    assert re.fullmatch(f"posecal: {words}", said), said


@pytest.mark.parametrize("command", ["merge result.npz", "plot errors result.npz", "plot poses hyps.npz gt.npz"])
def test_so_it_is_by_other_commands(command: str) -> None:
    said = refused(*command.split(), "-o", "nowhere/x.svg")
    assert said == "posecal: nowhere/x.svg: the folder nowhere does not exist. Make it first."


def test_no_file_is_written_where_one_of_them_can_not_be_made() -> None:
    """The diagram needs two hypotheses; the result would not."""
    Path("s.npz").write_text("what was here before")
    said = refused(*EVALUATE, "--hypotheses=1", "--save=s.npz", "--html=h.html", "--plot=p.svg")
    assert said == "posecal: reliability: calibration needs at least 2 hypotheses; there is 1."


# --- help -----------------------------------------------------------------------------------------------------

COMMANDS = ["", "evaluate", "report", "compare", "merge", "presets", "demo", "plot", "plot poses", "plot reliability"]


@pytest.mark.parametrize("command", [*COMMANDS, "recalibrate", "recalibrate fit", "recalibrate apply"])
def test_help_says_what_each_command_option_and_argument_is(command: str) -> None:
    text = done(*command.split(), "--help")
    assert text.count("Usage: posecal") == 1
    lines = [line.strip("│ ") for line in text.splitlines()]
    options = [line for line in lines if re.match(r"\*? *--", line)]
    assert options
    for line in options:
        assert re.search(r"[A-Za-z,)…]\.( |$)", line), line


@pytest.mark.parametrize("width", ["60", "80", "120"])
def test_help_fits_the_terminal(width: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", width)
    assert max(map(len, done("evaluate", "--help").splitlines())) <= int(width)


def test_the_version_is_said() -> None:
    assert done("--version") == f"posecal {posecal.__version__}\n"


def test_without_a_command_help_is_shown() -> None:
    found = run()
    assert found.exit_code == 2
    assert "evaluate" in found.output


# --- as a user's shell runs it --------------------------------------------------------------------------------


def test_the_module_is_the_command(files: Path) -> None:
    process = spawned(*EVALUATE, "--format=csv", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate()
    assert (process.returncode, out.decode()) == (0, done(*EVALUATE, "--format=csv"))
    assert all(line.startswith("note: ") for line in err.decode().splitlines())


def test_a_refusal_is_one_line_and_the_exit_code_3() -> None:
    process = spawned("evaluate", "no.npz", "gt.npz", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.communicate() == (b"", b"posecal: no.npz: no such file.\n")
    assert process.returncode == 3


def test_a_reader_that_leaves_early_makes_no_noise() -> None:
    """As ``posecal … | head -1`` does: the report is longer than what a pipe holds."""
    process = spawned(*EVALUATE, "--format=json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == b"{\n"
    process.stdout.close()
    err = process.stderr.read().decode()
    process.stderr.close()
    process.wait()
    assert "Traceback" not in err
    assert "Exception" not in err
    assert "Broken" not in err


def test_a_full_disk_is_said() -> None:
    with open("/dev/full", "wb") as full:
        process = spawned(*EVALUATE, "--save=s.npz", stdout=full, stderr=subprocess.PIPE)
        _, err = process.communicate()
    assert process.returncode == 3
    assert "posecal: No space left on device" in err.decode()
    assert "Traceback" not in err.decode()


@contextlib.contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    """Both ends of a terminal: what a person sees, and what a program writes to."""
    seen, written = pty.openpty()
    try:
        yield seen, written
    finally:
        os.close(seen)
        with contextlib.suppress(OSError):
            os.close(written)


def shown(seen: int) -> bytes:
    """Read what is shown on a terminal until the program has left."""
    found = b""
    with contextlib.suppress(OSError):  # Linux's end of a terminal that nobody writes to
        while piece := os.read(seen, 4096):
            found += piece
    return found


def test_progress_is_shown_on_a_terminal_and_cleared() -> None:
    with terminal() as (seen, written):
        process = spawned(*EVALUATE, stdout=subprocess.PIPE, stderr=written)
        os.close(written)
        text = shown(seen)
        out, _ = process.communicate()
    assert process.returncode == 0
    assert b"evaluating" in text
    assert b"\x1b[" in text
    assert out.decode() == done(*EVALUATE)


def test_the_report_on_a_terminal_is_as_wide_as_it_and_in_colour() -> None:
    with terminal() as (seen, written):
        environment = {key: value for key, value in os.environ.items() if key not in {"COLUMNS", "NO_COLOR"}}
        process = subprocess.Popen(
            [sys.executable, "-m", "posecal", "report", "result.npz"],
            env={**environment, "PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "COLUMNS": "70"},
            stdout=written,
            stderr=subprocess.DEVNULL,
        )
        os.close(written)
        text = shown(seen).decode()
        process.wait()
    assert "\x1b[1m" in text
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()
    assert max(len(line) for line in plain if not line.startswith("signature")) <= 70


SLOW = """
import pathlib, time

def slow(pool):
    pathlib.Path("begun").touch()
    time.sleep(0.05)
    return pool[:, 0, 0]
"""
"""A test of the battery that makes the work last for long, and says when it has begun."""


@pytest.mark.parametrize("threads", ["1", "2"])
def test_an_interruption_exits_with_130_and_leaves_nothing_behind(threads: str) -> None:
    Path("slow.py").write_text(SLOW)
    Path("kept.npz").write_text("what was here before")
    random = np.random.default_rng(1)
    truth = random.normal(0, 300, (400, 17, 3)).astype(np.float32)
    np.save("h.npy", truth + random.normal(0, 40, (60, *truth.shape)).astype(np.float32))
    np.save("g.npy", truth)
    before = {path.name for path in Path().iterdir()}
    words = ("evaluate", "h.npy", "g.npy", "--metrics=min_mpjpe", "--prerank=slow.py:slow", "--save=kept.npz")
    process = spawned(*words, "--html=h.html", "--threads", threads, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not Path("begun").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=120) == (b"", b"posecal: interrupted.\n")
    assert process.returncode == 130
    assert {path.name for path in Path().iterdir()} == before | {"begun"}
    assert Path("kept.npz").read_text() == "what was here before"


# --- odd names ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["with blank.npz", "[bold]x.npz", "ünï·コ.npz", "$x_1$.npz", "-dash.npz"])
def test_files_may_have_odd_names(name: str) -> None:
    Path(name).write_bytes(Path("hyps.npz").read_bytes())
    assert done("evaluate", "--metrics=min_mpjpe", "--", name, "gt.npz")
    Path(name).unlink()
    assert refused("evaluate", "--", name, "gt.npz") == f"posecal: {name}: no such file."


@pytest.mark.parametrize("by", ["sequence", "action", "spread", "spread:2", "spread=25,30", "sight"])
def test_poses_are_grouped_by_any_label_and_by_spread_and_sight(by: str) -> None:
    text = done(*EVALUATE, "--metrics=min_mpjpe", "--format=json", "--by", by)
    groups = {group for _, group, _ in rows(text) if group is not None}
    counts = {"sequence": 12, "action": 3, "spread": 3, "spread:2": 2, "spread=25,30": 3, "sight": 2}
    assert len(groups) == counts[by]
    assert {group.partition("=")[0] for group in groups} == {by.replace("=", ":")}


# --- flags and presets ----------------------------------------------------------------------------------------


def test_a_flag_that_is_given_wins_over_the_preset() -> None:
    text = done(*EVALUATE, "--preset=cgnf-occluded", "--where=all", "--metrics=mpjpe", "--format=json")
    like = ("--set", "joints=h36m-16", "--set", "root=drop")
    plain = done(*EVALUATE, *like, "--metrics=mpjpe", "--format=json")
    assert rows(text)["mpjpe", None, None] == rows(plain)["mpjpe", None, None]


def test_a_group_shows_metrics_that_the_whole_does_not() -> None:
    assert "MPJPE" in done(*EVALUATE, "--metrics=mpjpe", "--by=sight")


def test_a_saved_result_in_the_place_of_poses_is_refused_with_what_takes_it() -> None:
    assert "is a saved result and holds no poses. posecal report shows it" in refused(
        "evaluate", "result.npz", "gt.npz"
    )
