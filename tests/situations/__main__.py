"""Write the table of docs/inputs.md anew, by running every situation: ``python -m tests.situations``."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.situations.cases import SITUATIONS, Situation
from tests.situations.run import Outcome, command, of_command_line

PAGE = Path(__file__).parents[2] / "docs/inputs.md"


def row(situation: Situation) -> str:
    """Write the row of a situation."""
    with TemporaryDirectory() as folder:
        right = situation.write(Path(folder))
        outcome = of_command_line(situation, Path(folder))
    cells = (
        situation.name,
        situation.source,
        situation.before,
        f"`{command(situation)}`",
        now(situation, outcome, right),
    )
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def now(situation: Situation, outcome: Outcome, right: dict[str, float]) -> str:
    """Say what posecal gives: the refusal, or the right values and the remark."""
    if outcome.refusal:
        return f"refused: {' '.join(outcome.refusal.removeprefix('posecal: ').split())}"
    values = ", ".join(f"{name} {outcome.values[name]:.1f}" for name in right)
    remarks = [text for text in outcome.remarks if any(words in text for words in situation.says)]
    return ". ".join([values, *(f"“{text}”" for text in remarks)])


def generated(text: str) -> str:
    """Replace what stands between the markers by the table."""
    head = "| situation | threads | posecal 0.1.0 | command | now |\n| --- | --- | --- | --- | --- |"
    table = "\n".join([head, *map(row, SITUATIONS)])
    return re.sub(
        r"(<!-- situations -->\n).*?(<!-- end -->)", lambda m: f"{m[1]}\n{table}\n\n{m[2]}", text, flags=re.DOTALL
    )


if __name__ == "__main__":
    PAGE.write_text(generated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
