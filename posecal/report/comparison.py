"""Comparisons and their printed page: values, ranks and differences, primary metrics first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from posecal.data.texts import json_lines, printable_table
from posecal.engine.metric import Metric
from posecal.engine.totals import Totals
from posecal.errors import PosecalError, PoseDataError, attempt, did_you_mean, for_python, printable, raise_all
from posecal.report.format import ARROWS, MISSING, as_printed, counted, number, short_p, supported_digits
from posecal.report.sheet import Sheet, Table
from posecal.report.summary import frames_differ
from posecal.stats.comparison import PairedModels
from posecal.stats.multiplicity import check_primary
from posecal.stats.pairs import LEVEL_OF_OTHERS
from posecal.stats.resampling import LEVEL
from posecal.stats.same_poses import check_comparable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from posecal.stats.pairs import Difference

MOST_PAIRS = 15
"""Of more pairs than this, only those with the best model are shown; CSV and JSON hold all."""

MOST_COLUMNS = 6
"""Of more metrics than this, a table for a paper has a row for each, so that it fits on a page."""

BOLD = "bold", "the best model, with all that are not shown to be worse; none where no model is."
"""What bold numbers of a paper's table are."""

FORMATS = ("text", "csv", "json", "latex", "markdown")

TESTED = ("difference", "95 % interval", "p", "adjusted p", "better")


def comparison_sheet(
    comparison: PairedModels, words: Callable[[str], str] = for_python, *, paper: bool = False
) -> Sheet:
    """Lay out a comparison: the primary metrics, then the others; of three and more models, values and ranks first.

    Parameters
    ----------
    comparison : Comparison
        The models.
    words : callable
        How remarks name options.
    paper : bool
        Whether a row is a model, as papers print it, with the differences in a table of their own.

    Returns
    -------
    Sheet
        To be written as text, Markdown or LaTeX.
    """
    names, first = comparison.names, comparison.totals[0]
    shown = [m for m in comparison.metrics.values() if m.headline or m.family in {"scores", "rank_tests"}]
    primary = [comparison.metrics[name] for name in comparison.primary]
    others = [metric for metric in shown if metric not in primary]
    parts = {"primary metric": primary, "other metric": others}
    lay_out = _by_model if paper else _values
    tables = [lay_out(comparison, heading, metrics) for heading, metrics in parts.items() if metrics]
    if paper:
        tables += paper_pairs(comparison, primary)
    elif len(names) > 2:
        tables.append(pairs_table(comparison, primary))
    return Sheet(
        f"{' against '.join(names)} · the same M = {first.poses.sum():,} poses, paired by {first.units()}",
        sentences=sentences(comparison),
        remarks=list(comparison.remarks_in(words)),
        tables=tables,
        definitions=definitions(comparison, [*primary, *others]) + [BOLD] * paper,
        footer=f"signature: {first.signature}",
    )


def _values(comparison: PairedModels, heading: str, metrics: Iterable[Metric]) -> Table:
    """Lay out the numbers of all models: of two with their difference, of more with their ranks."""
    names, rows, best = comparison.names, [], []
    for row, metric in enumerate(metrics):
        shown = min(((each.low, each.high) for each in comparison.differences_of(metric.name)), key=_width)
        values = [number(comparison.value(metric.name, model), metric.unit, shown) for model in names]
        ranks = [comparison.rank(metric.name, model) for model in names]
        if max(ranks) > 1:
            best += [(row, 2 + column) for column, rank in enumerate(ranks) if rank == 1]
        if len(names) == 2:
            values += _tested(comparison.differences_of(metric.name)[0], metric.unit)
        elif metric.direction != "none":
            values = [f"{value} ({rank})" for value, rank in zip(values, ranks, strict=True)]
        rows.append((metric.label, ARROWS[metric.direction], *values))
    columns = (*names, *TESTED) if len(names) == 2 else [f"{name} (rank)" for name in names]
    title = f"{heading[0].upper()}{heading[1:]}s"
    return Table(title, (heading, "", *columns), rows, ("", "better"), best=best)


def _by_model(comparison: PairedModels, heading: str, metrics: Iterable[Metric]) -> Table:
    """Lay out the numbers as papers print them: a row per model, or of many metrics a row per metric; best in bold."""
    names = comparison.names
    columns, best = [], []
    for column, metric in enumerate(metrics, 1):
        label, unit, scale = as_printed(metric)
        low, high = min(((each.low, each.high) for each in comparison.differences_of(metric.name)), key=_width)
        values = [scale * comparison.value(metric.name, model) for model in names]
        cells = [number(value, unit, (scale * low, scale * high)).removesuffix(f" {unit}") for value in values]
        ranks = [comparison.rank(metric.name, model) for model in names]
        if max(ranks) > 1:
            best += [(row, column) for row, rank in enumerate(ranks) if rank == 1]
        columns.append((label, *cells))
    title = f"{heading[0].upper()}{heading[1:]}s"
    if len(columns) > MOST_COLUMNS:
        return Table(title, (heading, *names), columns, best=[(column - 1, row + 1) for row, column in best])
    headings, *rows = zip(("model", *names), *columns, strict=True)
    return Table(title, headings, rows, best=best)


