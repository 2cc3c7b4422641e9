"""Data of the situations: each function writes both files, and gives the right values by plain NumPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.situations.people import HIPS, JOINTS, about, aligned_errors, best_and_mean, errors, people, relative

Values = dict[str, float]


def _save(folder: Path, hypotheses: Any, truth: Any, both: dict[str, Any] | None = None, **of_truth: Any) -> None:
    """Write both files; members of the truth's alone by name, those of the hypotheses' alone as ``hyps_name``."""
    alone = {name.removeprefix("hyps_"): of_truth.pop(name) for name in [*of_truth] if name.startswith("hyps_")}
    np.savez(folder / "hyps.npz", hypotheses=np.asarray(hypotheses, dtype=np.float32), **(both or {}), **alone)
    np.savez(folder / "gt.npz", truth=truth, **(both or {}), **of_truth)


NAMED = {"unit": "mm", "joints": np.array(JOINTS)}


def trials(folder: Path) -> Values:
    """Actions whose labels name trials and chunks."""
    random = np.random.default_rng(1)
    labels = np.repeat(["Walking", "Walking 1", "Jog 1 chunk0", "Jog 1 chunk1", "Box"], [40, 16, 20, 8, 30])
    truth = people(random, len(labels))
    spread = np.repeat([30.0, 60, 40, 90, 50], [40, 16, 20, 8, 30])[:, None, None]
    hypotheses = truth + spread * random.standard_normal((6, *truth.shape))
    _save(folder, hypotheses, truth, NAMED, action=labels)
    first = np.array([label.split()[0] for label in labels])
    of_poses = errors(hypotheses, truth).mean(axis=-1)
    groups = [of_poses[:, first == action] for action in np.unique(first)]
    return {
        "min_mpjpe": float(np.mean([group.min(axis=0).mean() for group in groups])),
        "mpjpe": float(np.mean([group.mean() for group in groups])),
    }


def negated_axes(folder: Path) -> Values:
    """Hypotheses of a camera whose y and z point the other way."""
    random = np.random.default_rng(2)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    _save(folder, hypotheses * [1, -1, -1], truth, NAMED)
    return {"pa_min_mpjpe": float(aligned_errors(hypotheses, truth).mean(axis=-1).min(axis=0).mean())}


def exchanged_sides(folder: Path) -> Values:
    """Hypotheses whose left and right joints are exchanged."""
    random = np.random.default_rng(3)
    truth = people(random, 40)
    other = [
        JOINTS.index({"L": "R", "R": "L"}[name[0]] + name[1:]) if name[0] in "LR" else k
        for k, name in enumerate(JOINTS)
    ]
    hypotheses = about(random, truth, 10)[:, :, other]
    _save(folder, hypotheses, truth, NAMED)
    return best_and_mean(errors(hypotheses, truth))


def confidence_column(folder: Path) -> Values:
    """Coordinates with a confidence as the fourth column."""
    random = np.random.default_rng(4)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    with_confidence = [
        np.concatenate([poses / 1000, random.uniform(0.2, 1, (*poses.shape[:-1], 1))], axis=-1)
        for poses in (hypotheses, truth)
    ]
    _save(folder, *with_confidence, {**NAMED, "unit": "m"})
    return {}


def padded_hypotheses(folder: Path) -> Values:
    """Between 1 and 10 hypotheses a frame, padded with zeros of weight 0."""
    return _different_n(folder, 0.0)


def padded_with_nan(folder: Path) -> Values:
    """Between 1 and 10 hypotheses a frame, padded with NaN."""
    return _different_n(folder, np.nan)


def _different_n(folder: Path, fill: float) -> Values:
    random = np.random.default_rng(5)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    number = random.integers(1, 11, 40)
    live = np.arange(10)[:, None] < number
    weights = {"hyps_scores": np.where(live, 1 / number, 0.0)} if fill == 0 else {}
    _save(folder, np.where(live[..., None, None], hypotheses, fill), truth, NAMED, **weights)
    of_poses = np.where(live, errors(hypotheses, truth).mean(axis=-1), np.nan)
    return {
        "min_mpjpe": float(np.nanmin(of_poses, axis=0).mean()),
        "mpjpe": float(np.nanmean(of_poses, axis=0).mean()),
    }


def empty_predictions(folder: Path) -> Values:
    """People whom the detector missed, predicted as zeros."""
    random = np.random.default_rng(6)
    truth = people(random, 100)
    hypotheses = about(random, truth, 10)
    hypotheses[:, 3::9] = 0
    _save(folder, hypotheses, truth, NAMED)
    return best_and_mean(errors(hypotheses, truth))


def repeated_joints(folder: Path) -> Values:
    """A skeleton in which some joints repeat others."""
    random = np.random.default_rng(7)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    columns = [*range(17), 0, 13, 8]
    hypotheses, truth = relative(hypotheses)[:, :, columns], relative(truth)[:, columns]
    _save(folder, hypotheses, truth, unit="mm", hyps_unit="mm")
    return best_and_mean(errors(hypotheses, truth, None))


def hand(folder: Path) -> Values:
    """Hands of 21 joints in metres, and the AUC of PCK from 0 to 50 mm."""
    random = np.random.default_rng(8)
    fingers = [
        [20.0 * f - 40 + 2 * step * (f - 2), 30 + 50 * (f > 0) + 28 * step, 0] for f in range(5) for step in range(4)
    ]
    truth = people(random, 60, np.array([[0.0, 0, 0], *fingers]), jitter=8) + np.array([0, 0, 600])
    hypotheses = about(random, truth, 20, spread=9, bias=6)
    _save(folder, hypotheses / 1000, truth / 1000)
    distances = errors(hypotheses, truth)
    at = np.linspace(0, 50, 100)
    curve = np.array([(distances < t).mean(axis=-1).max(axis=0).mean() for t in at])
    return {**best_and_mean(distances), "auc": float(np.trapezoid(curve, at) / 50)}


def midpoint_root(folder: Path) -> Values:
    """14 joints without a pelvis, in the camera's frame, relative to the midpoint of the hips."""
    random = np.random.default_rng(9)
    kept = [k for k, name in enumerate(JOINTS) if name not in {"Hip", "Spine", "Neck/Nose"}]
    truth = people(random, 40)[:, kept] + random.normal(0, 800, (40, 1, 3)) + [0, 0, 4000]
    hypotheses = about(random, truth, 10) + random.normal(0, 120, (10, 40, 1, 3))
    names = [JOINTS[k] for k in kept]
    _save(folder, hypotheses / 1000, truth / 1000, {"unit": "m", "joints": np.array(names)})
    return best_and_mean(errors(hypotheses, truth, [names.index(JOINTS[k]) for k in HIPS]))


