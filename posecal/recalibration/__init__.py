"""How is a miscalibrated model mended, without training it again? By its spread, or by a radius that holds.

``spread``: one factor, or one per joint, for how far hypotheses lie from their median. ``radius``: per joint the
distance from the median that holds a share of the truths. Both are fitted on sequences other than those they are
judged on, and kept in small files (``maps``).
"""

from posecal.recalibration.dispersion import FACTORS, RescaledHypotheses, SpreadMap, cross_fitted, fit_spread
from posecal.recalibration.folds import folds_of
from posecal.recalibration.maps import apply_map, read_map, write_map
from posecal.recalibration.radius import RadiusMap, fit_radius, held_out_coverage

__all__ = [
    "FACTORS",
    "RadiusMap",
    "RescaledHypotheses",
    "SpreadMap",
    "apply_map",
    "cross_fitted",
    "fit_radius",
    "fit_spread",
    "folds_of",
    "held_out_coverage",
    "read_map",
    "write_map",
]
