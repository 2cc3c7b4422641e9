"""``posecal leaderboard``: models compared by saved results alone, and entries that are added."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, command, of_results, say, terminal
from posecal.errors import for_command_line

SHOW = "show"


class _ShowByDefault(TyperGroup):
    """Commands of which ``show`` is meant where none is named."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``show`` before arguments that begin with no command."""
        is_named = bool(args) and (args[0] in self.commands or args[0] in self.get_help_option_names(ctx))
        return super().parse_args(ctx, args if is_named else [SHOW, *args])


app = typer.Typer(
    cls=_ShowByDefault,
    rich_markup_mode="rich",
    help="Compare models by saved results alone: [bold]posecal leaderboard FOLDER[/bold]; or add one to a folder.",
)


@command(app, SHOW)
def show_leaderboard(
    folder: Annotated[Path, typer.Argument(help="Entries: a .toml and a .npz of each model.")] = Path(),
    *,
    form: opt.Form = "text",
    plot: Annotated[Path | None, opt.writing("Draw minMPJPE against the ECE: .svg, .png or .pdf.")] = None,
) -> None:
    """Show the models of each test set, best first, with intervals and tests; needs no hypotheses and no truth."""
    check_outputs(plot=plot)
    import posecal

    with of_results(folder):
        board = posecal.leaderboard(folder)
        text = board.render(form, **terminal(), words=for_command_line)
        if plot is not None:
            posecal.plot.save(posecal.plot.draw_comparison(board.comparisons), plot)
    typer.echo(text)


@command(app)
def add(
    folder: Annotated[Path, opt.argument("The leaderboard.")],
    *,
    result: Annotated[Path, opt.option("A result of evaluate --save.", "--from", show_default=False)],
    hypotheses: Annotated[Path, opt.option("The hypotheses; their SHA-256 is kept.", show_default=False)],
    name: Annotated[str, opt.option("The model.", show_default=False)],
    test_set: Annotated[str, opt.option("What it was evaluated on.", show_default=False)],
    source: Annotated[str, opt.option("Where the model is found.", show_default=False)],
    commit: Annotated[str, opt.option("The commit or release of the source.", show_default=False)],
    made_by: Annotated[
        list[str], opt.option("A command of those that made them. Repeatable.", "--command", show_default=False)
    ],
    data: Annotated[str, opt.option("Acknowledgement or licence of the data.", show_default=False)],
    preset: Annotated[str, opt.option("The published protocol of the result.", show_default="none")] = "",
) -> None:
    """Add a model, or replace its entry: everything is checked, then two files are written."""
    import posecal

    about = {"name": name, "test_set": test_set, "source": source, "commit": commit, "data": data, "preset": preset}
    with of_results(result):
        written = posecal.add_entry(folder, result, hypotheses=hypotheses, command=made_by, **about)
    say(f"{written} and {written.with_suffix('.npz').name}.")
