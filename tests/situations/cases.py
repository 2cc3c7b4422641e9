"""The situations: a public thread, data of the same kind, the call, the right values and the words to say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.situations.data import (
    Values,
    confidence_column,
    empty_predictions,
    exchanged_sides,
    fill_values,
    hand,
    horizons,
    lost_markers,
    lost_truth,
    midpoint_root,
    negated_axes,
    one_prediction,
    open_layout,
    overflow,
    padded_hypotheses,
    padded_with_nan,
    pixels,
    repeated_frames,
    repeated_joints,
    root_alone,
    several_faults,
    smpl_names,
    trials,
    undeclared_metres,
)


@dataclass(frozen=True)
class Situation:
    """A situation from a public thread.

    Attributes
    ----------
    name : str
        What it is called in the table.
    source : str
        The threads.
    before : str
        What posecal 0.1.0 said.
    write : callable
        Writes ``hyps.npz`` and ``gt.npz`` into a folder, and gives the right values by metric.
    options : dict
        Parameters of :func:`posecal.evaluate`; on the command line they are flags.
    says : tuple of str
        What a remark or the refusal must hold.
    is_refused : bool
        Whether the right answer is a refusal.
    """

    name: str
    source: str
    before: str
    write: Callable[[Path], Values]
    options: dict[str, Any] = field(default_factory=dict)
    says: tuple[str, ...] = ()
    is_refused: bool = False


SITUATIONS = (
    Situation(
        "Action labels with trials",
        "facebookresearch/VideoPose3D 98, 216",
        "trials counted as actions: 104.2 for 90.2 mm",
        trials,
        {"protocol": "prohpe"},
    ),
    Situation(
        "Axes of another camera",
        "SeanChenxy/HandMesh 86",
        '"Overconfident, beyond chance"',
        negated_axes,
        says=("coordinate frames differ: negating y and z in hyps.npz",),
    ),
    Situation(
        "Left and right exchanged",
        "una-dinosauria/human-motion-prediction 46",
        '"Overconfident, beyond chance"',
        exchanged_sides,
        says=("coordinate frames differ: exchanging left and right joints in hyps.npz",),
    ),
    Situation(
        "A confidence as fourth column",
        "SangHunHan92/2K2K 34, CMU-Perceptual-Computing-Lab/panoptic-toolbox 34",
        "the confidence counted as a coordinate: 420.9 for 101.4 mm",
        confidence_column,
        says=("confidence",),
        is_refused=True,
    ),
    Situation(
        "People without a prediction, as zeros",
        "naver/multi-hmr 9, 52",
        "no remark: 117.2 for 73.7 mm",
        empty_predictions,
        says=("one point", "11 of 100"),
    ),
    Situation(
        "Joints that repeat others",
        "jutanke/mocap 8, 705062791/PGBIG 6",
        "no remark: 89.3 for 98.6 mm",
        repeated_joints,
        {"root_joint": 0},
        says=("joint 17", "joint 18", "joint 19"),
    ),
    Situation(
        "Lost markers, the root among them",
        "perfanalytics/pose2sim 95, 143; DeepLabCut/DeepLabCut 1650",
        "refused for the root, under another joint's name",
        lost_markers,
        says=("Hip", "8 "),
    ),
    Situation(
        "One prediction of each frame",
        "freemocap/freemocap 286, Walter0807/MotionBERT 59",
        "refused, and no flag led out",
        one_prediction,
        {"axes": "MKD"},
    ),
    Situation(
        "SMPL's names",
        "yohanshin/WHAM 67, shubham-goel/4D-Humans 64",
        '"names joints more than once"',
        smpl_names,
    ),
    Situation(
        "Keypoints in pixels",
        "calvinyeungck/AthletePose3D 3",
        "the default report refused; pixels printed as mm",
        pixels,
        {"root_joint": "none"},
        says=("left out",),
    ),
    Situation(
        "Best of a clip, read at a horizon",
        "waymo-research/waymo-open-dataset 559, huang-xx/STGAT 3",
        "chosen anew in each group, under a caption that says per sequence: 40.5 for 80.5 mm",
        horizons,
        {"by": "step", "metrics": "min_mpjpe", "protocol": {"best": "sequence"}},
    ),
    Situation(
        "No pelvis among 14 joints",
        "eth-ait/emdb 3, facebookresearch/sam-3d-body 111",
        "positions as given: 108.5 for 67.3 mm",
        midpoint_root,
        says=("midpoint",),
    ),
    Situation(
        "The root's own error",
        "mks0601/3DMPPE_POSENET_RELEASE 10",
        '"pck_joints: none is left", though no PCK was asked for',
        root_alone,
        {"root_joint": "none", "metrics": "mpjpe, min_mpjpe", "protocol": {"joints": "Hip"}},
    ),
    Situation(
        "AUC of hands, 0 to 50 mm",
        "SeanChenxy/HandMesh 35, kaist-ami/FastMETRO 12",
        "only up to 150 mm: 0.885 for 0.695",
        hand,
        {
            "unit": "m",
            "root_joint": 0,
            "metrics": "mpjpe, min_mpjpe, auc",
            "protocol": {"pck_joints": "all", "auc_range": "0:50:100", "auc": "trapezoid"},
        },
    ),
    Situation(
        "Hypotheses padded with zeros of weight 0",
        "mixtures and detectors with a varying N",
        "the padding counted: 242.5 for 103.4 mm",
        padded_hypotheses,
        {"metrics": "mpjpe, min_mpjpe"},
        says=("absent",),
    ),
    Situation(
        "Hypotheses padded with NaN",
        "mixtures and detectors with a varying N",
        "refused, with no way to say that a hypothesis is absent",
        padded_with_nan,
        {"metrics": "mpjpe, min_mpjpe"},
        says=("absent",),
    ),
    Situation(
        "As many hypotheses as poses, batch first",
        "loaders that give (M, N, K, D)",
        "in Python read as (N, M, K, D): 75.6 for 60.0 mm",
        open_layout,
        says=("N = M = 20", "MNKD", "NMKD"),
        is_refused=True,
    ),
    Situation(
        "Metres that declare no unit",
        "most loaders of Human3.6M and 3DPW",
        'in Python PCK 1.0 and minMPJPE 0.064 "mm"',
        undeclared_metres,
        says=("looks like metres",),
        is_refused=True,
    ),
    Situation(
        "Joints as a fill value",
        "detectors that write -1000 or 9999 for what they did not find",
        "no remark",
        fill_values,
        says=(
            "gt.npz: joints are exactly -1000 in 3 of 40 poses",
            "hyps.npz: joints are exactly -1000 in 40",
        ),
    ),
    Situation(
        "One hypothesis that overflowed",
        "flows and diffusion models in half precision",
        "MPJPE inf, no remark; at 1e19 a perfect sampler is underconfident",
        overflow,
        says=("beyond 10 km", "frame 11, joint LFoot"),
        is_refused=True,
    ),
    Situation(
        "True poses that are one point",
        "naver/multi-hmr 9, with zeros in the truth",
        "zeros are scored: PA-minMPJPE from 59.5 to 49.1 mm",
        lost_truth,
        says=("in 2 of 40 frames (first: 5, 17) all joints lie in one point",),
        is_refused=True,
    ),
    Situation(
        "Layout, names, labels and frame rate wrong at once",
        "first calls",
        "one error a call, over four calls",
        several_faults,
        says=("tell the axes apart", "9 joints named for K = 17", "sequence has 3 values for 20", "fps: -25"),
        is_refused=True,
    ),
    Situation(
        "Frames that fill the last batch",
        "PyTorch's DistributedSampler",
        "counted twice, no remark",
        repeated_frames,
        says=("3 of 40 frames with truth and labels of another count twice",),
    ),
)
