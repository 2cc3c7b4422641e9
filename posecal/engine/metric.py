"""Metrics: a per-pose statistic, and the function that turns its mean into the reported number.

Every number is ``finish(mean over poses of a per-pose statistic)``. Sums add, so files larger than memory, groups of
poses, shards on several machines and resampling by sequence need nothing else.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from posecal.data.arrays import FloatArray
from posecal.engine.block import Block
from posecal.engine.bounds import UNBOUNDED, Bounds, checked_bounds, finite_bounds
from posecal.engine.finish import MEAN, mean_over_joints
from posecal.engine.sums import Counts, Indices
from posecal.engine.user_code import values_of_arrays
from posecal.errors import PoseDataError

Direction = Literal["lower", "higher", "zero", "none"]
Family = Literal["accuracy", "calibration", "rank_tests", "scores", "sharpness"]
Over = Literal["median", "mean", "worst"]

Need = Literal[
    "lengths",
    "three axes",
    "positions",
    "three hypotheses",
    "alike hypotheses",
    "whole poses",
    "observed poses",
    "coordinate range",
    "climatology",
    "true clips",
]

MetricFunction = Callable[..., npt.ArrayLike]
"""``f(hypotheses, truth)``, with a keyword ``where`` if it takes one, to one value per pose, or per pose and joint."""


@dataclass(frozen=True)
class Statistic:
    """A number or a table of every pose, to be summed.

    Attributes
    ----------
    name : str
        Unique within a protocol.
    compute : callable
        From a block to (B, …); NaN where a pose (or a joint of it) does not count.
    per_joint : bool
        Whether the second axis is joints, each of which counts or not.
    per_pose : bool
        Whether the values of all poses are kept, for orders over poses, which no sums give.
    earlier : int
        How many poses before each pose it needs, for differences over time.
    by_segment : bool
        Whether its blocks are segments of a sequence, as the option ``segment`` has them.
    by_clip : bool
        Whether its blocks are clips; a value of a whole clip stands at its last pose, and NaN at the others.
    derive : callable or None
        What depends on other sequences: from the sums (C, …) and counts (C,) of all cells, and the sequence of each
        (C,), to the sums (C, …) whose means are finished.
    """

    name: str
    compute: Callable[[Block], FloatArray]
    per_joint: bool = False
    per_pose: bool = False
    earlier: int = 0
    by_segment: bool = False
    by_clip: bool = False
    derive: Callable[[FloatArray, Counts, Indices], FloatArray] | None = None


@dataclass(frozen=True)
class Deviation:
    """How a calibration error is made of the mean deviations of J curves from calibration.

    Attributes
    ----------
    first, last : int or None
        Which of the J curves are judged: those from the first to before the last, as in a slice.
    over : str
        Of their mean deviations: ``median`` for the error of the median curve, ``mean`` or ``worst`` for the mean or
        the largest of the curves' own errors.
    errors : Statistic or None
        The standardized errors of the joints, from which one knows how much frames depend on each other.
    """

    first: int | None = None
    last: int | None = None
    over: Over = "mean"
    errors: Statistic | None = None

    def __post_init__(self) -> None:
        _check_word("over", self.over, Over)


@dataclass(frozen=True, eq=False)
class Metric:
    """A reported number, with everything that one must know to read it.

    Attributes
    ----------
    name : str
        In snake case, as in JSON.
    label : str
        For tables.
    unit : str
        ``mm``, ``mm/s``, ``mm/frame`` or empty.
    direction : str
        ``lower`` or ``higher`` is better, ``zero`` is best, or ``none``.
    family : str
        ``accuracy``, ``calibration``, ``rank_tests``, ``scores`` or ``sharpness``: the table that it stands in.
    brief : str
        The definition in a few words, for a table.
    definition : str
        One line, with the numbers that it was made with.
    statistic : Statistic
        What is summed over poses.
    finish : callable
        From means of the statistic, ``(..., *shape)``, to numbers, ``(...)``: leading axes are resamples or groups.
        Where the values of all poses are kept, from those, (M, ...), to one number.
    by_joint : tuple of Statistic and callable, or None
        What is summed, and from its means ``(..., *shape)`` to one number per joint, (..., K); NaN for joints that
        don't count.
    leave_out : callable or None
        Where the values of all poses are kept: from those, (M, ...), and the sequence of each pose, (M,) of 0 … S - 1,
        to the number without each sequence, (S,).
    sequences_per_batch : int
        0: the mean is over poses. k: ``finish`` is applied to the mean over each k sequences, and the mean of that,
        weighted with their poses, is the number.
    headline : bool
        Whether the default report shows it.
    in_group_table, in_joint_table : bool
        Whether the tables by group and by joint show it.
    range : str
        Smallest and largest value, with what they mean.
    bounds : tuple of two float
        Smallest and largest possible value, infinite where there is none: intervals stay between them.
    calibrated : float
        What a calibrated model has, where that is one number; NaN else.
    reading : str
        How to read it, and what it does not say.
    source : str
        Where it comes from.
    deviation : Deviation or None
        Of calibration errors: how the error is made of mean deviations, so that sign flips can test it.
    offset : array (Q,) or None
        With it: what a perfect sampler's curve is off by at this N.
    rejection : str
        Of tests: what a rejection means.
    needs : tuple of str
        What the data must be for it; see :mod:`posecal.engine.needs`.
    """

    name: str
    label: str
    unit: str
    direction: Direction
    family: Family
    brief: str
    definition: str
    statistic: Statistic
    finish: Callable[[FloatArray], npt.ArrayLike]
    by_joint: tuple[Statistic, Callable[[FloatArray], FloatArray]] | None = None
    leave_out: Callable[[FloatArray, npt.NDArray[np.intp]], FloatArray] | None = None
    sequences_per_batch: int = 0
    headline: bool = False
    in_group_table: bool = False
    in_joint_table: bool = False
    range: str = ""
    bounds: Bounds = UNBOUNDED
    calibrated: float = math.nan
    reading: str = ""
    source: str = ""
    deviation: Deviation | None = None
    offset: FloatArray | None = None
    rejection: str = ""
    needs: tuple[Need, ...] = ()

    def __post_init__(self) -> None:
        _check_word("direction", self.direction, Direction)
        _check_word("family", self.family, Family)
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "str" and not isinstance(value, str):
                raise PoseDataError(f"metric: {field.name} {value!r}; expected text.")
        object.__setattr__(self, "bounds", checked_bounds(self.bounds))

    @property
    def function(self) -> MetricFunction | None:
        """The function of arrays that it was made of; None where it was made otherwise."""
        compute = self.statistic.compute
        return compute.args[0] if isinstance(compute, partial) and compute.func is values_of_arrays else None

    @property
    def statistics(self) -> tuple[Statistic, ...]:
        """Every statistic that the number, its test and its joints' numbers need."""
        errors = None if self.deviation is None else self.deviation.errors
        by_joint = None if self.by_joint is None else self.by_joint[0]
        return tuple(statistic for statistic in (errors, self.statistic, by_joint) if statistic is not None)

    @classmethod
    def from_function(
        cls,
        function: MetricFunction,
        /,
        *,
        name: str | None = None,
        label: str | None = None,
        unit: str = "mm",
        direction: Direction = "lower",
        family: Family = "accuracy",
        definition: str | None = None,
        by_joint: bool = False,
        in_group_table: bool = True,
        range: str = "",  # noqa: A002
        bounds: Bounds = UNBOUNDED,
        reading: str = "",
        source: str = "",
    ) -> Metric:
        """Make a metric of a function of arrays, such as those of :mod:`posecal.metrics`.

        Parameters
        ----------
        function : callable
            ``f(hypotheses (N, B, K, D), truth (B, K, D))`` in mm, relative to the root, to (B,) values, one per pose;
            NaN where a pose does not count. With ``by_joint`` to (B, K). Where it takes a keyword ``where``, it gets
            the bool array (B, K) of the joints that count; else poses that lack a joint don't count.
        name, label : str, optional
            The name in snake case and the one for tables; the function's name by default.
        unit, direction, family, range, bounds, reading, source
            As the attributes of :class:`Metric`.
        definition : str, optional
            One line; the first line of the function's docstring by default.
        by_joint : bool
            Whether the function gives a value per joint; the number is then the mean over joints.
        in_group_table : bool
            Whether the tables by group show it.

        Returns
        -------
        Metric
            For :func:`posecal.register`; its number is the mean over poses.

        Raises
        ------
        PoseDataError
            Where the function is not callable, or has no name, and for an unknown direction or family.

        Examples
        --------
        >>> def depth_error(hypotheses, truth):
        ...     \"\"\"Mean absolute error along the third axis.\"\"\"
        ...     return abs(hypotheses - truth)[..., 2].mean(axis=(0, 2))
        >>> Metric.from_function(depth_error).definition
        'Mean absolute error along the third axis.'
        """
        name = str(name or getattr(function, "__name__", ""))
        if not all((callable(function), name.isidentifier())):
            raise PoseDataError(f"metric: {function!r}; expected a function with a name, or the name beside it.")
        text = definition or (inspect.getdoc(function) or "").partition("\n")[0] or f"mean over poses of {name}"
        statistic = Statistic(
            f"own_{name}", partial(values_of_arrays, function, name, by_joint=by_joint), per_joint=by_joint
        )
        return cls(
            name=name,
            label=label or name.replace("_", " "),
            unit=unit,
            direction=direction,
            family=family,
            brief=text,
            definition=text,
            statistic=statistic,
            finish=mean_over_joints if by_joint else MEAN,
            by_joint=(statistic, np.asarray) if by_joint else None,
            headline=True,
            in_group_table=in_group_table,
            in_joint_table=by_joint,
            range=range,
            bounds=bounds,
            reading=reading,
            source=source,
        )

    @property
    def description(self) -> dict[str, Any]:
        """The metric as text, without its functions, as saved results and pickles keep it."""
        texts = {name: getattr(self, name) for name in _DESCRIBED} | {"bounds": finite_bounds(self.bounds)}
        statistic = {"statistic": self.statistic.name, "per_pose": self.statistic.per_pose}
        is_mean = self.statistic.name == f"own_{self.name}" and self.finish in (MEAN, mean_over_joints)
        return {**texts, **statistic, "by_joint": self.by_joint is not None, "is_mean": is_mean}

    @classmethod
    def from_description(cls, description: Mapping[str, Any], /) -> Metric:
        """Restore a metric for sums that are there already: means over poses, or what is registered under its name."""
        texts = {name: description[name] for name in _DESCRIBED}
        name, by_joint = str(description["statistic"]), bool(description["by_joint"])
        is_mean = bool(description["is_mean"])
        refuse = partial(_not_available, texts["name"])
        statistic = Statistic(name, refuse, per_joint=by_joint, per_pose=bool(description["per_pose"]))
        return cls(
            **texts,
            bounds=checked_bounds(description.get("bounds", UNBOUNDED)),  # none in results of posecal 0.1.0
            statistic=statistic,
            finish=refuse if not is_mean else mean_over_joints if by_joint else MEAN,
            by_joint=(statistic, np.asarray if is_mean else refuse) if by_joint else None,
        )

    @property
    def lacks_functions(self) -> bool:
        """Whether it was made of a description, so that poses can't be measured with it."""
        compute = self.statistic.compute
        return isinstance(compute, partial) and compute.func is _not_available

    def __reduce__(self) -> tuple[Callable[[dict[str, Any]], Metric], tuple[dict[str, Any]]]:
        return Metric.from_description, (self.description,)


_DESCRIBED = tuple(field.name for field in fields(Metric) if field.type in {"str", "bool", "Direction", "Family"})


def _check_word(what: str, word: object, known: object) -> None:
    """Refuse a word that a Literal type does not have."""
    if word not in get_args(known):
        raise PoseDataError(f"metric: {what} {word!r}; expected one of {', '.join(get_args(known))}.")


def _not_available(name: str, _: object) -> FloatArray:
    raise PoseDataError(f"metric: the functions of {name} are not available here; expected it to be registered.")


@dataclass(frozen=True, eq=False)
class Curve:
    """A number as a function of another, for pictures.

    Attributes
    ----------
    name : str
        In snake case.
    at : array (T,)
        Where the function is known.
    axes : tuple of two str
        What the two axes show, with units.
    definition : str
        One line.
    statistic : Statistic
        Its mean over poses, (T,), is the curve.
    needs : tuple of str
        As those of a :class:`Metric`.
    """

    name: str
    at: FloatArray
    axes: tuple[str, str]
    definition: str
    statistic: Statistic
    needs: tuple[Need, ...] = ()
