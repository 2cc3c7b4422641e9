"""Files of other tools, written here as those tools write them, become the file that posecal reads."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import posecal
from posecal.cli import app
from posecal.conversion import FORMATS, convert
from posecal.data.read import read_poses
from posecal.errors import PoseDataError, PoseFileError

Array = np.ndarray[Any, Any]
JOINTS = ["Hip", "RKnee", "LKnee", "Head"]
M, K = 6, 4


@pytest.fixture
def poses() -> Array:
    return np.random.default_rng(0).normal(0, 300, (M, K, 3)).round(3)


def wide(poses: Array, path: Path, form: str = "{joint}_{axis}") -> Path:
    names = [form.format(joint=joint, axis=axis) for joint in JOINTS for axis in "xyz"[: poses.shape[2]]]
    pd.DataFrame(poses.reshape(len(poses), -1), columns=names).to_csv(path, index_label="frame")
    return path


def long(poses: Array, path: Path, **more: Any) -> Path:
    rows = [
        {"frame": m, "joint": JOINTS[k], **dict(zip("xyz", poses[m, k], strict=True)), **more}
        for m in range(len(poses))
        for k in range(K)
    ]
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def trc(poses: Array, path: Path, unit: str = "mm") -> Path:
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"60.00\t60.00\t{len(poses)}\t{K}\t{unit}\t60.00\t1\t{len(poses)}",
        "Frame#\tTime\t" + "\t\t\t".join(JOINTS) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k}" for k in range(1, K + 1) for axis in "XYZ"),
        "",
    ]
    rows = ["\t".join([str(m + 1), f"{m / 60:.4f}", *(f"{v}" for v in poses[m].ravel())]) for m in range(len(poses))]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path


# --- tables ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["{joint}_{axis}", "{joint}.{axis}", "{joint} {axis}", "{joint}:{axis}"])
def test_a_table_with_a_row_per_frame(poses: Array, tmp_path: Path, form: str) -> None:
    members, assumed = convert(wide(poses, tmp_path / "a.csv", form), unit="mm")
    np.testing.assert_allclose(members["truth"], poses)
    assert members["joints"].tolist() == JOINTS
    assert members["frame_id"].tolist() == [str(m) for m in range(M)]
    assert assumed == ["6 frames of 4 joints are the truth"]


def test_a_table_with_a_row_per_joint_in_any_order(poses: Array, tmp_path: Path) -> None:
    path = long(poses, tmp_path / "a.csv", sequence="walk 1")
    table = pd.read_csv(path)
    table = pd.concat([table.iloc[:K], table.iloc[K:].sample(frac=1, random_state=1)])
    table.to_csv(path, index=False)
    members, _ = convert(path, unit="mm")
    order = [int(frame) for frame in members["frame_id"]]
    np.testing.assert_allclose(members["truth"], poses[order])
    assert members["sequence"].tolist() == ["walk 1"] * M


def test_a_long_table_holds_hypotheses(poses: Array, tmp_path: Path) -> None:
    both = [pd.read_csv(long(poses + 5 * n, tmp_path / "a.csv", hypothesis=n)) for n in range(3)]
    pd.concat(both).to_csv(tmp_path / "a.csv", index=False)
    members, assumed = convert(tmp_path / "a.csv", unit="mm")
    np.testing.assert_allclose(members["hypotheses"], [poses, poses + 5, poses + 10], rtol=1e-6)
    assert members["axes"] == "NMKD"
    assert "6 frames of 4 joints are 3 hypotheses" in assumed


def test_what_is_empty_is_not_valid(poses: Array, tmp_path: Path) -> None:
    poses[2, 1], poses[4] = np.nan, np.nan
    members, assumed = convert(wide(poses, tmp_path / "a.csv"), tmp_path / "gt.npz", unit="mm")
    np.testing.assert_array_equal(members["valid"], np.isfinite(poses).all(axis=2))
    assert "5 of 24 joints are not known (NaN), and not valid" in assumed
    hypotheses = np.nan_to_num(poses) + np.zeros((3, M, K, 3))
    data = posecal.PoseData(hypotheses, tmp_path / "gt.npz", joints=JOINTS, axes="NMKD", unit="mm")
    assert data.shape == (3, M - 1, K, 3)


def deeplabcut(poses: Array) -> pd.DataFrame:
    columns = pd.MultiIndex.from_product(
        [["DLC"], JOINTS, ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"]
    )
    values = np.concatenate([poses[..., :2], np.full((M, K, 1), 0.9)], axis=2).reshape(M, -1)
    return pd.DataFrame(values, columns=columns)


@pytest.mark.parametrize("form", ["csv", "fixed", "table"])
def test_deeplabcut(poses: Array, tmp_path: Path, form: str) -> None:
    path = tmp_path / ("a.csv" if form == "csv" else "a.h5")
    if form == "csv":
        deeplabcut(poses).to_csv(path)
    else:
        pytest.importorskip("tables")
        pytest.importorskip("h5py")
        deeplabcut(poses).to_hdf(path, key="df_with_missing", mode="w", format=form)
    members, _ = convert(path)
    np.testing.assert_allclose(members["truth"], poses[..., :2])
    assert members["joints"].tolist() == JOINTS
    assert members["unit"] == "px"
    np.testing.assert_allclose(members["confidence"], 0.9)


class Opens:
    """What makes a folder where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize(("form", "attribute"), [("table", "non_index_axes"), ("fixed", "encoding"), ("fixed", "any")])
