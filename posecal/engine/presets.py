"""Presets: the options that published evaluations fix, each under a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from posecal.engine.protocol import Protocol
from posecal.errors import PoseDataError, did_you_mean


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
    entry.name: entry
    for entry in (
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


def as_protocol(protocol: Protocol | str | None, metrics: str | Sequence[str] | None = None) -> Protocol:
    """Give the options of a preset or a protocol, with other metrics where they are given.

    Raises
    ------
    PoseDataError
        For what is no protocol, and for values that an option does not take.
    """
    if isinstance(protocol, str):
        protocol = preset(protocol).protocol
    if not isinstance(protocol, Protocol | None):
        raise PoseDataError(f"protocol: {type(protocol).__name__}; expected a Protocol or the name of a preset.")
    protocol = protocol or Protocol()
    return protocol if metrics is None else replace(protocol, metrics=metrics)
