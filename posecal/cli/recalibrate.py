"""``posecal recalibrate``: fit a spread factor or radii, judge them on held-out sequences, and apply them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from posecal.cli.options import Hypotheses, Output, Threads, Truth, describes_data, option
from posecal.cli.running import check_outputs, guarded, progress, read_data, show, wrong_call

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Rescale a model's spread, or find radii that hold the truth, without training it again.",
)


@app.command()
@describes_data()
@guarded
def fit(
    hypotheses: Hypotheses,
    truth: Truth,
    output: Output,
    described: dict[str, Any],
    per_joint: Annotated[bool, option("One spread factor per joint.", "--per-joint")] = False,
    radius: Annotated[
        float | None, option("Fit radii that hold the truth but for this share, instead of a factor.", metavar="ALPHA")
    ] = None,
    scaled: Annotated[bool, option("Radii in multiples of the predicted spread.", "--scaled")] = False,
    split: Annotated[bool, option("Judge it on held-out sequences, before and after.", "--split")] = False,
    folds: Annotated[int, option("Parts that --split cuts the sequences into.", min=2)] = 5,
    threads: Threads = None,
) -> None:
    """Fit a recalibration on all poses; --split also says what it does to sequences it has not seen."""
    check_outputs(hypotheses, truth, output=output)
    from posecal import recalibration
    from posecal.report.text import radius_sheet, spread_sheet

    if scaled and radius is None:
        raise typer.BadParameter("goes with --radius only.", param_hint="--scaled")
    if per_joint and radius is not None:
        raise typer.BadParameter("radii are per joint always.", param_hint="--per-joint")
    data = read_data(hypotheses, truth, described)
    if radius is not None:
        options: dict[str, Any] = {"alpha": radius, "scaled": scaled, "threads": threads}
        radii = recalibration.fit_radius(data, **options)
        coverage = recalibration.held_out_coverage(data, **options, folds=folds) if split else None
        recalibration.write_map(radii, output)
        by_joint = dict(zip(radii.joints, radii.radii.tolist(), strict=True))
        held_out = None if coverage is None else dict(zip(radii.joints, coverage.tolist(), strict=True))
        unit = "standard deviations" if scaled else "mm"
        show(radius_sheet(by_joint, radii.poses, radius, unit, held_out))
        return
    spread = recalibration.fit_spread(data, per_joint=per_joint, threads=threads)
    judged = None
    if split:
        before, after, factors = recalibration.cross_fitted(data, folds=folds, per_joint=per_joint, threads=threads)
        judged = before, after, len(factors)
    recalibration.write_map(spread, output)
    show(spread_sheet(dict(zip(spread.joints, spread.factors.tolist(), strict=True)), spread.poses, judged))


@app.command()
@describes_data("axes", "unit", "joints", "root_joint")
@guarded
def apply(
    hypotheses: Hypotheses,
    map_file: Annotated[Path, typer.Argument(metavar="MAP", help="What fit wrote.", show_default=False)],
    output: Output,
    described: dict[str, Any],
) -> None:
    """Apply a fitted map: new hypotheses, or the centres and radii of balls."""
    check_outputs(hypotheses, map_file, output=output)
    from posecal.data.declarations import Declarations
    from posecal.data.match import resolve_hypotheses
    from posecal.data.read import read_poses
    from posecal.recalibration import apply_map, read_map

    with wrong_call():
        declarations = Declarations(**described)
    map_ = read_map(map_file)
    poses = read_poses(hypotheses, "hypotheses")
    stored, joints, root = resolve_hypotheses(poses, declarations)
    with progress(len(stored.rows), "applying") as advance:
        apply_map(map_, stored, joints, root, len(stored.rows), output, poses.frame_members, advance)
    typer.echo(f"{output}: {len(stored.rows):,} poses.", err=True)
