"""Protocols under which the laws of all numbers are tested, and the numbers that a law does not bind."""

from __future__ import annotations

from fnmatch import fnmatch

from posecal.engine.protocol import Protocol

PROTOCOLS = {
    "default": Protocol(),
    "occluded": Protocol(where="occluded", root="drop", average="action"),
    "linked": Protocol(
        where="visible",
        align="rigid",
        align_best="linked",
        scale="norm_root",
        pck_rule="<=",
        pck_best="linked",
        auc="integral",
        cps_align="none",
        cps_best="linked",
        ece_over="mean",
    ),
    "sequence": Protocol(
        best="sequence",
        align="reflection",
        scale="rms_mean",
        pck_best="mean",
        cps_best="mean",
        velocity="second",
        deviation="population",
        ece_over="worst",
        average="sequence",
    ),
    "batch": Protocol(best="batch:2", mode="2", joints="Hip, Head, LWrist, RElbow, LFoot", cps_unit="share"),
    "joint": Protocol(best="joint", ece_over="pooled", pck_joints="all", failure_threshold=85),
    "world": Protocol(segment="3"),
}

AXES = "it is of single axes: medians, deviations and ranks of coordinates"
LOWER = "the lower of the two middle values becomes the upper where an axis turns round, for even N"
SIDES = "ranks of coordinates run the other way where an axis turns round"
TIME = "steps are from one frame to the next"
ORDER = "batches are of sequences in the order in which they come"
INDEX = "it is of the hypothesis of a declared index"
FIRST = "the first hypothesis is held out"
THRESHOLD = "its thresholds are in mm"
ORIGIN = "it is of poses where they stand: scaled about the origin, or moving in the world"
MORE = "it depends on the number of hypotheses"
DRAWN = "it is seen from a point that is drawn from the bytes of the true pose"

PER_AXIS = (
    *("*median_pose*", "ece*", "signed*", "coverage*", "radius*", "diversity", "coordinate_pit", "average_rank"),
    *("interval*", "band_depth", "mahalanobis", "crps", "brier*", "spread_error_correlation", "ause"),
    *("aurc", "excess_aurc", "failure_auroc"),
)
PER_NUMBER = (
    *("ece", "ece_mean", "ece_worst", "ece_reference*", "signed*", "coverage*", "min_mpjpe_at_[25]"),
    *("interval*", "coordinate_pit", "average_rank", "band_depth", "pair_distance", "mahalanobis", "tarp"),
    *("energy_score", "joint_energy_score", "crps", "variogram_score", "brier"),
)

UNBOUND: dict[str, dict[tuple[str, str], str]] = {
    "order of frames": {
        **{(name, "*"): TIME for name in ("*mpjve", "*acceleration_error", "*jitter", "*wa_mpjpe", "*w_mpjpe")},
        ("*min_mpjpe", "batch"): ORDER,
    },
    "order of sequences": {("*min_mpjpe", "batch"): ORDER},
    "order of hypotheses": {("*mode_mpjpe", "batch"): INDEX, ("tarp", "*"): FIRST},
    "order of joints": {("tarp_box", "*"): DRAWN},
    "translation": {
        ("tarp_box", "*"): DRAWN,
        **{(name, "world"): ORIGIN for name in ("n_*", "*jitter", "*wa_mpjpe", "*w_mpjpe")},
    },
    "rotation": {**{(name, "*"): AXES for name in PER_AXIS}, ("tarp_box", "*"): DRAWN},
    "quarter turn": {("ece_reference*", "*"): LOWER, ("average_rank", "*"): SIDES, ("tarp_box", "*"): DRAWN},
    "origin": {
        **{("n_*", p): ORIGIN for p in ("default", "occluded", "linked", "batch", "joint", "world")},
        **{(name, "*"): ORIGIN for name in ("*jitter", "*wa_mpjpe", "*w_mpjpe")},
        ("tarp_box", "*"): DRAWN,
    },
    "scale": {
        **{(name, "*"): THRESHOLD for name in ("*pck", "*auc", "cps", "brier*", "failure*")},
        ("tarp_box", "*"): DRAWN,
    },
    "twice": {
        **{(name, "*"): MORE for name in PER_NUMBER},
        ("diversity", "[!s]*"): MORE,
        ("tarp_box", "*"): MORE,
    },
    "without a sequence": {("*min_mpjpe", "batch"): ORDER},
    "single precision": {("tarp_box", "*"): DRAWN},
}


def exempt(law: str, protocol: str, name: str) -> tuple[str, str] | None:
    """The entry of the list above that frees a metric of a law."""
    entries = UNBOUND.get(law, {})
    return next((e for e in entries if fnmatch(name, e[0]) and fnmatch(protocol, e[1])), None)
