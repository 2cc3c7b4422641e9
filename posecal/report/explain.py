"""What is this number, what range has it, and how is it read? A page on every metric, for ``--explain``."""

from __future__ import annotations

from dataclasses import dataclass

from posecal.data.skeleton import JOINT_SETS
from posecal.engine.metric import DataSpec, Metric
from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, did_you_mean
from posecal.registry import known_metrics
from posecal.report.rows import WORTH, Beside, beside, kinds

__all__ = ["Page", "explain", "page"]


@dataclass(frozen=True)
class Page:
    """What one should know about a metric, beside its definition.

    Attributes
    ----------
    span : str
        Its range, with what the ends mean.
    reading : str
        How to read it, and what it does not say.
    source : str
        Where it comes from.
    """

    span: str
    reading: str
    source: str


_POSITION = Page(
    "0 mm (every joint right) upwards",
    "The mean error of all hypotheses of a good model is larger than that of its mean pose: it pays for the spread "
    "that the image leaves open. Alone it rewards hypotheses that all agree.",
    "Ionescu et al., TPAMI 2014 (protocol); Wang et al., arXiv:2104.11536",
)
_BEST = Page(
    "0 mm (the truth is among the hypotheses) upwards",
    "Falls with N for any model, so numbers at different N share no column; min_mpjpe_at_n compares at the same n. It "
    "rewards a wrong spread: the best for 200 hypotheses in 45 dimensions is 2.5 times too narrow. Read it beside a "
    "calibration error.",
    "Jahangiri and Yuille, arXiv:1702.02258; Pierzchlewicz et al., arXiv:2210.11179",
)
_ECE = Page(
    "0 (the diagonal) to about 0.5 (a curve that never leaves the axis)",
    "Never 0 on finite data, not even for a perfect sampler: compare it with what a calibrated sampler would show by "
    "chance (…_null, …_null_95, …_p), never with an interval around itself. It does not say on which side a model "
    "errs (signed_area does), is blind to direction, shape and correlation (the battery is not), and a model that "
    "ignores the image can have a perfect one.",
    "Pierzchlewicz et al., arXiv:2210.11179, section 3.1; Naeini et al., AAAI 2015",
)
_AREA = Page(
    "−0.5 (no truth in any ball) to 0.5 (every truth in the smallest)",
    "Negative: the hypotheses are too narrow or off (overconfident). Positive: wider than need be (underconfident).",
    "posecal",
)
_COVERAGE = Page(
    "0 to 1; the level itself is best",
    "What a user of the ball experiences: of the balls that hold 90 % of the hypotheses, so many hold the truth.",
    "posecal; Kuleshov et al., arXiv:1807.00263 (the idea for regression)",
)
_RANK = Page(
    "0 (ranks uniform) to about 0.5",
    "A test, not a score: read its p-value, which is adjusted for the number of tests. Small p: the truth does not "
    "rank among the hypotheses as one of them would.",
    "Gneiting et al., Test 17, 211 (2008); Thorarinsdottir et al., arXiv:1307.5250; Lemos et al., arXiv:2302.03026",
)
_SCORE = Page(
    "single poses may be below 0; the mean is not, but for chance",
    "Proper: a model can't gain by lying about its spread. Only differences and skills mean something; a wide but true "
    "distribution may lose to a narrow true one, which knows more.",
    "Gneiting and Raftery, doi:10.1198/016214506000001437; Ferro, doi:10.1002/qj.2270",
)
_WIDTH = Page(
    "0 mm upwards",
    "Sharpness: smaller is better only among models that are calibrated. It never looks at the truth.",
    "Gneiting, Balabdaoui and Raftery, doi:10.1111/j.1467-9868.2007.00587.x",
)

