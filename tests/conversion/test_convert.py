"""Files of other tools, written here as those tools write them, become the file that posecal reads."""

import json
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import posecal
from posecal.cli import app
from posecal.conversion import FORMATS, convert
from posecal.data.read import read_poses
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.tables import JOINTS, Array, K, M, trc, wide

# --- documents ------------------------------------------------------------------------------------------------


def test_openpose_a_file_per_frame(poses: Array, tmp_path: Path) -> None:
    files = []
    for m in range(M):
        keypoints = np.concatenate([poses[m, :, :2], np.full((K, 1), 0.7)], axis=1).ravel().tolist()
        files.append(tmp_path / f"walk_{m:03}_keypoints.json")
        files[-1].write_text(json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": keypoints}]}))
    members, assumed = convert(files, joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses[..., :2])
    assert members["unit"] == "px"
    assert members["frame_id"][2] == "walk_002_keypoints"
    assert "each of 6 files is one frame" in assumed


def test_panoptic(tmp_path: Path) -> None:
    joints = np.random.default_rng(1).normal(0, 90, (19, 4))
    joints[:, 3] = 0.5
    joints[4, 3] = -1  # what Panoptic writes where it saw no joint
    (tmp_path / "a.json").write_text(
        json.dumps({"frame": 7, "bodies": [{"id": 0, "joints19": joints.ravel().tolist()}]})
    )
    members, assumed = convert(tmp_path / "a.json")
    assert np.flatnonzero(~members["valid"][0]).tolist() == [4]
    np.testing.assert_allclose(members["truth"][members["valid"]], np.delete(joints[:, :3], 4, axis=0))
    assert "joints of a confidence of 0 or less are not known" in assumed
    assert members["unit"] == "cm"
    assert members["joints"].tolist() == list(posecal.JOINT_SETS["panoptic-19"])
    assert members["frame_id"].tolist() == ["7"]
    assert "lengths are in cm, as the data set has them" in assumed


@pytest.mark.parametrize(("number", "joint_set"), [(25, "body-25"), (18, "coco-18"), (15, "")])
def test_joints_of_openpose_are_named_by_their_number(tmp_path: Path, number: int, joint_set: str) -> None:
    keypoints = np.random.default_rng(0).uniform(1, 500, (number, 3))
    (tmp_path / "a.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": keypoints.ravel().tolist()}]}))
    members, assumed = convert(tmp_path / "a.json")
    np.testing.assert_allclose(members["truth"][0], keypoints[:, :2])
    assert members.get("joints", np.array([])).tolist() == list(posecal.JOINT_SETS.get(joint_set, ()))
    assert (f"joints are those of {joint_set}, by their number" in assumed) == bool(joint_set)


def people(poses: Array, tool: str) -> dict[str, object]:
    """Two people in each frame, the second one first, as a tool writes them."""
    full = np.concatenate([np.stack([poses + 5, poses]), np.ones((2, M, K, 1))], axis=3)
    if tool == "mmpose":
        frames = [[{"keypoints": full[p, m, :, :3].tolist()} for p in range(2)] for m in range(M)]
        return {"instance_info": [{"frame_id": m + 1, "instances": some} for m, some in enumerate(frames)]}
    if tool == "panoptic":
        return {"bodies": [{"id": 9 - p, "joints19": np.resize(full[p, 0], 76).tolist()} for p in range(2)]}
    return {"people": [{"pose_keypoints_3d": full[p, 0].ravel().tolist()} for p in range(2)]}


@pytest.mark.parametrize(
    ("tool", "ids", "kind"),
    [("openpose", "01", "place in the list"), ("mmpose", "01", "place in the list"), ("panoptic", "98", "id")],
)
def test_one_of_several_people_is_chosen_and_none_is_taken_unasked(
    poses: Array, tmp_path: Path, tool: str, ids: str, kind: str
) -> None:
    (tmp_path / "a.json").write_text(json.dumps(people(poses, tool)))
    words = (
        rf'^a\.json: 2 people in a frame; expected one\. Pass person="{ids[0]}", or another of {ids[0]}, {ids[1]} '
        rf"\(by {kind}\)\.$"
    )
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.json", unit="m")
    members, _ = convert(tmp_path / "a.json", person=ids[1])
    np.testing.assert_allclose(members["truth"][0, :K], poses[0])
    assert convert(tmp_path / "a.json", person=int(ids[0]))[0]["truth"][0, 0, 0] == pytest.approx(poses[0, 0, 0] + 5)
    words = rf"^a\.json: no person 7 in a frame; it holds {ids[0]}, {ids[1]} \(by {kind}\)\.$"
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.json", person=7)
    out = str(tmp_path / "out.npz")
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.json"), "-o", out, "--person", ids[1], "--unit", "cm"])
    assert done.exit_code == 0, done.output


