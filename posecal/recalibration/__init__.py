"""Recalibration without training: a spread factor, or conformal radii, fitted and judged on disjoint sequences."""

from posecal.recalibration.dispersion import find_modes, fit_spread
from posecal.recalibration.held_out import HeldOut, judge_spread
from posecal.recalibration.maps import apply_map, read_map, write_map
from posecal.recalibration.radius import RadiusMap, fit_radius, held_out_coverage
from posecal.recalibration.spread_map import SpreadMap

__all__ = [
    "HeldOut",
    "RadiusMap",
    "SpreadMap",
    "apply_map",
    "find_modes",
    "fit_radius",
    "fit_spread",
    "held_out_coverage",
    "judge_spread",
    "read_map",
    "write_map",
]