_PAGES: dict[str, Page] = {
    "min_mpjpe": _BEST,
    "mpjpe": _POSITION,
    "ece": _ECE,
    "signed_area": _AREA,
    "coverage": _COVERAGE,
    "radius": _WIDTH,
    "diversity": _WIDTH,
    "energy_score": _SCORE,
    "joint_energy_score": _SCORE,
    "crps": _SCORE,
    "variogram_score": _SCORE,
    "skill": Page(
        "below 0 (worse than the reference) to 1 (perfect)",
        "The share of the reference's score that the model saves. Against climatology, a model that ignores the image "
        "has none, though it passes every calibration test.",
        "Gneiting and Raftery, doi:10.1198/016214506000001437",
    ),
    "brier": Page(
        "0 to about 1",
        "Of the event that the median pose is right at every joint, to which the hypotheses give a probability. Its "
        "miscalibration part is what better probabilities alone would gain.",
        "Brier (1950); Dimitriadis, Gneiting and Jordan, doi:10.1073/pnas.2016191118",
    ),
    "pck": Page(
        "0 to 1",
        "The share of joints that are right to the threshold, of the best hypothesis at that: it rises with N.",
        "Mehta et al., arXiv:1611.09813",
    ),
    "auc": Page(
        "0 to 30/31 with strict thresholds (none is below 0 mm), else 1",
        "PCK without the choice of one threshold.",
        "Mehta et al., arXiv:1611.09813",
    ),
    "cps": Page(
        "0 to 299 mm",
        "190 mm means that the worst joint of the best hypothesis is about 110 mm off, after alignment.",
        "Wandt et al., arXiv:2011.14679",
    ),
    "mpjve": Page(
        "0 mm upwards",
        "How much the hypotheses jitter against the true motion. Those drawn anew for every frame jitter by design.",
        "Pavllo et al., arXiv:1811.11742",
    ),
    "spread_error_correlation": Page(
        "−1 to 1",
        "Whether a wide spread is a sign of error, which is what acting on uncertainty needs. A perfect sampler stays "
        "below 1, since an error is one draw.",
        "posecal",
    ),
    "sparsification_area": Page(
        "about 0 (spread orders poses as their errors do) upwards",
        "What is lost, in mean errors, by dropping poses by their spread instead of their error.",
        "Ilg et al., arXiv:1802.07095",
    ),
}
_BY_CHANCE = Page(
    "0 to about 0.5",
    "What the error is to be held against: sequences of a calibrated sampler deviate to either side alike, so their "
    "deviations are given random signs. An error below the 95 % quantile (…_null_95) may be chance.",
    "posecal; Canay, Romano and Shaikh, doi:10.3982/ECTA13081",
)
_P_VALUE = Page(
    "1/2000 (fewer than 12 sequences: 1 over the number of signs) to 1",
    "Small: a calibrated sampler would hardly ever show such an error on this data. Large: nothing was found, which a "
    "model of few sequences can't but show. None with fewer than six sequences. Over several tests read the adjusted "
    "one, which keeps any false alarm among them at its level.",
    "posecal; Canay, Romano and Shaikh, doi:10.3982/ECTA13081; Holm, Scand. J. Stat. 6, 65 (1979)",
)
_FLOOR = Page(
    "0 to about 0.5",
    "What N and M alone cost: the definitions of the paper and of its script are biased at finite N, and every curve "
    "scatters at finite M. Frames and joints are taken as independent; where they are not, as in video, a perfect "
    "sampler shows more, and …_null is the number to hold an error against.",
    "posecal",
)
_BESIDE = {
    "null": _BY_CHANCE,
    "null_95": _BY_CHANCE,
    "p": _P_VALUE,
    "p_adjusted": _P_VALUE,
    "floor": _FLOOR,
    "floor_95": _FLOOR,
}
_WORTH = {
    "effective_poses": Page(
        "about 1 to the number of poses",
        "Frames of a video resemble their neighbours: so many independent poses would tell as much of calibration. It "
        "is estimated from how the sequences differ, so of few sequences it is rough.",
        "posecal",
    ),
    "squared_error": Page(
        "about 0 (calibrated; by chance a little below) to about 0.3",
        "Unlike an ECE it does not grow as data shrink: what chance adds to the squared distance from the diagonal is "
        "taken off.",
        "posecal",
    ),
}
_DIRECTIONS = {"lower": "lower is better", "higher": "higher is better", "zero": "0 is best", "none": "none is better"}


def page(metric: Metric) -> Page:
    """Give the page of a metric."""
    if metric.family == "rank_tests":
        return _RANK
    name = metric.name.removeprefix("pa_").removeprefix("n_")
    if name in _PAGES:
        return _PAGES[name]
    endings = [key for key in _PAGES if name.startswith(key) or name.endswith(key)]
    return _PAGES["skill" if name.endswith("_skill") else max(endings, key=len)]


def explain(name: str, protocol: Protocol | None = None, spec: DataSpec | None = None) -> str:
    """Say what a metric is and how to read it.

    Parameters
    ----------
    name : str
        A metric, or a number that stands beside one, such as ``ece_null_95``.
    protocol : Protocol, optional
        The options that its definition is written out for.
    spec : DataSpec, optional
        What it is measured on; 200 hypotheses of 17 joints by default.

    Returns
    -------
    str
        Several lines.

    Raises
    ------
    PoseDataError
        For a name that is not known.

    Examples
    --------
    >>> print(explain("signed_area").splitlines()[0])
    signed_area: signed area
    """
    everything = DataSpec(
        200,
        JOINT_SETS["h36m-17"],
        root=0,
        labels=("sequence",),
        has_scores=True,
        has_occlusion=True,
        reference="climatology",
    )
    known = known_metrics(protocol or Protocol(), spec or everything)
    pages: dict[str, tuple[Metric | Beside, Page]] = {key: (metric, page(metric)) for key, metric in known.items()}
    for error in known.values():
        pages |= {f"{error.name}_{kind}": (beside(error, kind), _BESIDE[kind]) for kind in kinds(error)}
    pages |= {key: (found, _WORTH[key]) for key, found in WORTH.items()}
    if name not in pages:
        raise PoseDataError(f"explain: {name!r} is not known. {did_you_mean(name, pages)}")
    number, about = pages[name]
    metric = known.get(name)
    lines = [
        f"{number.name}: {number.label}",
        f"definition  {number.definition}",
        f"unit        {(metric.unit if metric else '') or 'none'}",
        f"range       {about.span}",
        f"direction   {_DIRECTIONS[number.direction]}",
        f"how to read {about.reading}",
    ]
    if metric and metric.rejection:
        lines.append(f"if it fires {metric.rejection}")
    return "\n".join([*lines, f"source      {about.source}"])