def test_a_table_in_hdf5_runs_no_code(poses: Array, tmp_path: Path, form: str, attribute: str) -> None:
    pytest.importorskip("tables")
    h5py = pytest.importorskip("h5py")
    deeplabcut(poses).to_hdf(tmp_path / "a.h5", key="df_with_missing", mode="w", format=form)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        hostile = np.bytes_(pickle.dumps(Opens(tmp_path / "made"), protocol=0))
        file["df_with_missing"].attrs[attribute] = hostile
    if form == "table":
        with pytest.raises(
            PoseFileError, match=r"^a\.h5: names of columns: asks for posix\.mkdir; expected a pickle of"
        ):
            convert(tmp_path / "a.h5")
    else:
        np.testing.assert_allclose(convert(tmp_path / "a.h5")[0]["truth"], poses[..., :2])
    assert not (tmp_path / "made").exists()


def test_a_table_of_several_types_in_hdf5_is_refused(poses: Array, tmp_path: Path) -> None:
    pytest.importorskip("tables")
    pytest.importorskip("h5py")
    table = deeplabcut(poses)
    table["DLC", "Hip", "x"] = range(M)
    for form in ("table", "fixed"):
        table.to_hdf(tmp_path / "a.h5", key="df_with_missing", mode="w", format=form)
        with pytest.raises(
            PoseDataError, match=r"^a\.h5: columns of several types(, or none)?; expected numbers\. Save it as \.csv"
        ):
            convert(tmp_path / "a.h5")