def test_a_person_of_a_file_without_people_is_refused(poses: Array, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(poses.tolist()))
    for path in (tmp_path / "a.json", wide(poses, tmp_path / "a.csv")):
        with pytest.raises(PoseDataError, match=rf"^person: 0 for {path.name}.*; expected "):
            convert(path, person=0)


def test_frames_of_mmpose_without_people_are_left_out(poses: Array, tmp_path: Path) -> None:
    frames = [{"frame_id": 3, "instances": []}, {"frame_id": 4, "instances": [{"keypoints": poses[0].tolist()}]}]
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames}))
    members, assumed = convert(tmp_path / "a.json", unit="m")
    assert (members["frame_id"].tolist(), assumed[0]) == (["4"], "left out: 1 frame without people")
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames[:1]}))
    with pytest.raises(PoseDataError, match=r"^a\.json: no people in 1 frames; expected one in some\.$"):
        convert(tmp_path / "a.json", unit="m")


def test_frames_without_the_chosen_person_are_left_out_and_counted(poses: Array, tmp_path: Path) -> None:
    def one(m: int, track: int) -> dict[str, object]:
        return {"keypoints": poses[m].tolist(), "track_id": track}

    found = [[one(0, 4)], [], [one(3, 5), one(2, 4)], [one(3, 5)]]
    frames = [{"frame_id": m, "instances": some} for m, some in enumerate(found)]
    (tmp_path / "a.json").write_text(json.dumps({"instance_info": frames}))
    members, assumed = convert(tmp_path / "a.json", unit="m", person=4)
    np.testing.assert_allclose(members["truth"], poses[[0, 2]])
    assert (members["frame_id"].tolist(), assumed[0]) == (["0", "2"], "left out: 2 frames without person 4")
    with pytest.raises(PoseDataError, match=r"^a\.json: no person 0 in a frame; it holds 4 \(by track_id\)\.$"):
        convert(tmp_path / "a.json", unit="m", person=0)
    files = [tmp_path / f"{m}.json" for m in range(3)]
    for m, path in enumerate(files):
        keypoints = np.concatenate([poses[m], np.ones((K, 1))], axis=1).ravel().tolist()
        path.write_text(json.dumps({"people": [{"pose_keypoints_3d": keypoints}] * (m != 1)}))
    members, assumed = convert(files, unit="mm")
    np.testing.assert_allclose(members["truth"], poses[[0, 2]])
    assert (members["frame_id"].tolist(), assumed[1]) == (["0", "2"], "left out: 1 frame without people")
    with pytest.raises(PoseDataError, match=r"^1\.json: 0 people in a frame; expected one\.$"):
        convert(files, unit="mm", each_file="hypothesis")


def test_interhand(tmp_path: Path) -> None:
    world = np.random.default_rng(2).normal(0, 90, (2, 42, 3))
    seen = np.ones((42, 1))
    seen[5] = 0
    frames = {str(m): {"world_coord": world[m].tolist(), "joint_valid": seen.tolist()} for m in range(2)}
    (tmp_path / "a.json").write_text(json.dumps({"0": frames}))
    members, _ = convert(tmp_path / "a.json")
    np.testing.assert_allclose(members["truth"][:, :5], world[:, :5])
    assert not members["valid"][:, 5].any()
    assert members["unit"] == "mm"
    assert members["sequence"].tolist() == ["0", "0"]


