"""Leaderboards of small results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import posecal
from posecal.engine.storage import save_totals
from tests.helpers.comparisons import MODELS, Y, totals_of

METRICS = "min_mpjpe, ece, energy_score, signed_area"

ABOUT: dict[str, Any] = {
    "test_set": "16 people",
    "source": "example.org/model",
    "commit": "v1.0",
    "command": "model sample",
    "data": "Free for all uses.",
}


def saved(path: Path, model: str = "right", **options: str) -> Path:
    save_totals(totals_of(MODELS[model], Y, METRICS, **options), path)
    return path


def board_of(folder: Path, models: tuple[str, ...] = tuple(MODELS)) -> Path:
    """A folder with an entry for each model, and in it the one file of hypotheses that all of them name."""
    hypotheses = folder / "hypotheses"
    hypotheses.write_bytes(b"abc")
    for model in models:
        result = saved(folder / "result", model)
        posecal.add_entry(folder, result, name=model, hypotheses=hypotheses, **ABOUT)
        result.unlink()
    return folder
