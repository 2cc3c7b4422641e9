"""What the scripts of the page read: calibration curves with the names of joints, and poses."""

from __future__ import annotations

import base64
import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from posecal.calibration import LEVELS
from posecal.data.skeleton import Skeleton
from posecal.engine.gallery import MISSING, SHARES
from posecal.errors import PoseDataError, printable
from posecal.plot.curves import default_definition
from posecal.plot.pose_figures import upright_of_most
from posecal.report.page_tables import has_curves, path_of

if TYPE_CHECKING:
    from posecal.report.report import Report

MOST_CURVES = 150
"""Of more joints the curves of those that are off most are drawn."""

SIZE = 400
"""Width and height of a reliability diagram."""


def diagrams(report: Report) -> list[dict[str, Any]]:
    """Give reliability diagrams, of all poses and of each group: the paths of joints with names and counts.

    Parameters
    ----------
    report : Report
        The numbers.

    Returns
    -------
    list of dict
        Title, ``joints`` (name, path, what is said of it), summary path, and the path of the band, of each; empty where
        the report has no curves.
    """
    try:
        definition = default_definition(report)
    except PoseDataError:
        return []
    metric = "ece" if definition == "exchangeable" else f"ece_{definition}"
    found = []
    for group in report.groups:
        if not has_curves(report, group, definition):
            continue
        curves, joints = report.calibration(definition, group), []
        areas = curves.joint_signed_area()
        rows = np.argsort(-np.nan_to_num(np.abs(areas)), kind="stable")[:MOST_CURVES]
        for k in sorted(rows.tolist()):
            name, path = report.totals.spec.joints[k], path_of(LEVELS, curves.joints[k], SIZE)
            if path and metric in report.metrics_in(group):
                said = f"{report.count(metric, group, name):,} poses, signed area {areas[k]:+.3f}".replace("-", "−")
                joints.append((name, path, said))
        band = report.test("ece", group).band if "ece" in report.metrics_in(group) else math.nan
        found.append(
            {
                "title": "all poses" if group is None else group.replace("=", " ", 1),
                "joints": joints,
                "summary": path_of(LEVELS, report.summary_curve(definition, group), SIZE),
                "band": _band(band) if definition == "exchangeable" else "",
            }
        )
    return found


def _band(reach: float) -> str:
    """Give the path around the band of a calibrated model; empty where there is none."""
    if math.isnan(reach):
        return ""
    width = reach * np.sqrt(LEVELS * (1 - LEVELS))
    low, high = np.clip(LEVELS - width, 0, 1), np.clip(LEVELS + width, 0, 1)
    return f"{path_of(LEVELS, high, SIZE)}L{path_of(LEVELS[::-1], low[::-1], SIZE)[1:]}Z"


def poses_json(report: Report) -> str:
    """Write the gallery as JSON that can stand within HTML; empty where the report has none.

    Coordinates are 16-bit integers, little-endian, of shape (F, H + 2, K, D), as base64: of each pose the truth, the
    median of the hypotheses and some of these; a person upright.
    """
    gallery, spec = report.totals.gallery, report.totals.spec
    if gallery is None or not len(gallery):
        return ""
    skeleton = Skeleton(spec.joints, spec.parents)
    missing = (gallery.poses == MISSING).any(axis=-1, keepdims=True)
    truths = np.where(missing[:, 0], np.nan, gallery.poses[:, 0].astype(np.float64))
    poses = np.where(missing, MISSING, gallery.poses @ upright_of_most(truths, skeleton)).astype(np.int16)
    frames = []
    for row in range(len(gallery)):
        numbers = [None if math.isnan(value) else round(value, 3) for value in gallery.numbers[row].tolist()]
        frames.append(
            {
                "sequence": printable(str(gallery.sequence[row])),
                "frame": printable(str(gallery.frame_id[row])),
                "step": float(gallery.step[row]),
                "numbers": numbers,
                "radii": np.round(np.nan_to_num(gallery.radii[row]), 3).tolist(),
                "nearer": np.round(np.nan_to_num(gallery.nearer[row]), 3).tolist(),
            }
        )
    by_calibration, by_error = gallery.orders
    data = {
        "joints": [printable(joint) for joint in spec.joints],
        "bones": skeleton.bones,
        "sides": skeleton.side,
        "unit": spec.unit,
        "hypotheses": spec.n_hypotheses,
        "shares": SHARES,
        "shape": poses.shape,
        "missing": MISSING,
        "poses": base64.b64encode(poses.astype("<i2").tobytes()).decode(),
        "frames": frames,
        "orders": {"calibration": by_calibration.tolist(), "error": by_error.tolist()},
    }
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