def test_results_of_mmpose(poses: Array, tmp_path: Path) -> None:
    frames = [
        {"frame_id": m, "instances": [{"keypoints": poses[m].tolist(), "keypoint_scores": [0.5] * K}]} for m in range(M)
    ]
    meta = {"keypoint_id2name": {str(k): name for k, name in enumerate(JOINTS)}}
    (tmp_path / "a.json").write_text(json.dumps({"meta_info": meta, "instance_info": frames}))
    members, _ = convert(tmp_path / "a.json", unit="m")
    np.testing.assert_allclose(members["truth"], poses)
    assert members["joints"].tolist() == JOINTS


def test_nested_lists(poses: Array, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(poses.tolist()))
    members, assumed = convert(tmp_path / "a.json", joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses)
    assert "no unit is stated: evaluate takes mm, or refuses what can't be mm; unit declares another" in assumed


# --- containers -----------------------------------------------------------------------------------------------


def test_data_sets_of_mmpose(poses: Array, tmp_path: Path) -> None:
    with_confidence = np.concatenate([poses / 1000, np.ones((M, K, 1))], axis=2)
    np.savez(
        tmp_path / "a.npz", S=with_confidence, part=np.ones((M, K, 3)), center=np.ones((M, 2)), imgname=list("abcdef")
    )
    members, assumed = convert(tmp_path / "a.npz", unit="m", joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses / 1000)
    assert members["frame_id"].tolist() == list("abcdef")
    assert "the fourth column is a confidence" in assumed


@pytest.mark.parametrize("axes", [None, "MKC", "MKD"])
def test_a_declared_confidence_is_taken_off_once(poses: Array, tmp_path: Path, axes: str | None) -> None:
    seen = np.full((M, K, 1), 0.5)
    seen[2, 1] = 0
    np.save(tmp_path / "a.npy", np.concatenate([poses, seen], axis=2))
    members, _ = convert(tmp_path / "a.npy", axes=axes, unit="mm")
    poses[2, 1] = np.nan
    np.testing.assert_allclose(members["truth"], poses)
    np.testing.assert_array_equal(members["confidence"], seen[..., 0])
    assert np.argwhere(~members["valid"]).tolist() == [[2, 1]]
    with_confidence = np.concatenate([np.stack([poses, poses + 1], axis=1), np.stack([seen, seen], axis=1)], axis=3)
    np.save(tmp_path / "b.npy", with_confidence)
    members, _ = convert(tmp_path / "b.npy", axes="MNKC", unit="mm")
    np.testing.assert_allclose(members["hypotheses"], [poses, poses + 1], rtol=1e-6)


