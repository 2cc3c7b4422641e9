"""Accuracy and spread of hypotheses: one function of arrays per metric, one value per pose.

Every function takes ``hypotheses`` (N, M, K, D) and ``truth`` (M, K, D) as they stand and returns (M,) values;
average them as you like. ``position``: the MPJPE family; ``best_of``: from N errors to one; ``pck``: PCK, AUC and
CPS; ``spread``: diversity and sharpness.
"""

from posecal.metrics.pck import auc, cps, pck
from posecal.metrics.position import min_mpjpe, min_mpjpe_curve, mpjpe, mpjve
from posecal.metrics.spread import diversity, radius

__all__ = ["auc", "cps", "diversity", "min_mpjpe", "min_mpjpe_curve", "mpjpe", "mpjve", "pck", "radius"]
