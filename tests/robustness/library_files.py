"""Files that a library of an extra writes and reads, and those of the estimators, with the commands that read them."""

from __future__ import annotations

import io
import pickle
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from tests.robustness import bytes_and_zips, texts
from tests.robustness.files import (
    HDF5,
    JOINTS,
    JSON,
    NPZ,
    OBJECT_NPZ,
    PICKLE,
    TOML,
    TORCH,
    WEIGHTS,
    Case,
    K,
    M,
    _never,
    _raw,
    hypotheses,
    truth,
)

BYTES = bytes_and_zips.BYTES


def _convert(name: str, changes: Any, exact: Any = _never) -> Case:
    return Case("posecal", ("convert", name, "-o", "out.npz"), name, changes, exact)


def library_cases(folder: Path) -> Iterator[Case]:
    """Write the files of those libraries that are installed, and give their cases."""
    few = ("gt.npz", "--metrics", "mpjpe", "--format", "json")
    if find_spec("h5py"):
        import h5py

        with h5py.File(folder / "hyps.h5", "w") as file:
            file.create_dataset("hypotheses", data=hypotheses(), chunks=(1, M, K, 3), compression="gzip")
            file["joints"], file["scores"] = np.array(JOINTS, "S"), np.ones((3, M))
            file["frame_id"] = np.array(["p/0", "p/1", "q/0", "q/1"], "S")
            file.attrs["unit"], file.attrs["axes"] = "mm", "NMKD"
        with h5py.File(folder / "one.h5", "w") as file:
            file["poses"] = truth()
        _deeplabcut(folder / "dlc.h5")
        yield Case("posecal", ("evaluate", "hyps.h5", *few), "hyps.h5", HDF5, _never)
        yield _convert("one.h5", HDF5)
        yield _convert("dlc.h5", HDF5)
    if find_spec("zarr"):
        import zarr

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of text in zarr
            group = zarr.open_group(str(folder / "hyps.zarr"), mode="w")
            group.create_array("hypotheses", data=hypotheses(), chunks=(3, M, K, 3))
            group.create_array("joints", data=np.array(JOINTS, "S5"))
        group.attrs.update({"unit": "mm", "axes": "NMKD"})
        for name in ("zarr.json", "hypotheses/zarr.json", "joints/zarr.json", "hypotheses/c/0/0/0/0"):
            changes = JSON if name.endswith("json") else BYTES
            yield Case("posecal", ("evaluate", "hyps.zarr", *few), f"hyps.zarr/{name}", changes, _never)
    if find_spec("pymatreader"):
        from scipy.io import savemat

        for name, packed in (("a.mat", False), ("b.mat", True)):
            savemat(folder / name, {"data": {"poses": truth(), "more": ["a", 1]}}, do_compression=packed)
            whole = (folder / name).read_bytes()
            (folder / name).write_bytes(b"MATLAB 5.0 MAT-file".ljust(116) + whole[116:])  # of no date
            words = ("convert", name, "--dataset", "data/poses", "-o", "out.npz")
            yield Case("posecal", words, name, BYTES, _never)
    if find_spec("ezc3d"):
        import ezc3d

        content = ezc3d.c3d()
        content["parameters"]["POINT"]["RATE"]["value"] = [50]
        content["parameters"]["POINT"]["LABELS"]["value"] = tuple(JOINTS)
        content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
        content["data"]["points"] = np.concatenate([truth().transpose(2, 1, 0), np.ones((1, K, M))])
        content.write(str(folder / "a.c3d"))
        yield _convert("a.c3d", BYTES)
    if find_spec("torch"):
        import torch

        for name, content in (("a.pt", {"poses": torch.from_numpy(truth())}), ("b.pt", torch.from_numpy(truth()))):
            file = io.BytesIO()
            torch.save(content, file)
            (folder / name).write_bytes(file.getvalue())
            yield _convert(name, TORCH, _raw)
        yield from _estimators(folder)


def _deeplabcut(path: Path) -> None:
    """Write a table as DeepLabCut and Anipose do, in the format of pandas."""
    import h5py

    coords = ("x", "y", "likelihood")
    columns = [("net", joint, axis) for joint in JOINTS for axis in coords]
    kind = [("index", "<i8"), ("values_block_0", "<f8", (len(columns),))]
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = "frame_table"
        group.attrs["non_index_axes"] = np.bytes_(pickle.dumps([(1, columns)], protocol=0))
        table = np.zeros(M, kind)
        table["values_block_0"] = np.dstack([truth()[..., :2], np.full((M, K, 1), 0.9)]).reshape(M, -1)
        group.create_dataset("table", data=table)


