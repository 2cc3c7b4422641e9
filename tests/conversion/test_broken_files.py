"""Files of other tools that are cut off, damaged or not what they seem are refused, each in one sentence."""

import io
import json
import pickle
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.conversion import convert
from posecal.errors import PosecalError, PoseFileError
from tests.helpers.tables import JOINTS, Array


def zip_version(path: Path, version: int) -> None:
    contents = bytearray(path.read_bytes())
    contents[contents.index(b"PK\x01\x02") + 6] = version
    path.write_bytes(contents)


def test_an_archive_of_another_version_of_zip(poses: Array, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", S=poses)
    zip_version(tmp_path / "a.npz", 255)
    with pytest.raises(PoseFileError, match=r"^a\.npz: can't be read as \.npz \(zip file version 25\.5\)\.$"):
        convert(tmp_path / "a.npz")


def test_a_wrong_number_in_an_archive_is_caught_by_its_checksum(poses: Array, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", S=poses)
    contents = bytearray((tmp_path / "a.npz").read_bytes())
    contents[200] ^= 1
    (tmp_path / "a.npz").write_bytes(contents)
    with pytest.raises(PoseFileError, match=r"Bad CRC-32 for file 'S\.npy'"):
        convert(tmp_path / "a.npz")


def test_a_wrong_number_in_a_tensor_is_caught_by_its_checksum(poses: Array, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    torch.save({"poses": torch.from_numpy(poses)}, tmp_path / "a.pt")
    contents = bytearray((tmp_path / "a.pt").read_bytes())
    contents[contents.index(poses.tobytes()) + 5] ^= 1
    (tmp_path / "a.pt").write_bytes(contents)
    with pytest.raises(PoseFileError, match=r"^a\.pt: a/data/0 is damaged\. Copy it again\.$"):
        convert(tmp_path / "a.pt")


def test_a_tensor_that_repeats_one_number_is_not_spread_out(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    torch.save(torch.zeros(1).expand(10**5, 17, 3), tmp_path / "a.pt")
    with pytest.raises(PosecalError, match=r"a tensor \(100000, 17, 3\) of fewer numbers; expected as many as it has"):
        convert(tmp_path / "a.pt")


def test_lists_that_share_their_parts_are_not_spread_out(tmp_path: Path) -> None:
    held: Any = [0.5] * 10
    for _ in range(9):
        held = [held] * 10
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
    with pytest.raises(PoseFileError, match="repeats its parts many times"):
        convert(tmp_path / "a.pkl")


@pytest.mark.parametrize(
    "name", ["a.json", "a.mat", "a.h5", "a.c3d", "a.csv", "a.trc", "a.npy", "a.npz", "a.pt", "a.pkl"]
)
@pytest.mark.parametrize(
    "contents", [b"", b"\x93NUMPY\x01\x00v\x00{'descr'", b"PK\x03\x04 and no more", b"[" * 100_000]
)
def test_bytes_of_something_else(name: str, contents: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(contents)
    with pytest.raises(PosecalError, match=rf"{name}|not installed") as refused:
        convert(tmp_path / name)
    assert len(str(refused.value)) < 700


def test_a_recording_that_was_cut_off_is_refused_before_its_end_is_looked_for(poses: Array, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [50]
    content["parameters"]["POINT"]["LABELS"]["value"] = tuple(JOINTS)
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    content["data"]["points"] = np.concatenate([poses.transpose(2, 1, 0), np.ones((1, *poses.shape[1::-1]))])
    content.write(str(tmp_path / "a.c3d"))
    whole = (tmp_path / "a.c3d").read_bytes()
    data = 512 * (struct.unpack_from("<H", whole, 16)[0] - 1)
    needed = data + poses.shape[0] * poses.shape[1] * 4 * 4
    (tmp_path / "a.c3d").write_bytes(whole[:needed])
    convert(tmp_path / "a.c3d")
    for size in (needed - 1, data, 700):
        (tmp_path / "a.c3d").write_bytes(whole[:size])
        with pytest.raises(
            PoseFileError, match=rf"^a\.c3d: is no \.c3d file .*\({size:,} of {needed:,} bytes are there\)"
        ):
            convert(tmp_path / "a.c3d")


def test_an_hdf5_file_that_claims_numbers_which_were_never_written(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("poses", shape=(10**8, 17, 3), dtype="f8", chunks=(1000, 17, 3))
    with pytest.raises(PoseFileError, match=r"poses: 0 of 40,800,000,000 bytes of \(100000000, 17, 3\) are there"):
        convert(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"people": [{"pose_keypoints_2d": [1.0, 2.0]}]}, r"a\.json: is not as openpose writes it"),
        ({"bodies": [{"joints19": [1.0] * 75}]}, r"a\.json: is not as panoptic writes it"),
        (
            {"0": {"0": {"world_coord": [[1, 2, 3]], "joint_valid": [[1], [1, 2]]}}},
            r"a\.json: is not as interhand writes",
        ),
        ([[[1, 2, 3]], [[1, 10**400, 3]]], r"a\.json: can't be read"),
        ([], r"a\.json: nothing in it; its shape is \(0,\)"),
    ],
)
def test_documents_of_another_form(document: Any, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(PosecalError, match=words):
        convert(tmp_path / "a.json")


def test_names_of_joints_that_are_no_texts_become_texts(poses: Array, tmp_path: Path) -> None:
    frames = [{"instances": [{"keypoints": pose.tolist()}]} for pose in poses]
    named = dict(zip("0123", ["Hip", ["a", "b"], 3, None], strict=True))
    (tmp_path / "a.json").write_text(json.dumps({"meta_info": {"keypoint_id2name": named}, "instance_info": frames}))
    members, _ = convert(tmp_path / "a.json")
    assert members["joints"].tolist() == ["Hip", "['a', 'b']", "3", "None"]


def test_a_member_that_is_none_is_named(tmp_path: Path) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("S.npy", b"words")
    (tmp_path / "a.npz").write_bytes(file.getvalue())
    with pytest.raises(PoseFileError, match=r"^a\.npz: S: no \.npy header that can be read"):
        convert(tmp_path / "a.npz")