def test_a_pickle_of_eleven_bytes_takes_no_gigabytes(tmp_path: Path) -> None:
    (tmp_path / "a.pkl").write_bytes(b"\x80\x02]r\xff\xff\xff\x3f.")  # an empty list, with memo index 2^30
    code = (
        "import resource, sys, posecal\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: posecal.convert(sys.argv[1], unit='m')\nexcept ValueError: pass\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "a.pkl"], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 200  # MB, those of the libraries


def test_tables_that_are_cut_off_are_refused(poses: Array, tmp_path: Path) -> None:
    whole = trc(poses, tmp_path / "a.trc").read_text()
    lines = whole.splitlines()
    for text, words in (
        ("\n".join(lines[:-1]), r"a\.trc: 5 of 6 frames are there\. Was the file cut off\?"),
        (whole[:-40], r"a\.trc: \d+ columns for 4 markers; expected 14\."),
    ):
        (tmp_path / "a.trc").write_text(text)
        with pytest.raises(PoseDataError, match=f"^{words}"):
            convert(tmp_path / "a.trc")
    text = wide(poses, tmp_path / "a.csv").read_text()
    (tmp_path / "a.csv").write_text(text[: text.rindex(",")])
    with pytest.raises(PoseDataError, match=r"^a\.csv: 1 of 7 rows have another number of columns \(first: row 7\);"):
        convert(tmp_path / "a.csv", unit="mm")


def test_sequences_of_a_long_table_count_their_frames_anew(poses: Array, tmp_path: Path) -> None:
    both = [
        pd.read_csv(long(poses + 5 * n, tmp_path / "a.csv", sequence=f"walk {n}", confidence=1.0)) for n in range(2)
    ]
    table = pd.concat(both, ignore_index=True)
    table.loc[M * K + 1, "confidence"] = 0
    table.to_csv(tmp_path / "a.csv", index=False)
    members, _ = convert(tmp_path / "a.csv", unit="mm")
    assert np.argwhere(~members["valid"]).tolist() == [[M, 1]]
    expected = np.concatenate([poses, poses + 5])
    np.testing.assert_allclose(members["truth"][members["valid"]], expected[members["valid"]])
    assert members["frame_id"][[0, M]].tolist() == ["walk 0/0", "walk 1/0"]
    assert members["sequence"].tolist() == ["walk 0"] * M + ["walk 1"] * M


def test_joints_that_openpose_did_not_see_are_not_valid(poses: Array, tmp_path: Path) -> None:
    keypoints = np.concatenate([poses[0], np.ones((K, 1))], axis=1)
    keypoints[2] = 0
    person = {"pose_keypoints_3d": keypoints.ravel().tolist()}
    (tmp_path / "a.json").write_text(json.dumps({"people": [person]}))
    members, _ = convert(tmp_path / "a.json", unit="mm")
    assert members["valid"].tolist() == [[True, True, False, True]]


def test_names_that_end_in_x_are_no_coordinates(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("index,ThoraxX,ThoraxY,ThoraxZ,apex_x,apex_y,apex_z\n7,1,2,3,4,5,6\n")
    members, assumed = convert(tmp_path / "a.csv", unit="mm")
    assert (members["joints"].tolist(), members["truth"].tolist()) == (["Thorax", "apex"], [[[1, 2, 3], [4, 5, 6]]])
    assert assumed[0] == "columns index are no coordinates and were left out"


def test_anipose(poses: Array, tmp_path: Path) -> None:
    columns = {f"{joint}_{axis}": poses[:, k, d] for k, joint in enumerate(JOINTS) for d, axis in enumerate("xyz")}
    columns |= {f"{joint}_{what}": np.full(M, 0.5) for joint in JOINTS for what in ("error", "score", "ncams")}
    pd.DataFrame({**columns, "fnum": range(M)}).to_csv(tmp_path / "a.csv", index=False)
    members, assumed = convert(tmp_path / "a.csv", like="anipose", unit="mm")
    np.testing.assert_allclose(members["truth"], poses)
    np.testing.assert_allclose(members["confidence"], 0.5)
    assert any(line.startswith("columns Hip_error, Hip_ncams, RKnee_error and 5 more are no coord") for line in assumed)


def test_mediapipe(poses: Array, tmp_path: Path) -> None:
    columns = {f"{joint}_{axis}": poses[:, k, d] for k, joint in enumerate(JOINTS) for d, axis in enumerate("xyz")}
    pd.DataFrame({**columns, **{f"{joint}_visibility": np.ones(M) for joint in JOINTS}}).to_csv(tmp_path / "a.csv")
    members, _ = convert(tmp_path / "a.csv", like="mediapipe", unit="m")
    np.testing.assert_allclose(members["truth"], poses)
    assert members["confidence"].shape == (M, K)


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_trc(poses: Array, tmp_path: Path, unit: str) -> None:
    path = trc(poses, tmp_path / "a.trc", unit)
    members, assumed = convert(path)
    np.testing.assert_allclose(members["truth"], poses)
    assert (members["unit"], members["fps"]) == (unit, 60.0)
    assert members["joints"].tolist() == JOINTS
    assert members["frame_id"].tolist() == ["1", "2", "3", "4", "5", "6"]
    assert assumed == ["6 frames of 4 joints are the truth"]
    with pytest.raises(PoseDataError, match=rf"^a\.trc states unit {unit}; expected no unit=.cm.\. Leave it out\.$"):
        convert(path, unit="cm")


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
    assert "no unit is stated; unit declares it" in [posecal.errors.for_python(line) for line in assumed]


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
    with pytest.raises(PoseDataError, match=r"^b\.pt: holds more than tensors"):
        convert(tmp_path / "b.pt", unit="mm")


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


def test_every_format_is_in_the_docs() -> None:
    page = (Path(__file__).parents[2] / "docs/convert.md").read_text(encoding="utf-8")
    for name, about in FORMATS.items():
        assert f"| `{name}` | {about} |" in page