def lost_markers(folder: Path) -> Values:
    """NaN where a marker was lost, the root's in 8 frames."""
    random = np.random.default_rng(10)
    truth = people(random, 80)
    hypotheses = about(random, truth, 12)
    lost = np.zeros((80, 17), dtype=bool)
    lost[20:34, 3] = lost[50:62, 12] = lost[66:74, 0] = True
    truth_lost = np.where(lost[..., None], np.nan, truth)
    _save(folder, hypotheses, truth_lost, NAMED, valid=~lost)
    distances = np.where(lost, np.nan, errors(hypotheses, truth))[:, ~lost[:, 0]]
    of_poses = np.nanmean(distances, axis=-1)
    return {"min_mpjpe": float(of_poses.min(axis=0).mean()), "mpjpe": float(of_poses.mean())}


def one_prediction(folder: Path) -> Values:
    """One prediction of each frame, (M, K, 3)."""
    random = np.random.default_rng(11)
    truth = people(random, 40)
    hypotheses = about(random, truth, 1)
    _save(folder, hypotheses[0], truth, NAMED)
    return {"mpjpe": float(errors(hypotheses, truth).mean())}


def root_alone(folder: Path) -> Values:
    """The error of the root's own position in the camera's frame."""
    random = np.random.default_rng(12)
    truth = people(random, 40) + np.array([0, 0, 4000])
    hypotheses = about(random, truth, 5) + random.normal(0, 80, (5, 40, 1, 3))
    _save(folder, hypotheses, truth, NAMED)
    return best_and_mean(errors(hypotheses, truth, None)[..., :1])


