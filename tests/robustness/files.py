"""Small files of every kind, and the commands that read them."""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import posecal
from posecal.engine.storage import digest_of
from tests.helpers.tables import long, trc, wide
from tests.robustness import arrays, bytes_and_zips, pickled, texts

Change = Callable[[bytes, Random], bytes]

N, M, K = 3, 4, 4
JOINTS = ["Hip", "RKnee", "LKnee", "Head"]


@dataclass(frozen=True)
class Case:
    """A file that is changed and a command, or a function, that reads it.

    Attributes
    ----------
    command : str
        ``posecal``, ``posecal-models`` or ``python``.
    words : tuple of str
        Its arguments; for ``python`` the module and the name of a function of a path.
    file : str
        The file that is changed.
    changes : tuple of callable
        What may be done to it.
    exact : callable or None
        Of a change: whether whoever accepts the file must print what it printed of the file as it was.
    """

    command: str
    words: tuple[str, ...]
    file: str
    changes: tuple[Change, ...]
    exact: Callable[[Change], bool]

    @property
    def name(self) -> str:
        """The command in one line."""
        return f"{self.command} {' '.join(self.words)} ({self.file})"


# --- what is done to files of each kind -----------------------------------------------------------------------


def result_edited(whole: bytes, chance: Random) -> bytes:
    """Edit what a saved result says, or values that it holds, and give it the shapes and the digest of these."""
    with np.load(io.BytesIO(whole)) as stored:
        members: dict[str, Any] = {key: stored[key] for key in stored.files if key != "digest"}
    about = json.loads(str(members.pop("about")))
    for _ in range(chance.choice([1, 1, 2])):
        key = chance.choice([*members, "about", "about"])
        if key == "about":
            about = texts.edited(about, chance)
        elif key.startswith("sum/") and chance.random() < 0.5:
            name = key.removeprefix("sum/")
            members[key], members[f"count/{name}"] = _of_other_shape(members[key], members[f"count/{name}"], chance)
        else:
            members[key] = arrays.edited(members[key], chance)
    members = {key: value for key, value in members.items() if value.dtype.kind != "O"}
    if isinstance(about, dict) and "shapes" in about:
        about["shapes"] = {key: [*value.shape] for key, value in members.items()}
    members["about"] = np.array(json.dumps(about).replace("\ud800", "?"))
    members["digest"] = np.array(digest_of(members))
    file = io.BytesIO()
    np.savez(file, **members)
    return file.getvalue()


def _of_other_shape(sums: arrays.Array, counts: arrays.Array, chance: Random) -> tuple[arrays.Array, arrays.Array]:
    """Give sums (C, ...) of poses another shape, and counts that go with it."""
    rows = sums.reshape(len(sums), -1)
    number = counts.reshape(len(counts), -1)[:, 0]
    shapes = (rows, rows[:, 0], rows[:, :1], rows[:, :0], sums[..., None], np.repeat(rows, 2, axis=1))
    return chance.choice(shapes), number


def result_edited_unsigned(whole: bytes, chance: Random) -> bytes:
    """Edit what a saved result says of itself, and leave its digest."""
    with np.load(io.BytesIO(whole)) as stored:
        members: dict[str, Any] = dict(stored)
    text = texts.of_json(json.loads(str(members["about"])), chance).replace("\ud800", "?")
    file = io.BytesIO()
    np.savez(file, **{**members, "about": np.array(text)})
    return file.getvalue()


_RAW = frozenset(bytes_and_zips.RAW_ZIP)


def _raw(change: Change) -> bool:
    return change in _RAW


def _always(_change: Change) -> bool:
    return True


def _never(_change: Change) -> bool:
    return False


_MEMBERS = tuple(bytes_and_zips.repacked(change) for change in arrays.NPY)
NPZ = (*bytes_and_zips.RAW_ZIP, *_MEMBERS, *_MEMBERS, bytes_and_zips.with_other_members, bytes_and_zips.bomb)
NPY = (*bytes_and_zips.BYTES, *arrays.NPY)
RESULT = (*bytes_and_zips.RAW_ZIP, *[result_edited] * 6, *[result_edited_unsigned] * 3, *_MEMBERS)
RESULT += (bytes_and_zips.with_other_members, bytes_and_zips.bomb)
JSON = (*bytes_and_zips.BYTES, *[texts.json_edited] * 8)
TOML = (*bytes_and_zips.BYTES, *[texts.toml_edited] * 8)
PICKLE = (*bytes_and_zips.BYTES, *[pickled.operations] * 4, *[pickled.objects] * 6)
TORCH = (*bytes_and_zips.RAW_ZIP, *[bytes_and_zips.repacked(pickled.operations, "data.pkl")] * 4)
OBJECT_NPZ = (
    *bytes_and_zips.RAW_ZIP,
    bytes_and_zips.repacked(arrays.with_odd_header),
    bytes_and_zips.with_other_members,
)
OBJECT_NPZ += (bytes_and_zips.repacked(arrays.with_other_array),)
WEIGHTS = (*bytes_and_zips.BYTES, *[pickled.safetensors] * 10)
HDF5 = (*bytes_and_zips.BYTES, *[pickled.hdf5] * 4)


