"""Evaluation of multi-hypothesis 3D human pose models: accuracy, calibration, sharpness and proper scores.

::

    import posecal

    report = posecal.evaluate(hypotheses, truth, unit="mm")  # (N, M, K, 3) and (M, K, 3)
    print(report)
    report["ece"]
    posecal.metrics.min_mpjpe(hypotheses, truth)  # one value per pose

Importing posecal imports nothing else; each name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posecal import calibration, metrics, plot, recalibration
    from posecal.calibration import CalibrationCurve, calibration_curve, ece, perfect_sampler
    from posecal.conversion import convert
    from posecal.data.gaussian import GaussianPrediction
    from posecal.data.pose_data import PoseData
    from posecal.data.skeleton import JOINT_SETS, Skeleton
    from posecal.data.weights import collapse_copies
    from posecal.engine.merge import merge_totals
    from posecal.engine.metric import Metric, Statistic
    from posecal.engine.prepare import prepare
    from posecal.engine.presets import PRESETS
    from posecal.engine.protocol import Protocol
    from posecal.engine.storage import load_totals, save_totals
    from posecal.engine.totals import Totals
    from posecal.errors import PosecalError, PoseDataError, PoseFileError
    from posecal.evaluation import Evaluation, Leaderboard, add_entry, compare, evaluate, evaluate_shards, leaderboard
    from posecal.evaluation.pairs import pair_files
    from posecal.recalibration import fit_radius, fit_spread, judge_spread
    from posecal.registry import register, unregister
    from posecal.report.comparison import Comparison
    from posecal.report.explain import explain
    from posecal.report.report import Report
    from posecal.stats.skill import climatology

__version__ = "0.1.0"

_MODULES = {
    "posecal.calibration": ("CalibrationCurve", "calibration_curve", "ece", "perfect_sampler"),
    "posecal.conversion": ("convert",),
    "posecal.data.gaussian": ("GaussianPrediction",),
    "posecal.data.pose_data": ("PoseData",),
    "posecal.data.skeleton": ("JOINT_SETS", "Skeleton"),
    "posecal.data.weights": ("collapse_copies",),
    "posecal.engine.merge": ("merge_totals",),
    "posecal.engine.metric": ("Metric", "Statistic"),
    "posecal.engine.prepare": ("prepare",),
    "posecal.engine.presets": ("PRESETS",),
    "posecal.engine.protocol": ("Protocol",),
    "posecal.engine.storage": ("load_totals", "save_totals"),
    "posecal.engine.totals": ("Totals",),
    "posecal.errors": ("PoseDataError", "PoseFileError", "PosecalError"),
    "posecal.evaluation": (
        "Evaluation",
        "Leaderboard",
        "add_entry",
        "compare",
        "evaluate",
        "evaluate_shards",
        "leaderboard",
    ),
    "posecal.evaluation.pairs": ("pair_files",),
    "posecal.recalibration": ("fit_radius", "fit_spread", "judge_spread"),
    "posecal.registry": ("register", "unregister"),
    "posecal.report.explain": ("explain",),
    "posecal.report.report": ("Report",),
    "posecal.report.comparison": ("Comparison",),
    "posecal.stats.skill": ("climatology",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
_PACKAGES = ("calibration", "metrics", "plot", "recalibration")

__all__ = [
    "JOINT_SETS",
    "PRESETS",
    "CalibrationCurve",
    "Comparison",
    "Evaluation",
    "GaussianPrediction",
    "Leaderboard",
    "Metric",
    "PoseData",
    "PoseDataError",
    "PoseFileError",
    "PosecalError",
    "Protocol",
    "Report",
    "Skeleton",
    "Statistic",
    "Totals",
    "add_entry",
    "calibration",
    "calibration_curve",
    "climatology",
    "collapse_copies",
    "compare",
    "convert",
    "ece",
    "evaluate",
    "evaluate_shards",
    "explain",
    "fit_radius",
    "fit_spread",
    "judge_spread",
    "leaderboard",
    "load_totals",
    "merge_totals",
    "metrics",
    "pair_files",
    "perfect_sampler",
    "plot",
    "prepare",
    "recalibration",
    "register",
    "save_totals",
    "unregister",
]


def __getattr__(name: str) -> object:
    if name in _PACKAGES:
        return import_module(f"posecal.{name}")
    if name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'posecal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