SMPL = [
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand"),
]


def smpl_names(folder: Path) -> Values:
    """SMPL's 24 names, which hold an ankle and a foot."""
    random = np.random.default_rng(13)
    truth = people(random, 40, np.array([[0.0, 0, 0], *random.normal(0, 300, (23, 3))]))
    hypotheses = about(random, truth, 10)
    _save(folder, hypotheses, truth, {"unit": "mm", "joints": np.array(SMPL)})
    return best_and_mean(errors(hypotheses, truth))


def pixels(folder: Path) -> Values:
    """Keypoints in pixels."""
    random = np.random.default_rng(14)
    truth = people(random, 40)[..., [0, 2]] * 0.3 + [320, 240]
    hypotheses = about(random, truth, 8, spread=8, bias=4)
    _save(folder, hypotheses, truth, {"joints": np.array(JOINTS), "unit": "px"})
    return best_and_mean(errors(hypotheses, truth, None))


def horizons(folder: Path) -> Values:
    """Clips of motion, of which the best hypothesis is chosen over the clip and read at a horizon."""
    random = np.random.default_rng(15)
    C, T, N = 12, 10, 6
    truth = people(random, C * T, jitter=20).reshape(C, T, 17, 3)
    hypotheses = truth + 60 * random.standard_normal((N, C, T, 17, 3)) * random.uniform(0.3, 1.7, (N, C, T, 1, 1))
    step = np.where(np.arange(T) == T - 1, "last", "earlier")
    _save(folder, hypotheses, truth, {**NAMED}, hyps_axes="NMTKD", axes="MTKD", step=np.tile(step, C))
    of_frames = errors(hypotheses.astype(np.float32), truth).mean(axis=-1)
    best = of_frames.mean(axis=2).argmin(axis=0)
    return {
        "min_mpjpe": float(of_frames.mean(axis=2).min(axis=0).mean()),
        "step=last min_mpjpe": float(of_frames[best, np.arange(C), -1].mean()),
    }


def open_layout(folder: Path) -> Values:
    """As many hypotheses as poses, in a layout that nobody declares."""
    random = np.random.default_rng(16)
    truth = people(random, 20)
    _save(folder, about(random, truth, 20).swapaxes(0, 1), truth, NAMED)
    return {}


def undeclared_metres(folder: Path) -> Values:
    """Poses in metres that declare no unit."""
    random = np.random.default_rng(17)
    truth = people(random, 40)
    _save(folder, about(random, truth, 10) / 1000, truth / 1000, {"joints": np.array(JOINTS)})
    return {}


def fill_values(folder: Path) -> Values:
    """Joints that a detector did not find, as -1000, in truth and hypotheses."""
    random = np.random.default_rng(18)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    truth[[7, 8, 30], 13] = hypotheses[:, 2:6, 9] = -1000
    _save(folder, hypotheses, truth, NAMED)
    return best_and_mean(errors(hypotheses, truth))


def overflow(folder: Path) -> Values:
    """One hypothesis that overflowed."""
    random = np.random.default_rng(19)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    hypotheses[4, 11, 6] = 1e20
    _save(folder, hypotheses, truth, NAMED)
    return {}


def lost_truth(folder: Path) -> Values:
    """Frames whose true pose was lost, as zeros."""
    random = np.random.default_rng(20)
    truth = people(random, 40)
    hypotheses = about(random, truth, 10)
    truth[[5, 17]] = 0
    _save(folder, hypotheses, truth, NAMED)
    return {}


def several_faults(folder: Path) -> Values:
    """Layout, names, labels and frame rate wrong at once."""
    random = np.random.default_rng(21)
    truth = people(random, 20)
    _save(folder, about(random, truth, 20), truth, {"joints": np.array(JOINTS[:9])}, sequence=["walk"] * 3, fps=-25.0)
    return {}


def repeated_frames(folder: Path) -> Values:
    """Frames that a sampler for several processes repeated to fill its last batch."""
    random = np.random.default_rng(22)
    truth = people(random, 37)[[*range(37), 0, 1, 2]]
    hypotheses = about(random, truth, 10)
    _save(folder, hypotheses, truth, NAMED)
    return best_and_mean(errors(hypotheses, truth))
