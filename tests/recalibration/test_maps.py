"""Maps are written and read as JSON, and broken files are refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posecal.errors import PoseFileError
from posecal.recalibration import RadiusMap, SpreadMap, maps, read_map, write_map

Array = np.ndarray
JOINTS = ("Hip", "Head", "LFoot")
SPREAD = SpreadMap(JOINTS, np.array([1.0, 0.7, 2.125]), 120, 6, 0)
RADIUS = RadiusMap(JOINTS, np.array([math.nan, 80.5, 120.25]), 0.1, False, 120, 6)


MAPS = {
    "spread": SPREAD,
    "mm": RADIUS,
    "deviations": replace(RADIUS, scaled=True),
    "about modes": replace(SPREAD, modal=("Head", "LFoot"), changes={"crps": (18.0, 17.5), "signed_area": (-0.1, 0.0)}),
    "degrees": replace(SPREAD, data_unit="deg"),
    "pixels": replace(RADIUS, data_unit="px"),
    "no unit": replace(RADIUS, data_unit=""),
}


@pytest.mark.parametrize("map_", MAPS.values(), ids=MAPS)
def test_a_map_that_is_written_is_read_as_it_was(map_: SpreadMap | RadiusMap, tmp_path: Path) -> None:
    write_map(map_, tmp_path / "map.json")
    found = read_map(tmp_path / "map.json")
    assert type(found) is type(map_)
    for name, value in vars(map_).items():
        np.testing.assert_array_equal(getattr(found, name), value)


def test_a_person_can_read_it(tmp_path: Path) -> None:
    write_map(RADIUS, tmp_path / "map.json")
    found = json.loads((tmp_path / "map.json").read_text())
    assert found["kind"] == "radius"
    assert found["format"] == 4
    assert found["radii"] == {"Hip": None, "Head": 80.5, "LFoot": 120.25}
    assert (found["alpha"], found["unit"]) == (0.1, "mm")
    assert found["fitted_on"] == {"poses": 120, "sequences": 6}
    assert found["root"] is None
    write_map(SPREAD, tmp_path / "map.json")
    found = json.loads((tmp_path / "map.json").read_text())
    assert (found["factors"], found["root"]) == ({"Hip": 1.0, "Head": 0.7, "LFoot": 2.125}, "Hip")


def broken(kind: str, /, **changed: Any) -> str:
    """A map of which something is otherwise, with the digest of what it holds."""
    about: dict[str, Any] = {"format": 4, "kind": kind, "root": None, "fitted_on": {"poses": 9, "sequences": 3}}
    about["unit"] = "mm"
    if kind == "radius":
        about |= {"alpha": 0.1, "scaled": False, "radii": {"Head": 80.0}}
    else:
        about |= {"factors": {"Head": 1.5}, "about_modes": [], "changes": {}}
    about |= changed
    about = {key: value for key, value in about.items() if value is not ...}
    return json.dumps({**about, "digest": maps._digest(about)})


NO_MAP = r"map\.json: no map of posecal recalibrate fit, or not a whole one"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", NO_MAP),
        ("{", NO_MAP),
        ("[]", NO_MAP),
        ("3", NO_MAP),
        (broken("spread")[:40], NO_MAP),
        (broken("spread", format=3), r"map\.json: format 3; expected 4\. Fit it again"),
        (broken("spread", format=1), r"map\.json: format 1; expected 4\. Fit it again"),
        (broken("spread", format=...), NO_MAP),
        (broken("spread", kind=...), NO_MAP),
        (broken("radius", kind="square"), NO_MAP),
        (broken("spread", factors=...), NO_MAP),
        (broken("spread", factors=[1.5]), NO_MAP),
        (broken("spread", factors={"Head": "wide"}), NO_MAP),
        (broken("spread", factors={"Head": 0}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": -1.5}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": None}), r"a factor is not above 0"),
        (broken("spread", factors={"Head": math.inf}), r"a factor is not above 0"),
        (broken("spread", fitted_on=...), NO_MAP),
        (broken("spread", about_modes=...), NO_MAP),
        (broken("spread", about_modes=["Hip"]), r"about_modes names joints without a factor"),
        (broken("spread", changes=...), NO_MAP),
        (broken("spread", changes={"crps": 3}), NO_MAP),
        (broken("spread", root=...), NO_MAP),
        (broken("spread", root="Tail"), NO_MAP),
        (broken("radius", radii=...), NO_MAP),
        (broken("radius", radii={"Head": -1}), r"a radius is below 0 or alpha is 0\.1"),
        (broken("radius", radii={"Head": math.inf}), r"a radius is below 0"),
        (broken("radius", radii={"Head": 80, "Hip": -1, "LFoot": None}), r"a radius is below 0"),
        (broken("radius", radii={"Head": 80, "Hip": math.inf, "LFoot": None}), r"a radius is below 0"),
        (broken("spread", factors={"Head": 1, "Hip": -1}), r"a factor is not above 0"),
        (broken("radius", alpha=0), r"alpha is 0; expected 0 < alpha < 1"),
        (broken("radius", alpha=-0.5), r"alpha is -0\.5; expected"),
        (broken("radius", alpha=1), r"alpha is 1; expected"),
        (broken("radius", unit="cm"), NO_MAP),
        (broken("spread", unit="rad"), NO_MAP),
        (broken("spread", unit=...), NO_MAP),
        (broken("radius", scaled="yes"), NO_MAP),
        (broken("radius", scaled=...), NO_MAP),
        (broken("radius", alpha=7), r"alpha is 7; expected 0 < alpha < 1"),
        (broken("radius", alpha=...), NO_MAP),
    ],
)
def test_a_file_that_is_no_complete_map_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(text)
    with pytest.raises(PoseFileError, match=words):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize(
    ("before", "after"),
    [("2.125", "2.126"), ('"LFoot"', '"RFoot"'), ('"poses": 120', '"poses": 121'), ('"root": "Hip"', '"root": "Head"')],
)
def test_a_map_that_was_edited_is_refused(before: str, after: str, tmp_path: Path) -> None:
    write_map(SPREAD, tmp_path / "map.json")
    text = (tmp_path / "map.json").read_text()
    assert before in text
    (tmp_path / "map.json").write_text(text.replace(before, after))
    with pytest.raises(PoseFileError, match=r"^map\.json: was changed since posecal wrote it \(its digest"):
        read_map(tmp_path / "map.json")


def test_a_map_without_its_digest_is_refused_and_one_laid_out_otherwise_is_read(tmp_path: Path) -> None:
    write_map(SPREAD, tmp_path / "map.json")
    about = json.loads((tmp_path / "map.json").read_text())
    (tmp_path / "map.json").write_text(json.dumps(about, indent=4, sort_keys=True))
    assert read_map(tmp_path / "map.json").by_joint == SPREAD.by_joint
    del about["digest"]
    (tmp_path / "map.json").write_text(json.dumps(about))
    with pytest.raises(PoseFileError, match=NO_MAP):
        read_map(tmp_path / "map.json")


def test_joints_of_any_name_come_back_from_a_map(tmp_path: Path) -> None:
    names = ("Kopf\x1b[31m", "肘", "caf\udce9", "\u202eHip")
    write_map(SpreadMap(names, np.arange(1.0, 5.0), 10, 2), tmp_path / "map.json")
    text = (tmp_path / "map.json").read_text(encoding="utf-8")
    assert read_map(tmp_path / "map.json").joints == names
    assert "肘" in text
    assert text.replace("\n", "").isprintable()


def test_a_radius_may_be_nought_and_an_alpha_anything_between(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(broken("radius", radii={"Head": 0, "Hip": 0.5}, alpha=0.9))
    map_ = read_map(tmp_path / "map.json")
    assert isinstance(map_, RadiusMap)
    assert map_.by_joint == {"Head": 0, "Hip": 0.5}
    assert map_.alpha == 0.9


def test_a_file_that_can_not_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PoseFileError, match=r"none\.json: no such file"):
        read_map(tmp_path / "none.json")
    with pytest.raises(PoseFileError, match=r"is a folder; expected a file\."):
        read_map(tmp_path)
    (tmp_path / "map.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PoseFileError, match=NO_MAP):
        read_map(tmp_path / "map.json")


def test_deep_and_huge_numbers_are_no_map(tmp_path: Path) -> None:
    write_map(SPREAD, tmp_path / "map.json")
    whole = json.loads((tmp_path / "map.json").read_text())
    for text in ("[" * 100_000, broken("spread", factors=dict.fromkeys(whole["factors"], 10**400))):
        (tmp_path / "map.json").write_text(text)
        with pytest.raises(PoseFileError, match=NO_MAP):
            read_map(tmp_path / "map.json")
