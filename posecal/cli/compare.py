"""``posecal compare``: differences of models on the same poses, paired by sequence."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated, Any

import typer

from posecal.cli.options import (
    WRITING,
    Form,
    Formats,
    MetricNames,
    OwnMetrics,
    PresetName,
    Scored,
    Settings,
    Threads,
    describes_data,
    option,
)
from posecal.cli.running import check_outputs, guarded, own_metrics, progress, protocol_of, read_data, show


@describes_data()
@guarded
def compare(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Hypotheses of two or more models and, last, the truth; or two or more saved results.",
            show_default=False,
        ),
    ],
    described: dict[str, Any],
    where: Scored = None,
    metrics: MetricNames = None,
    metric: OwnMetrics = None,
    preset: PresetName = None,
    settings: Settings = None,
    form: Formats = Form.text,
    plot: Annotated[Path | None, option("Draw minMPJPE against the ECE: .svg, .png or .pdf.", panel=WRITING)] = None,
    threads: Threads = None,
) -> None:
    """Compare models on the same poses: differences with intervals, p-values and ranks."""
    import posecal
    from posecal.engine.storage import is_result

    check_outputs(*files, plot=plot)
    truth = None if all(map(is_result, files)) else files[-1]
    models = files if truth is None else files[:-1]
    if len(models) < 2:
        raise typer.BadParameter(
            "expected hypotheses of two or more models and, last, the truth; or two or more saved results."
        )
    added = own_metrics(metric or [])
    asked = any(option is not None for option in (preset, settings, where, metrics)) or added
    protocol = protocol_of(preset, settings or [], where, None, metrics, added) if asked else None
    names = _names(models)
    sources: dict[str, Any] = dict(zip(names, models, strict=True))
    if truth is not None:
        sources = {name: read_data(path, truth, described) for name, path in sources.items()}
    with contextlib.ExitStack() as bars:
        comparison = posecal.compare(
            sources,
            protocol=protocol,
            threads=threads,
            progress=lambda name: bars.enter_context(progress(len(sources[name].truth), name)),
        )
    if plot is not None:
        from posecal.plot import draw_comparison, save

        save(draw_comparison(comparison), plot)
    if form in {Form.text, Form.markdown}:
        from posecal.report.text import comparison_sheet

        show(comparison_sheet(comparison), form)
    else:
        typer.echo(comparison.render(form.value))


def _names(files: list[Path]) -> list[str]:
    """Call models by their files' names, or by their paths where two files are called alike."""
    stems = [path.stem for path in files]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in files]
    return [name if names.index(name) == k else f"{name} #{k + 1}" for k, name in enumerate(names)]
