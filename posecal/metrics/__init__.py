"""Accuracy and spread of hypotheses: one function of arrays per metric, one value per pose.

Every function takes ``hypotheses`` (N, M, K, D) and ``truth`` (M, K, D) as they stand and returns (M,) values;
average them as you like. ``position``: the MPJPE family; ``velocity``: MPJVE; ``best_of``: from N errors to one;
``pck``: PCK, AUC and CPS; ``proper``: fair proper scores; ``spread``: diversity and sharpness; ``guide``: whether a
wide spread is a sign of error.
"""

from posecal.metrics.pck import auc, cps, pck
from posecal.metrics.position import min_mpjpe, min_mpjpe_curve, mpjpe
from posecal.metrics.proper import brier_score, crps, energy_score, variogram_score
from posecal.metrics.sharpness import diversity, radius
from posecal.metrics.uncertainty import rank_correlation, sparsification, sparsification_area
from posecal.metrics.velocity import mpjve

__all__ = [
    "auc",
    "brier_score",
    "cps",
    "crps",
    "diversity",
    "energy_score",
    "min_mpjpe",
    "min_mpjpe_curve",
    "mpjpe",
    "mpjve",
    "pck",
    "radius",
    "rank_correlation",
    "sparsification",
    "sparsification_area",
    "variogram_score",
]