def _estimators(folder: Path) -> Iterator[Case]:
    import torch
    from torch import nn

    from posecal_models.checkpoint import save_estimator
    from posecal_models.config import Config
    from posecal_models.data.mocap import MocapPoses
    from posecal_models.data.synthetic import synthetic_motion
    from posecal_models.estimators.cgnf.flow import FlowSize
    from posecal_models.estimators.cgnf.graph import PoseGraph
    from posecal_models.estimators.cgnf.model import CGNF
    from posecal_models.estimators.gaussian_noise import GaussianNoise
    from posecal_models.estimators.simple_baseline import SimpleBaseline
    from posecal_models.preparation import prepare
    from tests.models.test_data_formats import prohpe, videopose3d

    def models(words: str, file: str, changes: Any, exact: Any = _never) -> Case:
        return Case("posecal-models", tuple(words.split()), file, changes, exact)

    torch.manual_seed(0)
    graph = PoseGraph(("RKnee", "Head"), (-1, 0))
    flow = CGNF(FlowSize(1, 2, 2, 2), graph)
    baseline = SimpleBaseline(("RKnee", "Head"), ("RKnee", "Head"), width=2, residuals=0)
    notes = {"config": Config().table(), "epochs": 2}
    save_estimator(folder / "flow.safetensors", flow.eval(), notes=notes)
    save_estimator(folder / "noise.safetensors", GaussianNoise(baseline).eval(), notes=notes)
    motion = synthetic_motion(subjects=2, clips=1, frames=2, seed=0)
    np.savez(folder / "motion.npz", **motion)
    pairs = {"truth": truth(), "unit": "mm", "joints": JOINTS, "subject": ["S1", "S1", "S2", "S2"]}
    np.savez(
        folder / "pairs.npz", keypoints_2d=truth()[..., :2] + 500, keypoints_observed=np.ones((M, K), bool), **pairs
    )
    np.savez(folder / "cameras.npz", subject=["S1", "S1"], rotation=[np.eye(3)] * 2, position=[[0, 0, 0.5]] * 2)
    prohpe(folder, frames=1, flagged=(0, "RWrist"))
    videopose3d(folder)
    config = "[model]\nkind = 'simple-baseline'\nwidth = 2\nresiduals = 0\n[data]\ntest_subjects = ['S2']\n"
    config += "[train]\nobjective = 'squared-error'\nepochs = 1\nbatch = 2\nseed = 3\nlearning_rate = 0.01\n"
    (folder / "train.toml").write_text(config)
    MocapPoses(folder / "motion.npz").project(views=1).save(folder / "train.npz")
    prepare(Config.load(str(folder / "train.toml")), folder / "train.npz", folder / "run").run()
    state = dict(nn.Linear(2, 2).state_dict().items())
    torch.save(state, folder / "released.pt")

    for name in ("flow", "noise"):
        file = f"{name}.safetensors"
        yield models(f"describe {file}", file, WEIGHTS)
        yield models(f"sample {file} pairs.npz -o out.npz --n 2", file, WEIGHTS)
        yield Case("python", ("posecal_models.benchmark_report", "leaked_subjects", file), file, WEIGHTS, _never)
    yield models("sample flow.safetensors pairs.npz -o out.npz --n 2", "pairs.npz", NPZ, _raw)
    yield models("project motion.npz -o out.npz --views 1", "motion.npz", NPZ, _raw)
    yield models("import prohpe merged.pickle -o out.npz", "merged.pickle", PICKLE)
    three = "import videopose3d 3d.npz --keypoints 2d.npz --cameras cameras.npz -o out.npz"
    yield models(three, "3d.npz", OBJECT_NPZ, _raw)
    yield models(three, "2d.npz", OBJECT_NPZ, _raw)
    yield models(three, "cameras.npz", NPZ, _raw)
    yield models("train train.toml --data train.npz -o run --resume", "run/checkpoint.safetensors", WEIGHTS)
    yield models("train train.toml --data train.npz -o out", "train.npz", NPZ)
    yield models("train train.toml --data none.npz -o out", "train.toml", TOML)
    yield models("convert released.pt -o out.safetensors", "released.pt", TORCH)
    losses = (*BYTES, *[texts.table_edited(",")] * 8)
    yield models("losses tiny=run -o out.png", "run/losses.csv", losses)
    if find_spec("cdflib"):
        from tests.models.test_data_formats import cdf, numbers

        for kind, columns in (("D3_Positions_mono", 3), ("D2_Positions", 2)):
            cdf(folder / "S1" / kind / "Walking 1.54138969.cdf", numbers(2, 32, columns))
            yield models("import human36m . -o out.npz", f"S1/{kind}/Walking 1.54138969.cdf", BYTES)
