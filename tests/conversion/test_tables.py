"""Tables of other tools, in text and in HDF5, become the file that posecal reads."""

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

import posecal
from posecal.conversion import convert
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.tables import JOINTS, Array, K, M, long, trc, wide


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


def test_a_hypothesis_that_lacks_a_frame_is_absent(poses: Array, tmp_path: Path) -> None:
    both = [pd.read_csv(long(poses + 5 * n, tmp_path / "a.csv", hypothesis=n)) for n in range(3)]
    both[1] = both[1][both[1]["frame"] != 4]
    both = [some[(some["frame"] != 5) | (some["joint"] != "Head")] for some in both]
    pd.concat(both).to_csv(tmp_path / "a.csv", index=False)
    members, assumed = convert(tmp_path / "a.csv", unit="mm")
    assert np.argwhere(np.isnan(members["hypotheses"]).all(axis=(2, 3))).tolist() == [[1, 4]]
    assert np.argwhere(~members["valid"]).tolist() == [[5, JOINTS.index("Head")]]
    assert "1 of 18 hypotheses are absent from a frame (NaN)" in assumed


@pytest.mark.parametrize(("separator", "decimal"), [(";", "."), (";", ","), ("\t", ".")])
def test_tables_of_other_separators(poses: Array, tmp_path: Path, separator: str, decimal: str) -> None:
    table = pd.read_csv(wide(poses, tmp_path / "a.csv"))
    table.to_csv(tmp_path / "a.csv", index=False, sep=separator, decimal=decimal)
    members, _ = convert(tmp_path / "a.csv", unit="mm")
    np.testing.assert_allclose(members["truth"], poses)
    assert members["joints"].tolist() == JOINTS


def test_decimal_commas_between_commas_are_called_so(poses: Array, tmp_path: Path) -> None:
    head, *rows = wide(poses, tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join([head, *(row.replace(".", ",") for row in rows)]))
    with pytest.raises(PoseDataError, match=r"^a\.csv: 25 columns below 13 names; expected as many\. Decimal commas\?"):
        convert(tmp_path / "a.csv", unit="mm")


def test_a_repeated_row_is_named_in_words(poses: Array, tmp_path: Path) -> None:
    table = pd.read_csv(long(poses, tmp_path / "a.csv"))
    pd.concat([table, table.iloc[[2 * K + 1]]]).to_csv(tmp_path / "a.csv", index=False)
    words = rf"^a\.csv: row {M * K + 2} repeats a joint of its frame \(frame 2, joint RKnee\); expected each once\.$"
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.csv", unit="mm")


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


@pytest.mark.parametrize("form", ["csv", "fixed"])
def test_deeplabcut_of_several_animals_is_called_so(poses: Array, tmp_path: Path, form: str) -> None:
    def save(animals: list[str]) -> Path:
        keys = [["DLC"], animals, JOINTS, ["x", "y", "likelihood"]]
        columns = pd.MultiIndex.from_product(keys, names=["scorer", "individuals", "bodyparts", "coords"])
        values = np.concatenate([poses[..., :2], np.full((M, K, 1), 0.9)], axis=2).reshape(M, -1)
        table = pd.DataFrame(np.tile(values, len(animals)), columns=columns)
        if form == "csv":
            table.to_csv(tmp_path / "a.csv")
            return tmp_path / "a.csv"
        pytest.importorskip("tables")
        pytest.importorskip("h5py")
        table.to_hdf(tmp_path / "a.h5", key="df_with_missing", mode="w", format=form)
        return tmp_path / "a.h5"

    with pytest.raises(PoseDataError, match=r"^a\.\w+: a table of 2 animals \(one, two\); expected one\. Keep the col"):
        convert(save(["one", "two"]))
    np.testing.assert_allclose(convert(save(["one"]))[0]["truth"], poses[..., :2])


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


@pytest.mark.parametrize("frame", ["percent", "frame"])
def test_a_table_of_angles_with_a_row_per_hypothesis_is_evaluated(tmp_path: Path, frame: str) -> None:
    truth = pd.DataFrame(
        [(f"trial {t}", p, 10.0 * t + p, -5.0) for t in (1, 2) for p in range(4)],
        columns=["Trial", frame, "knee flexion", "hip_x"],
    )
    samples = pd.concat([truth.assign(sample=n, **{"knee flexion": truth["knee flexion"] + n}) for n in range(3)])
    truth.to_csv(tmp_path / "knee.csv", index=False)
    samples.sample(frac=1, random_state=0).to_csv(tmp_path / "samples.csv", index=False)
    for name in ("knee", "samples"):
        convert(tmp_path / f"{name}.csv", tmp_path / f"{name}.npz", like="angles", unit="deg")
    report = posecal.evaluate(tmp_path / "samples.npz", tmp_path / "knee.npz", metrics="mpjpe", by="sequence")
    assert report.totals.spec.joints == ("knee flexion", "hip_x")
    assert report["mpjpe"] == pytest.approx((0 + 1 + 2) / 3 / 2)  # the hip's is right
    assert [*report.groups] == [None, "sequence=trial 1", "sequence=trial 2"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,side\n1,left\n", "column side holds 'left'; expected numbers"),
        ("knee\n1\n", "no column percent, time or frame"),
        ("trial,time\na,1\n", "no column of an angle"),
        ("time,sample,knee\n1,1,2\n1,1,3\n", "row 3 repeats a joint of its frame"),
        ("time,trial,sequence,knee\n1,a,b,2\n", "columns trial and sequence; expected one of them"),
    ],
)
def test_a_table_of_angles_that_is_none_says_why(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(PoseDataError, match=words):
        convert(tmp_path / "a.csv", like="angles", unit="deg")


def test_times_beside_frames_and_row_numbers_are_no_angles(tmp_path: Path) -> None:
    table = pd.DataFrame({"frame": [1, 2], "time": [0.1, 0.2], "percent": [0, 50], "knee": [10.0, 20.0]})
    table.to_csv(tmp_path / "a.csv")  # with pandas' row numbers, in a column without a name
    members, lines = convert(tmp_path / "a.csv", like="angles", unit="deg")
    assert members["joints"].tolist() == ["knee"]
    assert members["frame_id"].tolist() == ["1", "2"]
    assert [line for line in lines if "are no angles and were left out" in line]


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


def test_empty_cells_of_trc_and_csv_are_not_known(poses: Array, tmp_path: Path) -> None:
    path = trc(poses, tmp_path / "a.trc")
    lines = path.read_text().splitlines()
    cells = lines[8].split("\t")  # of the third frame
    cells[5:8] = ["", "", ""]
    path.write_text("\n".join([*lines[:8], "\t".join(cells), *lines[9:]]))
    assert np.argwhere(~convert(path)[0]["valid"]).tolist() == [[2, 1]]
    rows = wide(poses, tmp_path / "a.csv").read_text().splitlines()
    cells = rows[3].split(",")
    cells[5] = " "
    (tmp_path / "a.csv").write_text("\n".join([*rows[:3], ",".join(cells), *rows[4:]]))
    assert np.argwhere(~convert(tmp_path / "a.csv", unit="mm")[0]["valid"]).tolist() == [[2, 1]]


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
