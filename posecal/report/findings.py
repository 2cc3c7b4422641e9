"""What does an evaluation find? Numbers, tests and curves, read from its sums.

:class:`Findings` is a report without its paper: what is laid out on sheets, said in words and drawn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import cast

import numpy as np

from posecal.calibration import LEVELS, CalibrationCurve, Definition, OverJoints, signed_area
from posecal.calibration.entries import curve_of, summary
from posecal.calibration.ranks import known_definition
from posecal.data.arrays import FloatArray
from posecal.engine.cells import label_name
from posecal.engine.metric import Curve, Metric
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, did_you_mean
from posecal.metrics.occlusion import OCCLUSION
from posecal.metrics.proper_entries import Reliability, reliability_of_counts
from posecal.metrics.uncertainty import sparsification
from posecal.registry import curves_of, metrics_of, occlusion_metrics_of
from posecal.report.rows import Cells, Row, adjusted, by_joint, floors, nulls, over_poses, worth
from posecal.stats.resampling import FEWEST, Null, holm
from posecal.stats.uncertainty import joint_null, null

__all__ = ["Findings"]


class Findings:
    """The numbers of an evaluation, with their definitions.

    Parameters
    ----------
    totals : Totals
        The sums.
    by : sequence of str
        Labels to group by, beside the numbers over all poses.

    Raises
    ------
    PoseDataError
        For a label that the sums don't hold.
    """

    def __init__(self, totals: Totals, by: Sequence[str] = ()) -> None:
        self.totals = totals
        self.by = tuple(dict.fromkeys(label_name(entry) for entry in ((by,) if isinstance(by, str) else by)))
        self.metrics: dict[str, Metric] = metrics_of(totals.protocol, totals.spec)
        self._curves: dict[str, Curve] = curves_of(totals.protocol, totals.spec)
        self.groups: dict[str | None, Cells] = {None: None}
        self._nulls: dict[tuple[str, str | None], Null] = {}
        self.occlusion: dict[str, dict[str, Metric]] = {}
        for label in self.by:
            if label == "occlusion":
                self.occlusion = occlusion_metrics_of(totals.protocol, totals.spec)
                if any(m.statistic.name not in totals.sums for ms in self.occlusion.values() for m in ms.values()):
                    raise PoseDataError("by: this result holds no numbers by occlusion. Evaluate with --by occlusion.")
            else:
                self.groups |= {f"{label}={value}": cells for value, cells in totals.groups(label)}

    @property
    def signature(self) -> str:
        """One line that tells whether two reports can be compared: only if it is the same."""
        return self.totals.signature

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a careful reader should know about the data."""
        totals, found = self.totals, list(self.totals.remarks)
        sequences = len(set(totals.cells["sequence"].tolist()))
        units = totals.units()
        if not totals.sequences:
            consecutive = units.replace("of frames", "of consecutive frames")
            found.append(f"no sequence labels: {consecutive} are taken as independent. In a video they are not.")
        if sequences < FEWEST:
            found.append(
                f"{units} allow{'s' * (sequences == 1)} no test: even if all err alike, chance would do that in "
                f"{2 / 2**sequences:.0%} of cases. At least {FEWEST} are needed for a p-value."
            )
        n = totals.spec.n_hypotheses
        if n < 2:
            found.append("calibration and spread need at least 2 hypotheses; there is 1.")
        elif n < 20 and any(metric.family == "calibration" for metric in self.metrics.values()):
            found.append(
                f"N = {n} hypotheses are few: look at what a perfect sampler would show before reading an ECE (paper)."
            )
        return tuple(found)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """All numbers: over all poses, per joint, and per group."""
        return tuple(self._all_rows())

    def _all_rows(self) -> Iterator[Row]:
        totals, metrics = self.totals, self.metrics
        for group, cells in self.groups.items():
            yield from (over_poses(totals, metric, group, cells) for metric in metrics.values())
        for occlusion, seen in self.occlusion.items():
            row = OCCLUSION.index(occlusion)
            yield from (over_poses(totals, metric, f"occlusion={occlusion}", row=row) for metric in seen.values())
        for metric in metrics.values():
            yield from by_joint(totals, metric)
        yield from floors(totals, metrics)
        yield from self._beside()
        yield from worth(totals, metrics)

    def _beside(self) -> Iterator[Row]:
        """What a calibrated sampler would show: for all errors over all poses, for the ECE in each group too."""
        totals, metrics = self.totals, self.metrics
        for name, metric in metrics.items():
            if metric.deviation is not None:
                yield from nulls(totals, metric, self.null(name), over_poses(totals, metric))
        tests = {name: metric for name, metric in metrics.items() if metric.family == "rank_tests"}
        yield from adjusted(totals, tests, {name: p for name, (_, p) in self.rank_tests().items()})
        for group, cells in self.groups.items():
            if group is not None and "ece" in metrics and not math.isnan((found := self.null("ece", group)).p):
                yield from nulls(totals, metrics["ece"], found, over_poses(totals, metrics["ece"], group, cells))
        for occlusion, seen in self.occlusion.items():
            found, row = null(totals, seen["ece"]), OCCLUSION.index(occlusion)
            if not math.isnan(found.p):
                of = over_poses(totals, seen["ece"], f"occlusion={occlusion}", row=row)
                yield from nulls(totals, seen["ece"], found, of)

    def definition(self, metric: str) -> str:
        """Give the definition of a metric.

        Raises
        ------
        PoseDataError
            Where it is not in the report.
        """
        if metric not in self.metrics:
            raise PoseDataError(f"{metric} is not in the report. {did_you_mean(metric, self.metrics)}")
        return self.metrics[metric].definition

    def null(self, metric: str, group: str | None = None) -> Null:
        """Give what a calibrated sampler would show for a calibration error, by sequence sign-flips.

        Parameters
        ----------
        metric : str
            The name of a calibration error or of a test of the battery.
        group : str, optional
            ``label=value``; all poses by default.

        Returns
        -------
        Null
            With NaN p where there are too few sequences.

        Raises
        ------
        PoseDataError
            Where the report has no such error.
        """
        found = self.metrics.get(metric)
        if found is None or found.deviation is None or group not in self.groups:
            known = [name for name, metric in self.metrics.items() if metric.deviation is not None]
            raise PoseDataError(f"{metric} (group {group}) is no calibration error here. {did_you_mean(metric, known)}")
        key = metric, group
        if key not in self._nulls:
            self._nulls[key] = null(self.totals, found, self.groups[group])
        return self._nulls[key]

    def joint_tests(self) -> dict[str, tuple[float, float]]:
        """Test each joint's own calibration curve.

        Returns
        -------
        dict
            By joint: its signed area, and its p-value by sequence sign-flips, adjusted for the number of joints
            (Holm). Empty without calibration, or with too few sequences.
        """
        metric = self.metrics.get("ece") or self.metrics.get("signed_area")
        if metric is None or metric.by_joint is None:
            return {}
        areas = signed_area(self.totals.averaged(metric.statistic)[:-1])
        scored = [k for k, area in enumerate(areas) if not np.isnan(area)]
        adjusted = holm([joint_null(self.totals, metric, k).p for k in scored])
        joints = self.totals.spec.joints
        return {joints[k]: (float(areas[k]), p) for k, p in zip(scored, adjusted, strict=True) if not math.isnan(p)}

    def rank_tests(self) -> dict[str, tuple[Null, float]]:
        """Give the tests of the battery: what each shows, and its p-value adjusted for their number (Holm)."""
        names = [name for name, metric in self.metrics.items() if metric.family == "rank_tests"]
        nulls = [self.null(name) for name in names]
        adjusted = holm([null.p for null in nulls])
        return {name: (null, p) for name, null, p in zip(names, nulls, adjusted, strict=True)}

    def value(self, metric: str, group: str | None = None, joint: str | None = None) -> float:
        """Give one number.

        Parameters
        ----------
        metric : str
            Its name.
        group : str, optional
            ``label=value``; all poses by default.
        joint : str, optional
            A joint; the summary over joints by default.

        Returns
        -------
        float
            The number.

        Raises
        ------
        PoseDataError
            Where the report has no such number.
        """
        for row in self.rows:
            if (row.metric, row.group, row.joint) == (metric, group, joint):
                return row.value
        known = sorted({row.metric for row in self.rows})
        where = "".join(f" {word} {said}" for word, said in (("of", group), ("at", joint)) if said is not None)
        raise PoseDataError(f"{metric}{where} is not in the report. {did_you_mean(metric, known)}")

    def calibration(self, definition: Definition = "exchangeable", group: str | None = None) -> CalibrationCurve:
        """Give the calibration curves of a group of poses.

        Parameters
        ----------
        definition : str
            One of :data:`posecal.calibration.ranks.DEFINITIONS`.
        group : str, optional
            ``label=value``; all poses by default.

        Returns
        -------
        CalibrationCurve
            A curve per joint; NaN for joints that don't count.

        Raises
        ------
        PoseDataError
            Where the report has no such curves.
        """
        name = f"inside_{known_definition(definition)}"
        if name not in self.totals.sums or group not in self.groups:
            raise PoseDataError(f"calibration: the report has no {definition} curves of {group or 'its poses'}.")
        return curve_of(self._mean(name, self.groups[group]), definition)

    def summary_curve(self, definition: Definition = "exchangeable", group: str | None = None) -> FloatArray:
        """Give the one curve (Q,) that stands for all joints: the one that the ECE is made from."""
        curve = self.calibration(definition, group)
        over = cast(OverJoints, self.totals.protocol.summary_over_joints)
        return summary(np.concatenate([curve.coverage, curve.pooled[None]]), over)

    def curve(self, name: str) -> tuple[Curve, FloatArray]:
        """Give a curve and its values.

        Parameters
        ----------
        name : str
            ``errors_by_n``, ``pck_curve`` or ``cps_curve``.

        Returns
        -------
        tuple of Curve and array (T,)
            What it is, and its values.

        Raises
        ------
        PoseDataError
            Where the report has no such curve.
        """
        if name not in self._curves:
            raise PoseDataError(f"curve: {name!r} is not known. {did_you_mean(name, self._curves)}")
        if name not in self.totals.sums:
            raise PoseDataError(f"curve: the report has no {name}; it is among the default metrics.")
        curve = self._curves[name]
        return curve, self.totals.averaged(curve.statistic)

    def rank_curves(self, test: str) -> FloatArray:
        """Give the curves of a test of the battery, (R, Q): one, or one per coordinate.

        Raises
        ------
        PoseDataError
            Where the report has no such test.
        """
        if test not in self.metrics or self.metrics[test].family != "rank_tests":
            known = [name for name, metric in self.metrics.items() if metric.family == "rank_tests"]
            raise PoseDataError(f"{test} is no test in the report. {did_you_mean(test, known)}")
        curves = self.totals.averaged(self.metrics[test].statistic).reshape(-1, LEVELS.size)
        return curves[~np.isnan(curves).any(axis=1)]

    def sparsification(self) -> tuple[FloatArray, FloatArray]:
        """Give the mean error left when poses are dropped, by spread and by error; see :mod:`posecal.metrics.uncertainty`.

        Raises
        ------
        PoseDataError
            Where the report kept no spreads and errors.
        """
        if "spread_and_error" not in self.totals.per_pose:
            raise PoseDataError(
                "sparsification: the report kept no spreads and errors; they are among the default metrics."
            )
        kept = self.totals.per_pose["spread_and_error"]
        return sparsification(kept[:, 0], kept[:, 1])

    def event_reliability(self) -> Reliability:
        """Give the isotonic reliability of the event that the median pose is right at every joint.

        Raises
        ------
        PoseDataError
            Where the report has no Brier score.
        """
        if "brier_miscalibration" not in self.metrics:
            raise PoseDataError("event: the report has no Brier score. Evaluate with --scores.")
        return reliability_of_counts(self.totals.mean(self.metrics["brier_miscalibration"].statistic))

    def _mean(self, name: str, cells: Cells) -> FloatArray:
        statistic = next(s for metric in self.metrics.values() for s in metric.statistics if s.name == name)
        return self.totals.averaged(statistic, cells)
