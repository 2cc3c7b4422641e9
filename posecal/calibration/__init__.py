"""Can the spread of the hypotheses be trusted? Calibration of any hypothesis array, without a model.

``ranks``: where the truth falls among its hypotheses; ``curve``: the calibration curve; ``error``: numbers from a
curve; ``floor``: what a perfect sampler would show.
"""

from posecal.calibration.curve import CalibrationCurve, calibration_curve
from posecal.calibration.error import OVER_JOINTS, OverJoints, coverage_at, ece, joint_ece, signed_area
from posecal.calibration.expected import Floor, expected_curve, perfect_sampler
from posecal.calibration.ranks import DEFINITIONS, LEVELS, Definition

__all__ = [
    "DEFINITIONS",
    "LEVELS",
    "OVER_JOINTS",
    "CalibrationCurve",
    "Definition",
    "Floor",
    "OverJoints",
    "calibration_curve",
    "coverage_at",
    "ece",
    "expected_curve",
    "joint_ece",
    "perfect_sampler",
    "signed_area",
]