def test_what_hdf5_states_of_an_array_counts(poses: Array, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/truth"] = poses.transpose(0, 2, 1) / 10
        file["run/truth"].attrs["axes"] = "MDK"
        file["run"].attrs["joints"] = JOINTS
        file["run/frame_id"] = np.arange(M)
        file.attrs["unit"] = "cm"
        file.attrs["fps"] = 50
    members, assumed = convert(tmp_path / "a.h5")
    np.testing.assert_allclose(members["truth"], poses / 10)
    assert (members["unit"], members["joints"].tolist(), members["fps"]) == ("cm", JOINTS, 50)
    assert assumed[0] == "what else stands beside run/truth is not converted: frame_id"
    for wrong in ({"unit": "mm"}, {"axes": "MKD"}, {"fps": 60}):
        with pytest.raises(
            PoseDataError, match=rf"^a\.h5 states {next(iter(wrong))} .*; expected no .*Leave it out\.$"
        ):
            convert(tmp_path / "a.h5", **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_matlab(poses: Array, tmp_path: Path, version: str) -> None:
    pytest.importorskip("pymatreader")
    path = tmp_path / "a.mat"
    if version == "5":
        from scipy.io import savemat

        savemat(path, {"data": {"poses": poses, "other": np.ones(3)}})
    else:
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:
            file.create_dataset("data/poses", data=poses.T)
        stamp = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        with path.open("r+b") as raw:
            raw.write(stamp)
    members, _ = convert(path, unit="mm", joints=JOINTS, dataset="data/poses")
    np.testing.assert_allclose(members["truth"], poses)


def test_hdf5(poses: Array, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["group/hyps"] = np.stack([poses, poses + 1])
        file["group/other"] = np.ones((M, K, 3))
    with pytest.raises(PoseDataError, match=r"^a\.h5: holds group/hyps \(2, 6, 4, 3\), group/other .* Name it with"):
        convert(tmp_path / "a.h5")
    with pytest.raises(PoseDataError, match=r'^a\.h5: an array \(2, 6, 4, 3\), .* Pass axes="NMKD" or axes="MNKD"\.$'):
        convert(tmp_path / "a.h5", dataset="group/hyps", unit="mm")
    members, _ = convert(tmp_path / "a.h5", dataset="group/hyps", axes="NMKD", unit="mm")
    np.testing.assert_allclose(members["hypotheses"], [poses, poses + 1], rtol=1e-6)


def test_tensors_of_pytorch_and_nothing_else(poses: Array, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    torch.save({"poses": torch.tensor(poses.reshape(M, -1)), "epoch": 3}, tmp_path / "a.pt")
    members, _ = convert(tmp_path / "a.pt", axes="M(KD)", unit="mm", joints=JOINTS)
    np.testing.assert_allclose(members["truth"], poses)
    torch.save({"poses": Path("/tmp")}, tmp_path / "b.pt")
    with pytest.raises(PoseFileError, match=r"^b\.pt: holds more than tensors"):
        convert(tmp_path / "b.pt", unit="mm")


def test_tensors_of_half_precision(poses: Array, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    torch.save({"poses": torch.tensor(poses).bfloat16(), "unit": "mm"}, tmp_path / "a.pt")
    members, _ = convert(tmp_path / "a.pt")
    np.testing.assert_allclose(members["truth"], poses, rtol=2**-8)
    assert members["unit"] == "mm"


def test_pickles_of_arrays_and_nothing_else(poses: Array, tmp_path: Path) -> None:
    for protocol in (2, 4, 5):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps({"poses": poses, "fps": 30}, protocol=protocol))
        members, _ = convert(tmp_path / "a.pkl", unit="mm")
        np.testing.assert_allclose(members["truth"], poses)
    (tmp_path / "b.pkl").write_bytes(b"cos\nsystem\n(S'touch pwned'\ntR.")
    with pytest.raises(PoseFileError, match=r"b\.pkl: asks for os\.system; expected a pickle of plain arrays"):
        convert(tmp_path / "b.pkl", unit="mm")
    (tmp_path / "c.pkl").write_bytes(b"\x80\x05\x96" + (2 << 30).to_bytes(8, "little") + b".")
    with pytest.raises(PoseFileError, match=r"c\.pkl: claims a bytearray of 2,147,483,648 bytes; expected a pickle"):
        convert(tmp_path / "c.pkl", unit="mm")


def test_c3d(poses: Array, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [100]
    content["parameters"]["POINT"]["LABELS"]["value"] = JOINTS
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    content["data"]["points"] = np.concatenate([poses, np.ones((M, K, 1))], axis=2).transpose(2, 1, 0)
    content.write(str(tmp_path / "a.c3d"))
    members, _ = convert(tmp_path / "a.c3d")
    np.testing.assert_allclose(members["truth"], poses, rtol=1e-5)
    assert (members["unit"], members["fps"]) == ("mm", 100.0)
    assert members["joints"].tolist() == JOINTS


def test_markers_that_c3d_lost_are_not_known(poses: Array, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [100]
    content["parameters"]["POINT"]["LABELS"]["value"] = JOINTS
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points = np.concatenate([poses, np.ones((M, K, 1))], axis=2).transpose(2, 1, 0)
    points[:3, 1, 2] = 0
    residuals = np.zeros((1, K, M))
    residuals[0, 3, 4] = -1
    content["data"]["points"], content["data"]["meta_points"]["residuals"] = points, residuals
    content.write(str(tmp_path / "a.c3d"))
    members, assumed = convert(tmp_path / "a.c3d")
    assert np.argwhere(~members["valid"]).tolist() == [[2, 1], [4, 3]]
    assert "markers at exactly 0, 0, 0 are not known" in assumed


# --- several files, the command, and what is refused ----------------------------------------------------------


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
