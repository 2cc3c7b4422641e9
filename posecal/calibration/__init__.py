"""Calibration of any hypotheses, without a model: whether their spread can be trusted.

``curve``: calibration curves; ``error``: the expected calibration error; ``expected``: that of a perfect sampler;
``ranks``: the three definitions; ``intervals``: central intervals of single coordinates; ``modes``: several modes among
hypotheses; ``rank_tests``: tests of what the curve does not see.
"""

from posecal.calibration.curve import OVER_JOINTS, CalibrationCurve, calibration_curve
from posecal.calibration.error import ece
from posecal.calibration.expected import Floor, expected_curve, perfect_sampler
from posecal.calibration.intervals import interval_coverage, interval_width
from posecal.calibration.modes import Modes, joint_modes
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition
from posecal.engine.protocol import OverJoints

__all__ = [
    "DEFINITIONS",
    "LEVELS",
    "OVER_JOINTS",
    "CalibrationCurve",
    "Definition",
    "Floor",
    "Modes",
    "OverJoints",
    "calibration_curve",
    "ece",
    "expected_curve",
    "interval_coverage",
    "interval_width",
    "joint_modes",
    "perfect_sampler",
]
