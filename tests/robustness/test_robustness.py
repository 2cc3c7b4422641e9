"""No damaged or edited file makes a command fail otherwise than by a refusal."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from tests.robustness.__main__ import described
from tests.robustness.runner import Workshop, outcomes

SEED = 0
COUNT = int(os.environ.get("POSECAL_DAMAGED_FILES", "200"))
"""Of these files; ``python -m tests.robustness`` runs all 20,000, which takes some ten minutes of two cores."""


def test_some_damaged_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shop = Workshop(tmp_path, SEED, libraries=False)
    quick = [number for number in range(165) if "full.npz" not in shop.cases[number % len(shop.cases)].words]
    found = [shop.run(number) for number in quick[:100]]
    assert [described(one, SEED) for one in found if one.is_fault] == []
    assert sum(one.kind == "refused" for one in found) > 50


@pytest.mark.slow
def test_commands_refuse_damaged_files_and_never_fail() -> None:
    found = list(outcomes([*range(COUNT)], SEED, jobs=2))
    faults = [described(one, SEED) for one in found if one.is_fault]
    assert not faults, "\n".join(faults[:20])
    counts = Counter(one.kind for one in found)
    assert sum(counts.values()) == COUNT
    assert counts["refused"] > COUNT / 2
    assert counts["same"] > COUNT / 20
    assert counts["other"] > COUNT / 50


@pytest.mark.slow
def test_a_number_gives_the_same_file_every_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shops = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        shops.append(Workshop(tmp_path / name, SEED))
    assert shops[0].wholes == shops[1].wholes
    for number in range(len(shops[0].cases)):
        assert shops[0].changed(number)[2] == shops[1].changed(number)[2]