def pairs_table(comparison: PairedModels, metrics: Iterable[Metric]) -> Table:
    """Lay out the differences of every pair of models, or of the pairs with the best one."""
    rows = [
        (metric.label, f"{one.first} − {one.second}", *_tested(one, metric.unit))
        for metric in metrics
        for one in _pairs(comparison, metric)
    ]
    return Table("Pairs", ("pair", "models", *TESTED), rows, ("models", "better"))


def paper_pairs(comparison: PairedModels, metrics: Iterable[Metric]) -> list[Table]:
    """Lay out the differences for a paper, a table for each metric: which model is better, the sign says."""
    tables = []
    for metric in metrics:
        label, unit, scale = as_printed(metric)
        rows = []
        for one in _pairs(comparison, metric):
            value, interval, _, p, _ = _tested(one, unit, scale)
            rows.append((f"{one.first} − {one.second}", f"{value} ({interval})" if interval else value, p))
        tables.append(Table(f"Pairs, {label}", (label, "difference (95 % interval)", "adjusted p"), rows))
    return tables


def _pairs(comparison: PairedModels, metric: Metric) -> Sequence[Difference]:
    differences = comparison.differences_of(metric.name)
    if len(differences) <= MOST_PAIRS:
        return differences
    best = best_first(comparison, metric)[0]
    return [one for one in differences if best in (one.first, one.second)]


def best_first(comparison: PairedModels, metric: Metric) -> list[str]:
    """Sort the models by a number, beyond chance or not; those without one come last."""
    sign = -1 if metric.direction == "higher" else 1
    values = {name: sign * comparison.value(metric.name, name) for name in comparison.names}
    if metric.direction == "zero":
        values = {name: abs(value) for name, value in values.items()}
    return sorted(values, key=lambda name: (math.isnan(values[name]), values[name]))


def _tested(difference: Difference, unit: str, scale: float = 1.0) -> tuple[str, ...]:
    low, high, found = scale * difference.low, scale * difference.high, scale * difference.value
    digits = supported_digits(low, high, 2 if unit else 4)
    interval = "" if math.isnan(low) else f"{low:+z.{digits}f} to {high:+z.{digits}f}"
    p = (MISSING if math.isnan(p) else short_p(p) for p in (difference.p, difference.p_adjusted))
    value = MISSING if math.isnan(found) else f"{found:+z.{digits}f}"
    return value, interval, *p, difference.better or ""


def _width(interval: tuple[float, float]) -> float:
    low, high = interval
    return math.inf if math.isnan(low) else high - low


def definitions(comparison: PairedModels, metrics: Iterable[Metric]) -> list[tuple[str, str]]:
    """Say what p-values are adjusted for, and of which metrics the distances from 0 are compared."""
    n_pairs = math.comb(len(comparison.names), 2)
    n_primary, n_all = (counted(len(some) * n_pairs, "test") for some in (comparison.primary, comparison.metrics))
    others = f", others over all {n_all}" if n_primary != n_all else ""
    rule = f"Holm's, primary metrics over {n_primary}{others} (metrics × pairs of models)"
    level = f"{LEVEL:g}, of other metrics {LEVEL_OF_OTHERS:g}" if others else f"{LEVEL:g}"
    words = [("adjusted p", f"{rule}. A model is called better where it is below {level}.")]
    at_zero = [metric.label for metric in metrics if metric.direction == "zero"]
    if at_zero:
        words.append((", ".join(at_zero), "best at 0; differences are of the distances from 0."))
    return words


def sentences(comparison: PairedModels) -> list[str]:
    """Name the best model by accuracy, calibration and score, and the models that are not miscalibrated.

    Nothing is said about calibration where the coordinate frames of a model differ.
    """
    words, differ = [], any(map(frames_differ, comparison.totals))
    several = len(comparison.names) > 1
    for name in dict.fromkeys((*comparison.chosen, *("energy_score", "ece", "min_mpjpe"))) if several else ():
        metric = comparison.metrics.get(name)
        if metric is not None and metric.direction != "none" and not (differ and metric.family == "calibration"):
            words.append(f"{metric.label}: {_best(comparison, name)}.")
    if not differ and "ece" in comparison.metrics and comparison.has_test():
        models = ", ".join(comparison.calibrated()) or "none"
        words.append(f"No miscalibration shown on average: {models}.")
    return words


