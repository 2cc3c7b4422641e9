"""Arrays of HDF5 and zarr are read in place, and give what arrays in memory give."""

import pickle
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.lazy import DatasetArray, split_address
from posecal.data.read import read_poses
from posecal.errors import PoseDataError, PoseFileError
from tests.helpers.samplers import gaussian

X, Y = gaussian(0, 8, 60, 5)
SEQUENCE = np.repeat(np.arange(6), 10).astype(str)


def expected() -> dict[str, float]:
    return posecal.evaluate(X, Y, unit="mm", axes="NMKD", labels={"sequence": SEQUENCE}, root_joint="none").scalars()


def check(report: posecal.Report) -> None:
    for name, value in expected().items():
        assert report.scalars()[name] == pytest.approx(value, rel=1e-9, nan_ok=True), name


def test_datasets_of_h5py_are_taken_as_they_are(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        hypotheses = file.create_dataset("x", data=X.transpose(1, 0, 2, 3), chunks=(7, 8, 5, 3))
        options: dict[str, Any] = {"unit": "mm", "axes": "MNKD", "labels": {"sequence": SEQUENCE}, "root_joint": "none"}
        check(posecal.evaluate(hypotheses, Y, **options))


@pytest.mark.parametrize("address", ["a.h5", "a.h5:hypotheses", "b.h5:run/x"])
def test_files_of_hdf5_declare_what_archives_declare(tmp_path: Path, address: str) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["hypotheses"], file["joints"] = X, [f"j{k}" for k in range(5)]
        file.attrs["unit"], file.attrs["axes"] = "mm", "NMKD"
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["run/x"], file["run/other"] = X, np.ones((3, 3, 3, 3))
        file["run"].attrs.update({"unit": "mm", "axes": "NMKD"})
    np.savez(tmp_path / "gt.npz", truth=Y, unit="mm", sequence=SEQUENCE, joints=[f"j{k}" for k in range(5)])
    report = posecal.evaluate(f"{tmp_path}/{address}", tmp_path / "gt.npz", root_joint="none")
    check(report)
    assert report.totals.spec.joints[0] == "j0"


def test_attributes_of_the_array_and_of_the_file_declare_too(tmp_path: Path) -> None:
    h5py, zarr = pytest.importorskip("h5py"), pytest.importorskip("zarr")
    np.savez(tmp_path / "gt.npz", truth=Y, unit="mm", sequence=SEQUENCE)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/x"] = X.transpose(1, 0, 2, 3) / 10
        file["run/x"].attrs["axes"] = "MNKD"
        file["run/x"].attrs["unit"] = "cm"
        file.attrs["unit"] = "m"  # of what states none itself
        file["run/y"] = Y / 1000
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w")
    array = group.create_array("hyps", shape=X.shape, dtype=X.dtype, chunks=(8, 16, 5, 3))
    array[:] = X / 1000
    array.attrs.update({"unit": "m", "axes": "NMKD"})
    for address, truth in (("a.h5:run/x", "gt.npz"), ("a.zarr", "gt.npz"), ("a.zarr", "a.h5:run/y")):
        labels = {} if truth == "gt.npz" else {"labels": {"sequence": SEQUENCE}}
        report = posecal.evaluate(f"{tmp_path}/{address}", f"{tmp_path}/{truth}", root_joint="none", **labels)
        assert report["mpjpe"] == pytest.approx(expected()["mpjpe"], rel=1e-6)


def test_arrays_of_zarr(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w")
    array = group.create_array("hyps", shape=X.shape, dtype=X.dtype, chunks=(8, 16, 5, 3))
    array[:] = X
    group.attrs.update({"unit": "mm", "axes": "NMKD"})
    options: dict[str, Any] = {"labels": {"sequence": SEQUENCE}, "root_joint": "none"}
    check(posecal.evaluate(array, Y, unit="mm", axes="NMKD", **options))
    check(posecal.evaluate(tmp_path / "a.zarr", Y, truth_unit="mm", **options))


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    assert split_address("C:/a.h5:run/x") == (Path("C:/a.h5"), "run/x")
    assert split_address("a.npz") == (Path("a.npz"), "")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"], file["b"] = X, X
    with pytest.raises(PoseDataError, match=r"^a\.h5 holds a \(8, 60, 5, 3\), b .*; expected hypotheses or hyps"):
        posecal.evaluate(tmp_path / "a.h5", Y)
    with pytest.raises((PoseDataError, PoseFileError), match=r"^a\.h5 holds a"):
        posecal.evaluate(f"{tmp_path}/a.h5:c", Y)
    (tmp_path / "b.h5").write_bytes(b"nothing")
    with pytest.raises(PoseFileError, match=r"^b\.h5: can't be read by h5py"):
        posecal.evaluate(tmp_path / "b.h5", Y)


def test_datasets_pickle_and_are_refused_where_they_are_closed_or_no_numbers(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/x"], file["words"] = X, ["a"]
    with h5py.File(tmp_path / "a.h5") as file:
        array = DatasetArray(file["run/x"])
        again = pickle.loads(pickle.dumps(array))
        with pytest.raises(PoseDataError, match=r"^words: dtype object; expected real numbers such as float32\.$"):
            DatasetArray(file["words"])
    where = (slice(1, 3), slice(2, 7), slice(0, 5), slice(0, 3))
    np.testing.assert_array_equal(again.part(where), X[1:3, 2:7])
    with pytest.raises(PoseFileError, match=r"can't be read \(.*\)\. Was the file closed, or cut off\?$"):
        array.part(where)


def test_a_dataset_that_claims_more_than_its_file_can_hold_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("hyps", shape=(10**6, 10**6, 17, 3), dtype="f4", chunks=(1, 10, 17, 3))
    with pytest.raises(
        PoseFileError, match=r"^hyps: 0 of 204,000,000,000,000 bytes of \(.*\) are there; expected all\.$"
    ):
        posecal.evaluate(tmp_path / "a.h5", Y)


@pytest.mark.slow
def test_a_large_dataset_takes_little_memory(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        data = file.create_dataset("hyps", shape=(200, 5000, 17, 3), dtype="f4", chunks=(200, 25, 17, 3))
        for start in range(0, 5000, 500):
            data[:, start : start + 500] = np.random.default_rng(start).normal(0, 300, (200, 500, 17, 3))
        data.attrs["note"] = "204 MB"
    np.savez(tmp_path / "gt.npz", truth=np.random.default_rng(0).normal(0, 300, (5000, 17, 3)), unit="mm")
    code = (
        "import posecal, resource, h5py, numpy\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "posecal.evaluate('a.h5', 'gt.npz', unit='mm', threads=1, metrics='mpjpe, ece')\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    unit = 1 if sys.platform == "darwin" else 1024
    assert int(done.stdout) * unit < 170e6
    assert resource.RUSAGE_SELF == 0


def test_an_array_of_zarr_that_claims_numbers_which_were_never_written_is_refused(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w")
    group.create_array("hypotheses", shape=(3_000_000, 4, 4, 3), chunks=(3, 4, 4, 3), dtype="float32")
    with pytest.raises(PoseFileError, match=r"hypotheses: \S+ of 576,000,000 bytes of \(3000000, 4, 4, 3\) are there"):
        read_poses(tmp_path / "a.zarr", "hypotheses")


def test_a_damaged_member_leaves_hdf5_unlocked_for_other_threads(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["hypotheses"] = np.zeros((2, 3, 4, 3))
        file["lost"] = h5py.SoftLink("/nowhere")
    with pytest.raises(PoseFileError, match=r"^a\.h5: can't be read by h5py"):
        read_poses(tmp_path / "a.h5", "hypotheses")
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(lambda: list(h5py.File(tmp_path / "a.h5"))).result(timeout=5) == ["hypotheses", "lost"]
