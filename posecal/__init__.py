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
    from posecal.data.match import Declarations, join
    from posecal.data.read import read_poses
    from posecal.data.skeleton import JOINT_SETS, Skeleton
    from posecal.engine.accumulate import accumulate
    from posecal.engine.merge import merge_totals
    from posecal.engine.protocol import PRESETS, Protocol
    from posecal.engine.storage import load_totals, save_totals
    from posecal.engine.totals import Totals
    from posecal.errors import PosecalError, PoseDataError, PoseFileError
    from posecal.evaluation import evaluate
    from posecal.recalibration import cross_fitted, fit_radius, fit_spread
    from posecal.report.report import Report
    from posecal.report.summary import summarize
    from posecal.stats.comparison import Comparison, compare
    from posecal.stats.skill import climatology, with_reference

__version__ = "0.1.0"

_HOMES = {
    "posecal.calibration": ("CalibrationCurve", "calibration_curve", "ece", "perfect_sampler", "signed_area"),
    "posecal.stats.comparison": ("Comparison", "compare"),
    "posecal.report.summary": ("summarize",),
    "posecal.errors": ("PoseDataError", "PoseFileError", "PosecalError"),
    "posecal.evaluation": ("evaluate",),
    "posecal.data.read": ("read_poses",),
    "posecal.data.match": ("Declarations", "join"),
    "posecal.engine.protocol": ("PRESETS", "Protocol"),
    "posecal.recalibration": ("cross_fitted", "fit_radius", "fit_spread"),
    "posecal.stats.skill": ("climatology", "with_reference"),
    "posecal.report.report": ("Report",),
    "posecal.engine.storage": ("load_totals", "save_totals"),
    "posecal.engine.merge": ("merge_totals",),
    "posecal.data.skeleton": ("JOINT_SETS", "Skeleton"),
    "posecal.engine.accumulate": ("accumulate",),
    "posecal.engine.totals": ("Totals",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
_ROOMS = ("calibration", "metrics", "plot")

__all__ = [
    "JOINT_SETS",
    "PRESETS",
    "CalibrationCurve",
    "Comparison",
    "Declarations",
    "PoseDataError",
    "PoseFileError",
    "PosecalError",
    "Protocol",
    "Report",
    "Skeleton",
    "Totals",
    "accumulate",
    "calibration",
    "calibration_curve",
    "climatology",
    "compare",
    "cross_fitted",
    "ece",
    "evaluate",
    "fit_radius",
    "fit_spread",
    "join",
    "load_totals",
    "merge_totals",
    "metrics",
    "perfect_sampler",
    "plot",
    "read_poses",
    "save_totals",
    "signed_area",
    "summarize",
    "with_reference",
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
