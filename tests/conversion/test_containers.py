"""Arrays in containers, .npz to C3D, as they are converted, each from a file that is written here."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from posecal.conversion import convert
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.tables import JOINTS, Array, K, M


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
        file["run/frame_id"] = np.arange(10, 10 + M)
        file["run/sequence"] = np.array(["walk"] * M, "S")
        file["run/action"] = np.array(["walk", "run"], "S")
        file["run/valid"] = np.arange(M) > 0
        file.attrs["unit"] = "cm"
        file.attrs["fps"] = 50
    members, assumed = convert(tmp_path / "a.h5")
    np.testing.assert_allclose(members["truth"], poses / 10)
    assert (members["unit"], members["joints"].tolist(), members["fps"]) == ("cm", JOINTS, 50)
    assert members["frame_id"].tolist() == [str(10 + frame) for frame in range(M)]
    assert members["sequence"].tolist() == ["walk"] * M
    assert members["valid"].tolist() == [[frame > 0] * K for frame in range(M)]
    words = f"what is not of its {M} frames or {K} joints is not converted: action (2,)"
    assert words in assumed
    assert "action" not in members
    for wrong in ({"unit": "mm"}, {"axes": "MKD"}, {"fps": 60}):
        with pytest.raises(
            PoseDataError, match=rf"^a\.h5 states {next(iter(wrong))} .*; expected no .*Leave it out\.$"
        ):
            convert(tmp_path / "a.h5", **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(("axes", "shape"), [("NMKD", (2, M)), ("MNKD", (M, 2))])
def test_scores_follow_the_layout(poses: Array, tmp_path: Path, axes: str, shape: tuple[int, int]) -> None:
    hypotheses = np.stack([poses, poses + 1], axis=axes.index("N"))
    scores = np.arange(2 * M, dtype=np.float64).reshape(shape)
    beside = {"scores": scores, "weights": np.full(shape, 0.5), "axes": axes, "unit": "mm"}
    np.savez(tmp_path / "a.npz", hypotheses=hypotheses, **beside)  # type: ignore[arg-type]
    members, _ = convert(tmp_path / "a.npz")
    assert members["axes"] == "NMKD"
    assert members["weights"].shape == (2, M)
    np.testing.assert_array_equal(members["scores"], scores if axes == "NMKD" else scores.T)
    np.testing.assert_allclose(members["hypotheses"], [poses, poses + 1], rtol=1e-6)


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
