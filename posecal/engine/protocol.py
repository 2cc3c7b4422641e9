"""What exactly is measured? Every choice that papers make differently, each with a name and a default.

The field computes "the same" metric in different ways. A :class:`Protocol` holds one answer to each question; a
*preset* is the set of answers that one published evaluation gives, and fixes nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from posecal.data.skeleton import JOINT_SETS, REST_POSE, canonical_name
from posecal.errors import PoseDataError, did_you_mean, raise_all

__all__ = ["PRESETS", "Preset", "Protocol", "preset"]


def _choice(about: str, *choices: str) -> Any:
    return field(default=choices[0], metadata={"about": about, "choices": choices})


def _free(default: object, about: str, form: str) -> Any:
    return field(default=default, metadata={"about": about, "form": form})


@dataclass(frozen=True)
class Protocol:
    """One answer to each question that a metric's name leaves open. All are options of the command line.

    Every option is listed, with its choices, by ``posecal presets``.

    Raises
    ------
    PoseDataError
        For a value that an option does not take; all such values at once.

    Examples
    --------
    >>> Protocol(best="sequence").best
    'sequence'
    >>> Protocol(root="keep")
    Traceback (most recent call last):
    posecal.errors.PoseDataError: root: 'keep' is not known. Known: count, drop.
    """

    joints: str = _free("all", "the joints that make up a pose", "all, a joint set, or names with commas")
    root: str = _choice("whether the root counts in means over joints, with its error of 0", "count", "drop")
    where: str = _choice("the joints that are scored", "all", "occluded", "visible")
    frames: str = _free("all", "the poses that are scored", "all, or a yes/no label such as hard")
    best: str = _free("frame", "what one choice of the best hypothesis spans", "frame, sequence, batch:k or joint")
    align: str = _choice("what Procrustes may change (pa_ metrics)", "similarity", "rigid", "reflection")
    align_best: str = _choice("the hypothesis that a pa_ minimum takes: its own best or minMPJPE's", "own", "linked")
    scale: str = _choice("how a pose is scaled (n_ metrics)", "scale", "norm_root", "rms_mean")
    mode: str = _free("score", "the hypothesis that mode_ metrics take", "score (the highest), or an index")
    pck_joints: str = _free("h36m-14", "the joints of PCK and AUC, as far as present", "as for joints")
    pck_threshold: float = _free(150.0, "the threshold of PCK, mm", "a number")
    pck_rule: str = _choice("whether a joint at the threshold is right", "<", "<=")
    pck_best: str = _choice("the hypothesis that PCK and AUC take", "own", "linked", "mean")
    auc: str = _choice("AUC over 31 thresholds or as an exact integral", "thresholds", "integral")
    cps_joints: str = _free("all but Spine", "the joints of CPS", "as for joints, or all but NAME")
    cps_align: str = _choice("how poses are aligned for CPS", "similarity", "none")
    cps_best: str = _choice("the hypothesis that CPS takes", "own", "linked", "mean")
    cps_unit: str = _choice("CPS as an area in mm or as a share of 300 mm", "mm", "share")
    velocity: str = _choice("MPJVE per frame or per second", "frame", "second")
    deviation: str = _choice("diversity with n - 1 or with n", "sample", "population")
    ece_over: str = _choice("over joints, for the ECE", "auto", "median", "mean", "worst", "pooled")
    average: str = _free(
        "poses", "what the final mean is over", "poses, or a label: the mean of its groups' numbers, or curves"
    )
    metrics: str = _free("default", "the numbers that are reported", "default, all, or names with commas")

    def __post_init__(self) -> None:
        problems = []
        for option in fields(self):
            value, choices = getattr(self, option.name), option.metadata.get("choices")
            if choices and value not in choices:
                problems.append(f"{option.name}: {value!r} is not known. {did_you_mean(str(value), choices)}")
        kind, _, clips = self.best.partition(":")
        if self.best not in {"frame", "sequence", "joint"} and not (kind == "batch" and _is_count(clips)):
            problems.append(f"best: {self.best!r}; expected frame, sequence, batch:k (k clips) or joint.")
        elif self.best != "frame" and self.align_best == "linked":
            problems.append(f"align_best: 'linked' with best: {self.best!r}; expected best: 'frame'.")
        if self.mode != "score" and not self.mode.isdecimal():
            problems.append(f"mode: {self.mode!r}; expected score or the index of a hypothesis.")
        if not 0 < self.pck_threshold < float("inf"):
            problems.append(f"pck_threshold: {self.pck_threshold}; expected a length in mm.")
        if not all(self.wanted):
            problems.append(f"metrics: {self.metrics!r}; expected default, all, or names with commas.")
        raise_all(problems)

    def changed(self, options: Mapping[str, str]) -> Protocol:
        """Give this protocol with some options changed, from their text.

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
            For an option that does not exist or a value that it does not take.
        """
        known = {option.name: option for option in fields(self)}
        unknown = [
            f"option: {name!r} is not known. {did_you_mean(name, known)}" for name in options if name not in known
        ]
        raise_all(unknown)
        values: dict[str, str | float] = dict(options)
        if "pck_threshold" in options:
            try:
                values["pck_threshold"] = float(options["pck_threshold"])
            except ValueError:
                raise PoseDataError(f"pck_threshold: {options['pck_threshold']!r}; expected a length in mm.") from None
        return replace(self, **values)  # type: ignore[arg-type]

    @property
    def wanted(self) -> tuple[str, ...]:
        """The words of the option ``metrics``, one by one."""
        return tuple(word.strip() for word in self.metrics.split(","))

    @property
    def summary_over_joints(self) -> str:
        """What the ECE takes over joints: the paper's median, or its one column where only some joints count."""
        if self.ece_over != "auto":
            return self.ece_over
        return "median" if self.where == "all" else "pooled"

    @property
    def options(self) -> dict[str, str]:
        """Every option with its value as text."""
        return {option.name: f"{getattr(self, option.name)}" for option in fields(self)}

    @property
    def differences(self) -> dict[str, str]:
        """The options that differ from the defaults, with their values as text."""
        default = Protocol().options
        return {name: value for name, value in self.options.items() if value != default[name]}


