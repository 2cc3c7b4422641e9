"""Files of other tools, written here as those tools write them, become the file that posecal reads."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from posecal.cli import app
from posecal.conversion import FORMATS, convert
from posecal.data.read import read_poses
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.tables import JOINTS, Array, M, trc, wide


def test_a_file_per_hypothesis(poses: Array, tmp_path: Path) -> None:
    files = [wide(poses + n, tmp_path / f"sample_{n}.csv") for n in range(3)]
    with pytest.raises(PoseDataError, match=r"^files: 3 of several frames; expected what each is\. Pass each_file="):
        convert(files, unit="mm")
    members, _ = convert(files, unit="mm", each_file="hypothesis")
    np.testing.assert_allclose(members["hypotheses"], [poses, poses + 1, poses + 2], rtol=1e-6)
    joined, _ = convert(files, unit="mm", each_file="frames")
    np.testing.assert_allclose(joined["truth"], np.concatenate([poses, poses + 1, poses + 2]))
    assert joined["frame_id"][M] == "sample_1/0"
    wide(poses[:-1], files[1])
    with pytest.raises(PoseDataError, match=r"^sample_1\.csv: other frames than sample_0\.csv; expected the same"):
        convert(files, unit="mm", each_file="hypothesis")


def test_what_is_converted_is_evaluated(poses: Array, tmp_path: Path) -> None:
    run = CliRunner().invoke
    files = [str(wide(poses + shift, tmp_path / f"s{shift}.csv")) for shift in (10, 30)]
    trc(poses, tmp_path / "gt.trc")
    frames = pd.read_csv(files[0])["frame"] + 1
    for file in files:
        pd.read_csv(file).assign(frame=frames).to_csv(file, index=False)
    hyps, gt = str(tmp_path / "hyps.npz"), str(tmp_path / "gt.npz")
    done = run(app, ["convert", *files, "-o", hyps, "--each-file", "hypothesis", "--unit", "mm"])
    assert done.exit_code == 0, done.output
    assert "assumed: 6 frames of 4 joints are 2 hypotheses." in done.stderr
    assert run(app, ["convert", str(tmp_path / "gt.trc"), "-o", gt]).exit_code == 0
    assert read_poses(gt, "truth").fps == 60
    report = run(app, ["evaluate", hyps, gt, "--root-joint", "none", "--metrics", "mpjpe", "--format", "json"])
    value = json.loads(report.stdout)["rows"][0]["value"]
    assert value == pytest.approx(20 * np.sqrt(3), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "contents", "words"),
    [
        ("a.csv", "time,speed\n1,2\n", "no columns of joints' coordinates"),
        ("a.csv", "Hip_x,Hip_y,Hip_z,Head_x,Head_y\n1,2,3,4,5\n", "lacks Head_z; expected x, y, z of each joint"),
        ("a.csv", "Hip_x,Hip_y\n1,fast\n", "column Hip_y holds 'fast'; expected numbers, empty where one is not known"),
        ("a.csv", "frame,joint,x,y\n0,Hip,1,2\n0,Hip,3,4\n", "row 3 repeats a joint of its frame"),
        ("a.csv", "", "is no table of numbers"),
        ("a.csv", "Hip_x,Hip_y\n", "no rows; expected one for each frame"),
        ("a.trc", "nothing\n", "no head of a .trc file"),
        ("a.json", "{", "is no JSON"),
        ("a.json", '{"a": 1}', "holds a; expected people, bodies"),
        ("a.json", '{"people": []}', "0 people in a frame; expected one"),
        ("a.json", '{"people": [{}, {}]}', "2 people in a frame; expected one"),
        ("a.json", "[[[1, 2, 3]], [[1, 2]]]", "lists of unequal lengths"),
        ("a.json", '{"bodies": [{}]}', "is not as panoptic writes it"),
        ("a.npz", "PK", "can't be read"),
        ("a.pkl", "x", "is no pickle; expected a pickle of plain arrays"),
        ("a.mp4", "x", "a file .mp4; expected one of .csv"),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_refused_in_one_message(tmp_path: Path, name: str, contents: str, words: str) -> None:
    (tmp_path / name).write_text(contents, encoding="utf-8")
    with pytest.raises((PoseDataError, PoseFileError), match=rf"^{name}: ") as refused:
        convert(tmp_path / name, tmp_path / "out.npz", unit="mm")
    assert words in str(refused.value)
    done = CliRunner().invoke(app, ["convert", str(tmp_path / name), "-o", str(tmp_path / "out.npz")])
    assert (done.exit_code, done.stderr.count("\n")) == (3, done.stderr.count("\n"))
    assert words in " ".join(done.stderr.split())
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"like": "openpose"}, r"a\.csv is no file of openpose; expected OpenPose: \.json of a frame\."),
        ({"like": "long"}, r"a\.csv: no columns joint, x and y; expected those of a long table\."),
        ({"axes": "MKD"}, r'a\.csv has no axes to declare; expected no axes="MKD"\. Leave it out\.'),
        ({"dataset": "q"}, r'a\.csv holds no datasets; expected no dataset="q"\. Leave it out\.'),
        (
            {"joints": [*"abcd"]},
            r"a\.csv names its joints itself \(Hip, RKnee, LKnee and 1 more\); expected no joints=",
        ),
        ({"output": "x.csv"}, r"x\.csv: \.csv; expected a name that ends with \.npz\."),
    ],
)
def test_options_that_do_not_apply_are_refused(
    poses: Array, tmp_path: Path, how: dict[str, object], words: str
) -> None:
    with pytest.raises((PoseDataError, PoseFileError), match=f"^{words}"):
        convert(wide(poses, tmp_path / "a.csv"), unit="mm", **how)  # type: ignore[arg-type]


def test_names_that_agree_or_are_numbers_may_be_declared(poses: Array, tmp_path: Path) -> None:
    members, _ = convert(
        wide(poses, tmp_path / "a.csv"), unit="mm", joints=["pelvis", "right_knee", "left_knee", "Head"]
    )
    assert members["joints"].tolist() == ["pelvis", "right_knee", "left_knee", "Head"]
    named = pd.read_csv(tmp_path / "a.csv").rename(
        columns=lambda c: f"p{JOINTS.index(c[:-2])}{c[-2:]}" if "_" in c else c
    )
    named.to_csv(tmp_path / "b.csv", index=False)
    assert convert(tmp_path / "b.csv", unit="mm", joints=JOINTS)[0]["joints"].tolist() == JOINTS
    keypoints = np.random.default_rng(0).uniform(1, 500, (25, 3))
    (tmp_path / "a.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": keypoints.ravel().tolist()}]}))
    members, assumed = convert(tmp_path / "a.json", joints=[f"point {k}" for k in range(25)])
    assert members["joints"][3] == "point 3"
    assert not any("body-25" in line for line in assumed)


def test_every_format_is_in_the_docs() -> None:
    page = (Path(__file__).parents[2] / "docs/convert.md").read_text(encoding="utf-8")
    for name, about in FORMATS.items():
        assert f"| `{name}` | {about} |" in page


def test_the_command_names_flags_in_what_it_assumes(poses: Array, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", poses)
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.npy"), "-o", str(tmp_path / "out.npz")])
    assert done.exit_code == 0
    assert any(
        line.startswith("assumed: no unit is stated") and "--unit declares" in line for line in done.stderr.splitlines()
    )
