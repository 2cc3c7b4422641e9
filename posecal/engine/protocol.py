"""Protocol options: every choice that papers make differently, each with a name, its values and a default."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any, Literal, get_args, get_origin, get_type_hints

from posecal.data.joint_names import find_joint, joint_keys
from posecal.data.skeleton import JOINT_SETS, REST_POSE
from posecal.errors import PoseDataError, did_you_mean, raise_all

_LENGTHS = ("pck_threshold", "failure_threshold", "mm_threshold")
"""Options that are numbers."""

OverJoints = Literal["median", "mean", "worst", "pooled"]


def _option(default: object, about: str, form: str = "", valid: Callable[[Any], bool] = bool) -> Any:
    """Declare an option: what it is about and, unless its type lists the values, their form in words and a check."""
    return field(default=default, metadata={"about": about, "form": form, "valid": valid})


def _is_range(text: str) -> bool:
    try:
        first, last, number = text.split(":")
        return 0 <= float(first) < float(last) < float("inf") and int(number) > 1
    except ValueError:
        return False


def _is_best(text: str) -> bool:
    kind, _, number = text.partition(":")
    return text in {"frame", "sequence", "joint"} or (kind == "batch" and number.isdecimal() and int(number) > 0)


@dataclass(frozen=True)
class Protocol:
    """Definition of every metric, as a set of options with the defaults of posecal.

    Every option is listed, with its values, by ``posecal presets``; on the command line ``--set`` takes them.

    Raises
    ------
    PoseDataError
        For values that an option does not take, all at once.

    See Also
    --------
    posecal.engine.presets.PRESETS : The options of published evaluations.

    Examples
    --------
    >>> Protocol(best="sequence").best
    'sequence'
    >>> Protocol(metrics=["ece", "pck"]).metrics
    'ece, pck'
    >>> Protocol(root="keep")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: root: 'keep' is not known. Known: count, drop.
    """

    joints: str = _option("all", "the joints that make up a pose", "all, a joint set, or names with commas")
    root: Literal["count", "drop"] = _option(
        "count", "whether the root counts in means over joints, with its error of 0"
    )
    where: Literal["all", "occluded", "visible"] = _option("all", "the joints that are scored")
    frames: str = _option("all", "the poses that are scored", "all, or a yes/no label such as hard")
    best: str = _option(
        "frame",
        "what one choice of the best hypothesis spans",
        "frame, sequence, batch:k (k sequences) or joint",
        _is_best,
    )
    align: Literal["similarity", "rigid", "reflection"] = _option(
        "similarity", "what Procrustes may change (pa_ metrics)"
    )
    align_best: Literal["own", "linked"] = _option(
        "own", "the hypothesis that a pa_ minimum takes: its own best or minMPJPE's"
    )
    scale: Literal["scale", "norm_root", "rms_mean"] = _option("scale", "how a pose is scaled (n_ metrics)")
    mode: str | int = _option(
        "score",
        "the hypothesis that mode_ metrics take: of the highest score, or of an index",
        "score or the index of a hypothesis",
        lambda mode: mode == "score" or mode.isdecimal(),
    )
    pck_joints: str = _option("h36m-14", "the joints of PCK and AUC, as far as present", "as for joints")
    pck_threshold: float = _option(
        150.0, "the threshold of PCK, mm", "a length in mm", lambda mm: 0 < mm < float("inf")
    )
    pck_rule: Literal["<", "<="] = _option("<", "whether a joint at the threshold is right")
    pck_best: Literal["own", "linked", "mean"] = _option("own", "the hypothesis that PCK and AUC take")
    pck_relative: str = _option(
        "none",
        "the length that the thresholds of PCK and AUC are shares of",
        "none, torso, head, or two joints as LShoulder - RHip",
    )
    auc: Literal["thresholds", "integral", "trapezoid"] = _option(
        "thresholds", "AUC as the mean over thresholds, as an exact integral, or by the trapezoid rule"
    )
    auc_range: str = _option(
        "0:150:31",
        "the thresholds of AUC, mm",
        "first:last:how many (no step), such as 0:50:100",
        lambda text: _is_range(text),
    )
    cps_joints: str = _option("all but Spine", "the joints of CPS", "as for joints, or all but NAME")
    cps_align: Literal["similarity", "none"] = _option("similarity", "how poses are aligned for CPS")
    cps_best: Literal["own", "linked", "mean"] = _option("own", "the hypothesis that CPS takes")
    cps_unit: Literal["mm", "share"] = _option("mm", "CPS as an area in mm or as a share of 300 mm")
    velocity: Literal["frame", "second"] = _option(
        "frame", "MPJVE, acceleration error and jitter per frame or per second"
    )
    segment: str | int = _option(
        "100",
        "the frames that WA- and W-MPJPE align together, from the first of each sequence",
        "a number of frames from 2, or sequence for whole ones",
        lambda text: text == "sequence" or (text.isdecimal() and int(text) > 1),
    )
    deviation: Literal["sample", "population"] = _option("sample", "diversity with n - 1 or with n")
    ece_over: Literal["auto", "median", "mean", "worst", "pooled"] = _option("auto", "over joints, for the ECE")
    single_pose: Literal["mean_pose", "median_pose", "mode"] = _option(
        "mean_pose", "the pose whose error the predicted spread is compared with (AUSE, AURC, failures)"
    )
    failure_threshold: float = _option(
        150.0, "the error of a pose above which it fails, mm", "a length in mm", lambda mm: 0 < mm < float("inf")
    )
    mm_threshold: float = _option(
        500.0,
        "the distance of last observed poses below which clips are one set of truths (mmade, mmfde, apde), mm",
        "a length in mm",
        lambda mm: 0 < mm < float("inf"),
    )
    mm_alone: Literal["count", "drop"] = _option(
        "count", "whether clips that are alone in their set of truths count (mmade, mmfde)"
    )
    average: str = _option(
        "poses", "what the final mean is over", "poses, or a label: the mean of its groups' numbers, or curves"
    )
    trials: Literal["apart", "together"] = _option(
        "apart", "whether labels of average that differ after their first word, such as Walking 1, are one group"
    )
    metrics: str | Sequence[str] = _option(
        "default",
        "the numbers that are reported",
        "default, rank_tests, scores, all, or names with commas",
        lambda text: all(word.strip() for word in text.split(",")),
    )

    def __post_init__(self) -> None:
        normals = {"metrics": _joined, "mode": _text, "segment": _text} | dict.fromkeys(_LENGTHS, _number)
        for name, normal in normals.items():
            object.__setattr__(self, name, normal(getattr(self, name)))
        problems = []
        for option in fields(self):
            value, choices = getattr(self, option.name), CHOICES.get(option.name)
            right = isinstance(value, float if option.name in _LENGTHS else str)
            if choices and not (right and value in choices):
                problems.append(f"{option.name}: {value!r} is not known. {did_you_mean(str(value), choices)}")
            elif not choices and not (right and option.metadata["valid"](value)):
                problems.append(f"{option.name}: {value!r}; expected {option.metadata['form']}.")
        if self.pck_relative != "none" and self.pck_threshold == Protocol.pck_threshold:
            problems.append(
                f"pck_threshold: {self.pck_threshold:g} with pck_relative: {self.pck_relative!r}; expected a share of "
                "it, such as 0.5."
            )
        if self.best != "frame" and self.align_best == "linked":
            problems.append(f"align_best: 'linked' with best: {self.best!r}; expected best: 'frame'.")
        raise_all(problems)

    def changed(self, options: Mapping[str, str]) -> Protocol:
        """Copy this protocol with some options changed, from their text.

        Parameters
        ----------
        options : mapping
            Option names and values.

        Returns
        -------
        Protocol
            The changed protocol.

        Raises
        ------
        PoseDataError
            For options that do not exist and values that they do not take.
        """
        known = [option.name for option in fields(self)]
        raise_all(
            f"option: {name!r} is not known. {did_you_mean(name, known)}" for name in options if name not in known
        )
        values: dict[str, Any] = dict(options)
        return replace(self, **values)

    @property
    def wanted(self) -> tuple[str, ...]:
        """The words of the option ``metrics``, one by one."""
        return tuple(word.strip() for word in str(self.metrics).split(","))

    def asks_for(self, name: str, family: str) -> bool:
        """Whether the option ``metrics`` names a metric, its family, or all; not whether it is a default one."""
        return not {name, family, "all"}.isdisjoint(self.wanted)

    @property
    def summary_over_joints(self) -> OverJoints:
        """The summary of the ECE over joints: by default the median, and pooled where only some joints count."""
        if self.ece_over != "auto":
            return self.ece_over
        return "median" if self.where == "all" else "pooled"

    @property
    def segment_length(self) -> int:
        """The number of frames of a segment; of whole sequences more than there can be."""
        return sys.maxsize if self.segment == "sequence" else int(self.segment)

    @property
    def options(self) -> dict[str, str]:
        """Every option with its value as text."""
        return {option.name: f"{getattr(self, option.name)}" for option in fields(self)}

    @property
    def differences(self) -> dict[str, str]:
        """The options that differ from the defaults, with their values as text."""
        default = Protocol().options
        return {name: value for name, value in self.options.items() if value != default[name]}


def _joined(names: Any) -> Any:
    """Give a list or tuple of names as text, with commas; anything else as it is."""
    listed = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
    return ", ".join(names) if listed else names


def _text(index: Any) -> Any:
    """Give a whole number as text; anything else as it is."""
    return str(index) if isinstance(index, Integral) else index


def _number(value: Any) -> Any:
    """Give a number, or text that is one, as float; anything else as it is."""
    try:
        return value if isinstance(value, bool) or not isinstance(value, str | Real) else float(value)
    except ValueError:
        return value


CHOICES = {
    name: tuple(get_args(hint)) for name, hint in get_type_hints(Protocol).items() if get_origin(hint) is Literal
}
"""The values of each option that takes one of a few."""


def named_joints(option: str, text: str, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Choose from a pose's joints those that an option names.

    Parameters
    ----------
    option : str
        The option's name, for messages.
    text : str
        ``all``, ``all but NAME``, a joint set, or names with commas.
    joints : tuple of str
        The joints that the poses have.

    Returns
    -------
    tuple of str
        The chosen ones, in the poses' order. Members of a joint set that the poses lack are passed over, and so is a
        joint of the human tree to leave out.

    Raises
    ------
    PoseDataError
        Where a name is not among the joints, or nothing is left.
    """
    if text == "all":
        return joints
    if text.startswith("all but "):
        name = text.removeprefix("all but ")
        left_out = find_joint(name, joints)
        if left_out is None and joint_keys((name,))[0] not in REST_POSE:
            raise PoseDataError(f"{option}: {name!r} is no joint. {did_you_mean(name, joints)}")
        return tuple(joint for k, joint in enumerate(joints) if k != left_out)
    if text in JOINT_SETS:
        keys = set(joint_keys(JOINT_SETS[text]))
        chosen = tuple(name for name, key in zip(joints, joint_keys(joints), strict=True) if key in keys)
    else:
        asked = {name.strip(): find_joint(name.strip(), joints) for name in text.split(",")}
        missing = [name for name, index in asked.items() if index is None]
        if missing:
            known = [*joints, *JOINT_SETS]
            raise PoseDataError(
                f"{option}: {missing[0]!r} is not among the poses' joints. {did_you_mean(missing[0], known)}"
            )
        chosen = tuple(joint for k, joint in enumerate(joints) if k in asked.values())
    if not chosen:
        raise PoseDataError(f"{option}: the poses have none of the joints of {text}. They have {', '.join(joints)}.")
    return chosen
