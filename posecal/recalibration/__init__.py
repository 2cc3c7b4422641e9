"""Recalibration without training: a spread factor, or conformal radii, fitted and judged on disjoint sequences."""

from posecal.recalibration.dispersion import SpreadMap, cross_fitted, fit_spread
from posecal.recalibration.maps import apply_map, read_map, write_map
from posecal.recalibration.radius import RadiusMap, fit_radius, held_out_coverage

__all__ = [
    "RadiusMap",
    "SpreadMap",
    "apply_map",
    "cross_fitted",
    "fit_radius",
    "fit_spread",
    "held_out_coverage",
    "read_map",
    "write_map",
]
