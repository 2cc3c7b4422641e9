"""Metrics of hypotheses: functions of arrays, and the entries of reports that are made of them.

Every function takes ``hypotheses`` (N, M, K, D) and ``truth`` (M, K, D) as they stand and returns (M,) values, one
per pose, or (C,) of clips; average them as you like. ``mpjpe``: the MPJPE family; ``best_of``: minMPJPE against the
number of hypotheses; ``displacement`` and ``multimodal``: clips of motion prediction, ADE, FDE, APD, MMADE, MMFDE,
APDE; ``velocity``: MPJVE, acceleration error, jitter; ``world``: WA- and W-MPJPE; ``pck``: PCK and AUC; ``cps``: CPS;
``proper``: fair proper scores; ``brier``: the Brier score; ``sharpness``: diversity and radii; ``uncertainty``:
whether a wide spread means error; ``risk_coverage``: the error of the poses that are kept by it; ``failures``:
whether it tells large errors from others; ``likelihood``: the NLL, and climatology's.
"""

from posecal.metrics.best_of import min_mpjpe_curve
from posecal.metrics.brier import brier_score
from posecal.metrics.cps import cps
from posecal.metrics.displacement import ade, apd, clip_energy_score, fde
from posecal.metrics.failures import failure_auroc
from posecal.metrics.likelihood import climatology_log_prob, nll
from posecal.metrics.mpjpe import min_mpjpe, mpjpe
from posecal.metrics.multimodal import apde, mmade, mmfde
from posecal.metrics.pck import auc, pck
from posecal.metrics.proper import crps, energy_score, variogram_score
from posecal.metrics.risk_coverage import aurc, excess_aurc, risk_coverage
from posecal.metrics.sharpness import diversity, radius
from posecal.metrics.uncertainty import ause, rank_correlation, sparsification
from posecal.metrics.velocity import acceleration_error, jitter, mpjve
from posecal.metrics.world import world_mpjpe

__all__ = [
    "acceleration_error",
    "ade",
    "apd",
    "apde",
    "auc",
    "aurc",
    "ause",
    "brier_score",
    "climatology_log_prob",
    "clip_energy_score",
    "cps",
    "crps",
    "diversity",
    "energy_score",
    "excess_aurc",
    "failure_auroc",
    "fde",
    "jitter",
    "min_mpjpe",
    "min_mpjpe_curve",
    "mmade",
    "mmfde",
    "mpjpe",
    "mpjve",
    "nll",
    "pck",
    "radius",
    "rank_correlation",
    "risk_coverage",
    "sparsification",
    "variogram_score",
    "world_mpjpe",
]
