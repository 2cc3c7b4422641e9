"""``posecal recalibrate``: mend the spread, or find radii that hold; fit, judge on held-out sequences, apply."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from posecal.cli.options import (
    Axes,
    Hypotheses,
    JointNames,
    Missing,
    MissingFrames,
    Output,
    RootJoint,
    Threads,
    Truth,
    TruthAxes,
    TruthUnit,
    Unit,
    option,
)
from posecal.cli.running import check_outputs, guarded, join_of, progress, read_pairs, say

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Mend a model's spread, or find radii that hold the truth, without training it again.",
)


@app.command()
@guarded
def fit(
    hypotheses: Hypotheses,
    truth: Truth,
    output: Output,
    per_joint: Annotated[bool, option("One spread factor per joint.", "--per-joint")] = False,
    radius: Annotated[
        float | None, option("Fit radii that hold the truth but for this share, instead of a factor.", metavar="ALPHA")
    ] = None,
    scaled: Annotated[bool, option("Radii in multiples of the predicted spread.", "--scaled")] = False,
    split: Annotated[bool, option("Judge it on held-out sequences, before and after.", "--split")] = False,
    folds: Annotated[int, option("Parts that --split cuts the sequences into.", min=2)] = 5,
    axes: Axes = None,
    truth_axes: TruthAxes = None,
    unit: Unit = None,
    truth_unit: TruthUnit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
    missing: MissingFrames = Missing.error,
    threads: Threads = None,
) -> None:
    """Fit a recalibration on all poses; --split also says what it does to sequences it has not seen."""
    check_outputs(hypotheses, truth, output=output)
    from posecal.recalibration import cross_fitted, fit_radius, fit_spread, held_out_coverage, write_map
    from posecal.report.sheets import radius_sheet, spread_sheet

    if scaled and radius is None:
        raise typer.BadParameter("goes with --radius only.", param_hint="--scaled")
    if per_joint and radius is not None:
        raise typer.BadParameter("radii are per joint always.", param_hint="--per-joint")
    how = join_of(axes, truth_axes, unit, truth_unit, joint_names, root_joint, missing)
    pairs = read_pairs(hypotheses, truth, how)
    if radius is not None:
        radii = fit_radius(pairs, radius, scaled=scaled, threads=threads)
        held = held_out_coverage(pairs, radius, scaled=scaled, folds=folds, threads=threads) if split else None
        write_map(radii, output)
        say(radius_sheet(radii, held))
        return
    found = fit_spread(pairs, per_joint=per_joint, threads=threads)
    judged = cross_fitted(pairs, folds=folds, per_joint=per_joint, threads=threads) if split else None
    write_map(found, output)
    say(spread_sheet(found, judged))


@app.command()
@guarded
def apply(
    hypotheses: Hypotheses,
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="What fit wrote.", show_default=False)],
    output: Output,
    axes: Axes = None,
    unit: Unit = None,
    joint_names: JointNames = None,
    root_joint: RootJoint = None,
) -> None:
    """Apply a fitted map: new hypotheses, or the centres and radii of balls."""
    how = join_of(axes, unit=unit, joint_names=joint_names, root_joint=root_joint)
    check_outputs(hypotheses, map_file, output=output)
    from posecal.data.match import alone
    from posecal.data.read import read_poses
    from posecal.recalibration import apply_map, read_map

    map_ = read_map(map_file)
    poses = read_poses(hypotheses, "hypotheses")
    stored, joints, root = alone(poses, how)
    with progress(len(stored.rows), "applying") as advance:
        apply_map(map_, stored, joints, root, len(stored.rows), output, poses.beside, advance)
    typer.echo(f"{output}: {len(stored.rows):,} poses.", err=True)