def _is_count(text: str) -> bool:
    return text.isdecimal() and int(text) > 0


@dataclass(frozen=True)
class Preset:
    """The explicit options of one published evaluation.

    Attributes
    ----------
    name : str
        What ``--preset`` takes.
    source : str
        The repository that it follows.
    options : dict
        The options that it sets; all others stay at their defaults.
    note : str
        What no option can say.
    """

    name: str
    source: str
    options: dict[str, str]
    note: str = ""

    @property
    def protocol(self) -> Protocol:
        """The defaults with this preset's options."""
        return Protocol().changed(self.options)


_ERRORS_OF_N = "min_mpjpe, mpjpe, median_mpjpe, worst_mpjpe"
_PA_ERRORS_OF_N = "pa_min_mpjpe, pa_mpjpe, pa_median_mpjpe, pa_worst_mpjpe"

PRESETS: dict[str, Preset] = {
    found.name: found
    for found in (
        Preset(
            "cgnf",
            "sinzlab/cGNF",
            {"joints": "h36m-17", "metrics": "min_mpjpe, pa_min_mpjpe, ece_reference"},
            "ECE over the 16 joints without the root. N = 200. Its script's PCK asks for all 14 joints at once.",
        ),
        Preset(
            "cgnf-occluded",
            "sinzlab/cGNF",
            {
                "joints": "h36m-16",
                "root": "drop",
                "where": "occluded",
                "ece_over": "pooled",
                "metrics": "min_mpjpe, ece_reference",
            },
            "Mean over a pose's occluded joints first; poses without one drop out. N = 200.",
        ),
        Preset(
            "prohpe",
            "twehrbein/Probabilistic-Monocular-3D-Human-Pose-Estimation-with-Normalizing-Flows",
            {
                "joints": "h36m-17",
                "average": "action",
                "metrics": f"{_ERRORS_OF_N}, pa_min_mpjpe, diversity",
            },
            "Every 64th frame of S9 and S11. N = 200. The median error is the lower of the two middle ones there.",
        ),
        Preset(
            "prohpe-h36ma",
            "twehrbein/Probabilistic-Monocular-3D-Human-Pose-Estimation-with-Normalizing-Flows",
            {
                "joints": "h36m-17",
                "frames": "hard",
                "metrics": f"{_ERRORS_OF_N}, pa_min_mpjpe, pck, cps",
            },
            "Needs a label hard: frames in which a keypoint's fitted σ exceeds 5 px. Pooled over all hard frames.",
        ),
        Preset(
            "diffpose",
            "bastianwandt/DiffPose",
            {
                "joints": "h36m-17",
                "scale": "norm_root",
                "average": "action",
                "metrics": f"{_ERRORS_OF_N}, {_PA_ERRORS_OF_N}, n_min_mpjpe, pck, cps",
            },
            "n_min_mpjpe is its protocol I-SC. N = 200.",
        ),
        Preset(
            "platypose",
            "sinzlab/platypose",
            {
                "joints": "h36m-17",
                "best": "sequence",
                "average": "sequence",
                "metrics": "min_mpjpe, ece_reference",
            },
            "One hypothesis per clip; a clip is a sequence. Its script's ECE takes the median over all 17 joints, the "
            "root's row of zeros among them; here it is over the 16 that move.",
        ),
        Preset(
            "d3dp-jbest",
            "paTRICK-swk/D3DP",
            {"joints": "h36m-17", "best": "joint", "average": "action", "metrics": "min_mpjpe, pa_min_mpjpe"},
            "J-Best: the best hypothesis of every joint, which needs the truth at every joint.",
        ),
        Preset(
            "d3dp-pbest",
            "paTRICK-swk/D3DP",
            {"joints": "h36m-17", "best": "batch:4", "average": "action", "metrics": "min_mpjpe, pa_min_mpjpe"},
            "P-Best: one hypothesis per batch; its evaluation command takes 4 clips a batch, and the number "
            "changes with them.",
        ),
        Preset(
            "d3dp-pagg",
            "paTRICK-swk/D3DP",
            {"joints": "h36m-17", "average": "action", "metrics": "mean_pose_mpjpe, pa_mean_pose_mpjpe"},
            "P-Agg: the error of the mean of the hypotheses.",
        ),
        Preset(
            "manipose-oracle",
            "cedricrommel/manipose",
            {
                "joints": "h36m-17",
                "pck_joints": "all",
                "metrics": "min_mpjpe, pa_min_mpjpe, pck, weighted_pose_mpjpe",
            },
            "Without test-time flips, which average two winners. Its headline is weighted_pose_mpjpe: needs scores.",
        ),
        Preset(
            "gfpose",
            "Embracing/GFPose",
            {
                "joints": "h36m-17",
                "align": "reflection",
                "deviation": "population",
                "average": "action",
                "metrics": "min_mpjpe, pa_min_mpjpe, diversity",
            },
            "N = 200. On mirrored depth, alignment with reflections gives much smaller errors.",
        ),
        Preset(
            "prohmr-14",
            "nkolot/ProHMR",
            {
                "joints": "h36m-14",
                "root": "drop",
                "mode": "0",
                "metrics": "min_mpjpe, pa_min_mpjpe, mode_mpjpe, pa_mode_mpjpe",
            },
            "The pelvis is subtracted and is not among the 14 joints; hypothesis 0 is the mode.",
        ),
        Preset(
            "videopose3d",
            "facebookresearch/VideoPose3D",
            {"joints": "h36m-17", "average": "action", "metrics": "mpjpe, pa_mpjpe, n_mpjpe, mpjve"},
            "One hypothesis per frame.",
        ),
    )
}
"""Published evaluations by name."""