# --- files ----------------------------------------------------------------------------------------------------


def truth() -> arrays.Array:
    """A person's poses (4, 4, 3) in whole mm, hip at the origin."""
    rest = np.array([[0, 0, 0], [-130, 0, -450], [130, 0, -450], [0, 0, 650]])
    poses = rest + np.random.default_rng(0).integers(-60, 60, (M, K, 3))
    poses[:, 0] = 0
    return poses.astype(np.float64)


def hypotheses() -> arrays.Array:
    """Hypotheses (3, 4, 4, 3) about them."""
    found = truth() + np.random.default_rng(1).integers(-80, 80, (N, M, K, 3))
    found[:, :, 0] = 0
    return found.astype(np.float32)


_FRAMES = np.array(["p/0", "p/1", "q/0", "q/1"])


def write_core(folder: Path) -> None:
    """Write the files that ``posecal`` reads."""
    about: dict[str, Any] = {"unit": "mm", "joints": np.array(JOINTS), "frame_id": _FRAMES}
    about |= {"parents": np.array([-1, 0, 0, 0])}
    scores = np.arange(N * M, dtype=float).reshape(N, M)
    hyps = {"hypotheses": hypotheses(), "axes": "NMKD", "scores": scores, **about}
    gt = {"truth": truth(), "axes": "MKD", "fps": 50.0, "sequence": np.array(["p", "p", "q", "q"]), **about}
    gt |= {
        "action": np.array(["a", "b", "a", "b"]),
        "occluded": np.eye(M, K, dtype=bool),
        "valid": np.ones((M, K), bool),
    }
    np.savez(folder / "hyps.npz", **hyps)
    sigma = np.full((2, M, K), 60.0)
    sigma[:, :, 0] = 0
    stated = {"mean": hypotheses()[:2], "sigma": sigma, "mixture_weights": np.full((2, M), 0.5)}
    np.savez(folder / "stated.npz", **stated, **about)
    np.savez(folder / "dense.npz", **hyps, log_prob=np.arange(M) - 60.0, dimensions=9)
    np.savez(folder / "gt.npz", **gt)
    np.savez_compressed(folder / "hypsc.npz", **hyps)
    np.savez_compressed(folder / "gtc.npz", **gt)
    np.save(folder / "hyps.npy", hypotheses())
    np.save(folder / "gt.npy", truth())
    for name, metrics in (("small", "mpjpe"), ("full", "all")):
        how: dict[str, Any] = {"by": ("action", "occlusion"), "threads": 1}
        posecal.evaluate(folder / "hyps.npz", folder / "gt.npz", metrics=metrics, **how).save(folder / f"{name}.npz")
    dense = posecal.evaluate(folder / "dense.npz", folder / "gt.npz", metrics="nll, log_likelihood_skill", threads=1)
    dense.save(folder / "dense-result.npz")
    for name, radius in (("spread", None), ("radius", 0.4)):
        fit = posecal.recalibration.fit_spread if radius is None else posecal.recalibration.fit_radius
        map_ = fit(
            posecal.PoseData(folder / "hyps.npz", folder / "gt.npz"), **({} if radius is None else {"alpha": radius})
        )
        posecal.recalibration.write_map(map_, folder / f"{name}.json", anyway=True)
    skeleton = {"names": JOINTS, "parents": [-1, 0, 0, 0], "root": "Hip"}
    (folder / "skeleton.json").write_text(json.dumps(skeleton))
    (folder / "skeleton.toml").write_text(f'names = {JOINTS}\nparents = ["", "Hip", "Hip", 0]\nroot = "Hip"\n')


def write_foreign(folder: Path) -> None:
    """Write the files that ``posecal convert`` reads, but for those that need a library."""
    poses = truth()
    wide(poses, folder / "wide.csv")
    long(poses, folder / "long.csv", hypothesis=0)
    trc(poses, folder / "a.trc")
    head = [",".join(["scorer", *["net"] * 3 * K]), ",".join(["bodyparts", *(j for j in JOINTS for _ in "xyl")])]
    head.append(",".join(["coords", *["x", "y", "likelihood"] * K]))
    rows = [",".join([str(m), *(f"{x},{y},0.9" for x, y, _ in poses[m])]) for m in range(M)]
    (folder / "dlc.csv").write_text("\n".join([*head, *rows]) + "\n")
    people = [{"pose_keypoints_2d": np.dstack([poses[:1, :, :2], np.ones((1, K, 1))]).ravel().tolist()}]
    documents: dict[str, Any] = {"openpose": {"version": 1.3, "people": people}, "lists": poses.tolist()}
    joints19 = np.tile(np.arange(4.0), 19).tolist()
    documents["panoptic"] = {"frame": 7, "bodies": [{"id": 0, "joints19": joints19}]}
    frame = {"world_coord": poses[0].tolist(), "joint_valid": [[1]] * K}
    documents["interhand"] = {"0": {"0": frame, "1": frame}}
    frames = [
        {"frame_id": m, "instances": [{"keypoints": p.tolist(), "keypoint_scores": [0.5] * K}]}
        for m, p in enumerate(poses)
    ]
    names = {str(k): name for k, name in enumerate(JOINTS)}
    documents["mmpose"] = {"meta_info": {"keypoint_id2name": names}, "instance_info": frames}
    for name, document in documents.items():
        (folder / f"{name}.json").write_text(json.dumps(document))
    np.savez(
        folder / "mmpose.npz", S=np.dstack([poses, np.ones((M, K, 1))]), imgname=["a", "b", "c", "d"], part=np.ones(4)
    )
    (folder / "a.pkl").write_bytes(
        pickle.dumps({"poses": poses, "names": JOINTS, "more": [1, {"a": (2, None)}]}, protocol=4)
    )
    (folder / "b.pkl").write_bytes(pickle.dumps(poses, protocol=5))


