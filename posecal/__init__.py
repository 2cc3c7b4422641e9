"""posecal: can the uncertainty of a multi-hypothesis 3D human pose model be trusted?

::

    import posecal

    report = posecal.evaluate(hypotheses, truth)  # (N, M, K, 3) and (M, K, 3), mm
    print(report)
    posecal.metrics.min_mpjpe(hypotheses, truth)  # one value per pose

Importing posecal imports nothing else; each name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posecal import calibration, metrics, plot
    from posecal.calibration import CalibrationCurve, calibration_curve, ece, perfect_sampler, signed_area
    from posecal.comparison import Comparison, compare
    from posecal.conclusion import verdict
    from posecal.errors import PosecalError, PoseDataError, PoseFileError
    from posecal.evaluation import evaluate
    from posecal.io import read_poses
    from posecal.joining import Join, join
    from posecal.protocol import PRESETS, Protocol
    from posecal.recalibration import cross_fitted, fit_radius, fit_spread
    from posecal.reference import climatology, held_against
    from posecal.report import Report
    from posecal.results import load_totals, save_totals
    from posecal.shards import merge_totals
    from posecal.skeleton import JOINT_SETS, Skeleton
    from posecal.summation import add_up
    from posecal.totals import Totals

__version__ = "0.1.0"

_HOMES = {
    "posecal.calibration": ("CalibrationCurve", "calibration_curve", "ece", "perfect_sampler", "signed_area"),
    "posecal.comparison": ("Comparison", "compare"),
    "posecal.conclusion": ("verdict",),
    "posecal.errors": ("PoseDataError", "PoseFileError", "PosecalError"),
    "posecal.evaluation": ("evaluate",),
    "posecal.io": ("read_poses",),
    "posecal.joining": ("Join", "join"),
    "posecal.protocol": ("PRESETS", "Protocol"),
    "posecal.recalibration": ("cross_fitted", "fit_radius", "fit_spread"),
    "posecal.reference": ("climatology", "held_against"),
    "posecal.report": ("Report",),
    "posecal.results": ("load_totals", "save_totals"),
    "posecal.shards": ("merge_totals",),
    "posecal.skeleton": ("JOINT_SETS", "Skeleton"),
    "posecal.summation": ("add_up",),
    "posecal.totals": ("Totals",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
_ROOMS = ("calibration", "metrics", "plot")

__all__ = [
    "JOINT_SETS",
    "PRESETS",
    "CalibrationCurve",
    "Comparison",
    "Join",
    "PoseDataError",
    "PoseFileError",
    "PosecalError",
    "Protocol",
    "Report",
    "Skeleton",
    "Totals",
    "add_up",
    "calibration",
    "calibration_curve",
    "climatology",
    "compare",
    "cross_fitted",
    "ece",
    "evaluate",
    "fit_radius",
    "fit_spread",
    "held_against",
    "join",
    "load_totals",
    "merge_totals",
    "metrics",
    "perfect_sampler",
    "plot",
    "read_poses",
    "save_totals",
    "signed_area",
    "verdict",
]


def __getattr__(name: str) -> object:
    if name in _ROOMS:
        return import_module(f"posecal.{name}")
    if name in _HOME_OF:
        found = getattr(import_module(_HOME_OF[name]), name)
        globals()[name] = found
        return found
    raise AttributeError(f"module 'posecal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