def preset(name: str) -> Preset:
    """Give a preset by its name.

    Parameters
    ----------
    name : str
        A key of :data:`PRESETS`.

    Returns
    -------
    Preset
        Its options and source.

    Raises
    ------
    PoseDataError
        Where no preset has this name.

    Examples
    --------
    >>> preset("d3dp-jbest").options["best"]
    'joint'
    """
    if name not in PRESETS:
        raise PoseDataError(f"preset: {name!r} is not known. {did_you_mean(name, PRESETS)}")
    return PRESETS[name]


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
        left_out = canonical_name(text.removeprefix("all but "))
        if left_out not in {*joints, *REST_POSE}:
            raise PoseDataError(f"{option}: {left_out!r} is no joint. {did_you_mean(left_out, joints)}")
        return tuple(name for name in joints if name != left_out)
    asked = JOINT_SETS.get(text) or tuple(canonical_name(name.strip()) for name in text.split(","))
    missing = [name for name in asked if name not in joints]
    if text not in JOINT_SETS and missing:
        known = [*joints, *JOINT_SETS]
        raise PoseDataError(
            f"{option}: {missing[0]!r} is not among the poses' joints. {did_you_mean(missing[0], known)}"
        )
    chosen = tuple(name for name in joints if name in asked)
    if not chosen:
        raise PoseDataError(f"{option}: the poses have none of the joints of {text}. They have {', '.join(joints)}.")
    return chosen