def _core() -> list[Case]:
    def posecal_(words: str, file: str, changes: tuple[Change, ...], exact: Callable[[Change], bool] = _never) -> Case:
        return Case("posecal", tuple(words.split()), file, changes, exact)

    few = "--metrics mpjpe --format json"
    cases = [
        posecal_(f"evaluate hyps.npz gt.npz {few} --save out.npz", "hyps.npz", NPZ, _raw),
        posecal_(f"evaluate hyps.npz gt.npz {few} --save out.npz", "gt.npz", NPZ, _raw),
        posecal_("evaluate hypsc.npz gtc.npz --metrics mpjpe --by action", "hypsc.npz", NPZ, _raw),
        posecal_("evaluate hypsc.npz gtc.npz --metrics mpjpe,pck,ece --format csv", "gtc.npz", NPZ, _raw),
        posecal_(f"evaluate hyps.npy gt.npy {few} --axes NMKD --unit mm --root-joint none", "hyps.npy", NPY),
        posecal_("evaluate hyps.npy gt.npy --metrics mpjpe --axes NMKD --unit mm --root-joint none", "gt.npy", NPY),
        posecal_("evaluate hyps.npz gt.npz --skill hypsc.npz --metrics crps --format csv", "hypsc.npz", NPZ, _raw),
        posecal_("evaluate stated.npz gt.npz --draws 3 --metrics nll,mpjpe --format csv", "stated.npz", NPZ, _raw),
        posecal_("evaluate dense.npz gt.npz --metrics nll,mpjpe --format csv", "dense.npz", NPZ, _raw),
        posecal_(f"evaluate hyps.npz gt.npz {few} --skeleton skeleton.json", "skeleton.json", JSON),
        posecal_(f"evaluate hyps.npz gt.npz {few} --skeleton skeleton.toml", "skeleton.toml", TOML),
        posecal_("report small.npz", "small.npz", RESULT, lambda change: change is not result_edited),
        posecal_(
            "report full.npz --by action --format json", "full.npz", RESULT, lambda change: change is not result_edited
        ),
        posecal_("report full.npz --by occlusion --html out.html", "full.npz", RESULT),
        posecal_("report dense-result.npz", "dense-result.npz", RESULT),
        posecal_(
            "compare small.npz full.npz --format csv", "small.npz", RESULT, lambda change: change is not result_edited
        ),
        posecal_("compare hyps.npz hypsc.npz gt.npz --metrics mpjpe --format csv", "hypsc.npz", NPZ, _raw),
        posecal_("merge small.npz -o out.npz", "small.npz", RESULT, lambda change: change is not result_edited),
        posecal_("plot poses hyps.npz gt.npz -o out.svg", "gt.npz", NPZ),
        posecal_("recalibrate fit hyps.npz gt.npz --anyway -o out.json", "hyps.npz", NPZ, _raw),
        posecal_("recalibrate fit hyps.npz gt.npz --radius 0.4 -o out.json", "gt.npz", NPZ, _raw),
        posecal_("recalibrate apply hyps.npz spread.json -o out.npz", "hyps.npz", NPZ, _raw),
        posecal_("recalibrate apply hyps.npz spread.json -o out.npz", "spread.json", JSON, _always),
        posecal_("recalibrate apply hyps.npz radius.json -o out.npz", "radius.json", JSON, _always),
    ]
    for kind in ("reliability", "joints", "errors", "pck", "rank-tests", "sparsification", "risk-coverage", "event"):
        cases.append(posecal_(f"plot {kind} full.npz -o out.svg", "full.npz", RESULT))
    table = (*bytes_and_zips.BYTES, *[texts.table_edited(",")] * 8)
    tabs = (*bytes_and_zips.BYTES, *[texts.table_edited("\t")] * 8)
    files = {"wide.csv": table, "long.csv": table, "dlc.csv": table, "a.trc": tabs, "a.pkl": PICKLE, "b.pkl": PICKLE}
    files |= {f"{name}.json": JSON for name in ("openpose", "panoptic", "interhand", "mmpose", "lists")}
    files |= {"gt.npy": NPY}
    cases += [posecal_(f"convert {name} -o out.npz", name, changes) for name, changes in files.items()]
    cases.append(posecal_("convert mmpose.npz -o out.npz", "mmpose.npz", NPZ, _raw))
    return cases