def _best(comparison: PairedModels, metric: str) -> str:
    """Say which model is best, or why none can be."""
    if all(math.isnan(one.value) for one in comparison.differences_of(metric)):
        unknown = all(math.isnan(comparison.value(metric, model)) for model in comparison.names)
        return "no value" if unknown else "not compared"
    best = [model for model in comparison.names if _beats_all(comparison, metric, model)]
    return f"{best[0] if best else 'none'} is best beyond chance"


def _beats_all(comparison: PairedModels, metric: str, model: str) -> bool:
    own = (one for one in comparison.differences_of(metric) if model in (one.first, one.second))
    return all(one.better == model for one in own)


@dataclass(frozen=True, repr=False)
class Comparison(PairedModels):
    """Several models on the same poses, with their printed page; each number is computed when it is asked for, once.

    Attributes
    ----------
    names : tuple of str
        The models.
    totals : tuple of Totals
        Their sums.
    chosen : tuple of str
        Primary metrics; none for those of the default.
    """

    def __str__(self) -> str:
        return self.render()

    def _repr_html_(self) -> str:
        from posecal.report.html import render

        return render("fragment.html", sheet=comparison_sheet(self))

    def plot(self, *, title: str | None = None) -> Figure:
        """Draw minMPJPE against the ECE of each model, as :func:`posecal.plot.draw_comparison` does."""
        from posecal.plot.comparison import draw_comparison

        return draw_comparison(self, title=title)

    def render(
        self, form: str = "text", *, width: int = 120, colour: bool = False, words: Callable[[str], str] = for_python
    ) -> str:
        """Write the comparison.

        Parameters
        ----------
        form : str
            ``text``, ``markdown`` or ``latex`` (a table for a paper, with a row per model); ``csv``, a row for each
            difference and remark; ``json``, with all values, ranks and differences.
        width, colour
            Of the terminal, for ``text``.
        words : callable
            How remarks name options: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.

        Returns
        -------
        str
            Without a final line break.

        Raises
        ------
        PoseDataError
            For another form.
        """
        if form == "csv":
            remarks, shown = [*map(printable, self.remarks_in(words))], printable_table(self.table)
            notes = shown.iloc[:0].reindex(range(len(remarks))).assign(metric="remark", first=remarks)
            parts = [part.to_csv(index=False, header=part is shown, lineterminator="\n") for part in (shown, notes)]
            return "".join(parts).rstrip("\n")
        if form == "json":
            return self._as_json(words)
        if form not in FORMATS:
            raise PoseDataError(f"format: {form!r} is not known. {did_you_mean(form, FORMATS)}")
        sheet = comparison_sheet(self, words, paper=form == "latex")
        return sheet.text(width=width, colour=colour) if form == "text" else str(getattr(sheet, form)())

    def _as_json(self, words: Callable[[str], str]) -> str:
        values = [
            {"metric": name, "model": model, "value": plain(self.value(name, model)), "rank": self.rank(name, model)}
            for name in self.metrics
            for model in self.names
        ]
        differences = [{key: plain(value) for key, value in asdict(d).items()} for d in self.differences]
        about = {"signature": self.totals[0].signature, "models": self.names, "primary": self.primary}
        return json_lines({**about, "remarks": self.remarks_in(words), "values": values, "differences": differences})


def plain(value: object) -> object:
    """Give None for NaN, which JSON lacks."""
    return None if isinstance(value, float) and math.isnan(value) else value


def compare_totals(totals: Sequence[Totals], names: Sequence[str], primary: Sequence[str] = ()) -> Comparison:
    """Compare models on the same poses.

    Parameters
    ----------
    totals : sequence of Totals
        Two or more, made alike.
    names : sequence of str
        What the models are called.
    primary : sequence of str
        Metrics that the comparison rests on; see :func:`posecal.compare`.

    Returns
    -------
    Comparison
        Values, differences and ranks.

    Raises
    ------
    PoseDataError
        Where two were not made alike or not on the same poses, and for primary metrics that they lack.
    """
    if len(totals) < 2:
        raise PoseDataError(f"compare: {len(totals)} model; expected at least 2.")
    names = [name if names.index(name) == at else f"{name} #{at + 1}" for at, name in enumerate(names)]
    problems: list[str | PosecalError] = []
    for name, other in zip(names[1:], totals[1:], strict=True):
        attempt(problems, check_comparable, totals[0], other, names[0], name)
    raise_all(problems)
    comparison = Comparison(tuple(names), tuple(totals), tuple(primary))
    check_primary(primary, comparison.metrics, totals[0])
    return comparison
