"""What is on the sheet of the presets? Every option that each sets, then all options."""

from __future__ import annotations

from dataclasses import fields

from posecal.engine.protocol import PRESETS, Protocol
from posecal.report.tables import Sheet, Table

__all__ = ["presets_sheet"]


def presets_sheet() -> Sheet:
    """Lay out the presets with every option that they set, then all options."""
    presets: list[tuple[str, ...]] = [
        (preset.name, preset.source, "\n".join(f"{k} = {v}" for k, v in preset.options.items()), preset.note)
        for preset in PRESETS.values()
    ]
    options: list[tuple[str, ...]] = [
        (
            option.name,
            str(option.default),
            " | ".join(option.metadata["choices"]) if "choices" in option.metadata else option.metadata["form"],
            option.metadata["about"],
        )
        for option in fields(Protocol)
    ]
    return Sheet(
        "Published protocols, each with the options that it sets, and all options",
        tables=[
            Table("Presets", (("preset", False), ("follows", False), ("sets", False), ("note", False)), presets),
            Table(
                "Options", (("option", False), ("default", False), ("values", False), ("what it says", False)), options
            ),
        ],
    )
