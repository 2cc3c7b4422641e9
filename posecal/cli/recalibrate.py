"""``posecal recalibrate``: fit a spread factor or radii, judge them on held-out sequences, and apply them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, command, progress, say, show
from posecal.errors import for_command_line

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Rescale a model's spread, or find radii that hold the truth, without training it again.",
)


@command(app)
def fit(
    hypotheses: opt.Hypotheses,
    truth: opt.Truth,
    output: opt.Output,
    *,
    per_joint: Annotated[bool, opt.option("One spread factor per joint.", "--per-joint")] = False,
    radius: Annotated[
        float | None, opt.option("Fit radii that hold the truth but for this share, not a factor.", metavar="ALPHA")
    ] = None,
    scaled: Annotated[bool, opt.option("Radii in multiples of the predicted spread.", "--scaled")] = False,
    about: Annotated[
        Literal["median", "modes"], opt.option("What hypotheses are rescaled about: median, or modes where several.")
    ] = "median",
    anyway: Annotated[bool, opt.option("Write the map also where it makes scores worse.", "--anyway")] = False,
    split: Annotated[bool, opt.option("Judge it on held-out sequences, before and after.", "--split")] = False,
    folds: Annotated[int, opt.option("Parts that --split cuts the sequences into.", min=2)] = 5,
    threads: opt.Threads = None,
    data: opt.DataOptions,
) -> None:
    """Fit a recalibration on all poses; --split also says what it does to sequences it has not seen."""
    check_outputs(hypotheses, truth, output=output)
    from posecal import recalibration
    from posecal.recalibration.maps import refuse_objections
    from posecal.recalibration.sheets import radius_sheet, spread_sheet

    if scaled and radius is None:
        raise typer.BadParameter("goes with --radius only.", param_hint="--scaled")
    if per_joint and radius is not None:
        raise typer.BadParameter("radii are per joint always.", param_hint="--per-joint")
    for flag, given in (("--about", about != "median"), ("--anyway", anyway)):
        if given and radius is not None:
            raise typer.BadParameter("goes with a spread factor, not with --radius.", param_hint=flag)
    poses = data.read(hypotheses, truth)
    if radius is None:
        how: dict[str, Any] = {"per_joint": per_joint, "about": about, "threads": threads}
        judged = recalibration.judge_spread(poses, folds=folds, **how) if split else None
        spread = recalibration.fit_spread(poses, **how) if judged is None else judged.fitted
        modes = None if spread.modal else recalibration.find_modes(poses, threads=threads)
        sheet = spread_sheet(spread, judged, modes, spread.data_remarks, for_command_line)
        if not anyway and (spread.objections or (judged is not None and judged.objections)):
            show(sheet)
            if judged is not None:
                refuse_objections(judged.objections, "held-out sequences")
            refuse_objections(spread.objections)
        recalibration.write_map(spread, output, anyway=True)
        show(sheet)
        return
    radii = recalibration.fit_radius(poses, alpha=radius, scaled=scaled, threads=threads)
    coverage = None
    if split:
        shares = recalibration.held_out_coverage(poses, alpha=radius, scaled=scaled, folds=folds, threads=threads)
        coverage = dict(zip(radii.joints, shares.tolist(), strict=True))
    notes = map(for_command_line, radii.data_remarks)
    sheet = radius_sheet(radii.by_joint, radii.poses, radius, radii.unit, coverage, notes)
    recalibration.write_map(radii, output)
    show(sheet)


@command(app)
def apply(
    hypotheses: opt.Hypotheses,
    map_file: Annotated[Path, opt.argument("What fit wrote.", metavar="MAP")],
    output: opt.Output,
    *,
    data: opt.HypothesesOptions,
) -> None:
    """Apply a fitted map: new hypotheses, or the centres and radii of balls."""
    check_outputs(hypotheses, map_file, output=output)
    from posecal.recalibration import apply_map, read_map

    declared = data.given()
    with progress() as bar:
        number = apply_map(read_map(map_file), hypotheses, output, **declared, progress=bar("applying"))
    say(f"{output}: {number:,} poses.")
