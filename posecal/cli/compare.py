"""``posecal compare``: differences of models on the same poses, paired by sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any
from zipfile import is_zipfile

import typer

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, progress, terminal
from posecal.errors import PoseFileError, for_command_line


def compare(
    files: Annotated[
        list[Path], opt.argument("Hypotheses of two or more models and, last, the truth; or two or more saved results.")
    ],
    *,
    labels: opt.Labels = None,
    primary: Annotated[
        str | None, opt.option("Metrics to name the better model by.", show_default="energy_score,ece")
    ] = None,
    scoring: opt.ScoringOptions,
    threads: opt.Threads = None,
    data: opt.DataOptions,
    form: opt.Form = "text",
    plot: Annotated[Path | None, opt.writing("Draw minMPJPE against the ECE: .svg, .png or .pdf.")] = None,
) -> None:
    """Compare models on the same poses: differences with intervals, p-values and ranks."""
    import posecal
    from posecal.engine.presets import as_protocol
    from posecal.engine.storage import is_result

    check_outputs(*files, *(scoring.metric or []), plot=plot)
    results = [path for path in files if is_result(path)]
    others = [path for path in files if path not in results]
    for path in others:
        if (results or len(files) < 3) and path.suffix == ".npz" and not is_zipfile(path):
            posecal.load_totals(path)  # which says what it is instead
    if results and others:
        raise PoseFileError(
            f"{others[0]}: no result of posecal evaluate --save, or a damaged one; {results[0].name} is one. Expected "
            "results alone, without a truth, or hypotheses and, last, the truth."
        )
    saved = not others
    models = files if saved else files[:-1]
    if len(models) < 2:
        raise typer.BadParameter(
            "expected hypotheses of two or more models and, last, the truth; or two or more saved results."
        )
    protocol = None if scoring == opt.ScoringOptions() else scoring.protocol()
    sources: dict[str, Any] = dict(opt.named(models, labels))
    if not saved:
        sources = {name: data.read(path, files[-1], **scoring.matching) for name, path in sources.items()}
        several = all(source.shape[0] > 1 for source in sources.values())
        if protocol and not scoring.metrics and "default" in protocol.wanted and several:
            protocol = as_protocol(protocol, [*protocol.wanted, "scores"])
    with progress() as bar:
        comparison = posecal.compare(
            sources,
            primary=primary,
            protocol=protocol,
            threads=threads,
            progress=lambda name: bar(name, len(sources[name].truth)),
        )
    text = comparison.render(form, **terminal(), words=for_command_line)
    if plot is not None:
        posecal.plot.save(posecal.plot.draw_comparison(comparison), plot)
    typer.echo(text)
