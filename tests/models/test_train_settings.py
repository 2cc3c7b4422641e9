"""Invalid settings of a training are refused before any computation, each with one message."""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import get_type_hints

import pytest

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.cli import main
from posecal_models.config import Config, named_configs
from posecal_models.data.detector import Detector
from posecal_models.limits import Limit
from posecal_models.settings import DataConfig, ModelConfig, TrainConfig

BASELINE = Config.load("simple-baseline")
TABLES = (ModelConfig, DataConfig, TrainConfig, Detector)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("train.epochs.x=3", r"--set train\.epochs\.x=3: expected table\.name=value"),
        ("data.every=0", r"data\.every: 0; expected 1 or more"),
        ("data.every=-1", r"data\.every: -1; expected 1 or more"),
        ("data.views=-1", r"data\.views: -1; expected 0 or more"),
        ("data.limb_exchange=1.5", r"data\.limb_exchange: 1\.5; expected a share between 0 and 1"),
        ("train.average=1", r"train\.average: 1\.0; expected 0 or more and below 1"),
        ("data.validation_poses=0", r"data\.validation_poses: 0; expected 1 or more"),
        ("data.camera_seed=-1", r"data\.camera_seed: -1; expected 0 or more"),
        ("data.body_variation=nan", r"data\.body_variation: nan; expected 0 to 1"),
        ("data.detector.sigma=inf", r"detector\.sigma: inf; expected 0 pixels or more"),
        ("data.detector.sigma=6", r"threshold: 5 pixels; with sigma 6.* every keypoint counts as missing"),
        ("data.detector.hidden_share=1", r"hidden_share 1 every keypoint counts as missing"),
        ("data.detector=3", r"data\.detector is 3; expected a table"),
        ("train.seed=99999999999999999999999", r"train\.seed: 9{23}; expected at most 9,223,372,036,854,775,807"),
        ("train.patience=-3", r"train\.patience: -3; expected 0 or more"),
        ("train.batch=1", r"train\.batch: 1 of a simple-baseline; expected 2 or more"),
        ("train.batch=9999999999", r"train\.batch: 9999999999; expected at most 2,147,483,647"),
        ("train.epochs=" + "9" * 5000, r"train\.epochs is '9+…9+'; expected int"),
        ("train.clip=inf", r"train\.clip: inf; expected a positive number"),
        ("train.learning_rate=1" + "0" * 400, r"train\.learning_rate is 10+…0+; expected float"),
        ("model.width=0", r"model\.width: 0; expected 1 or more"),
        ("model.residuals=-1", r"model\.residuals: -1; expected 0 or more"),
        ("model.dropout=2", r"model\.dropout: 2\.0; expected 0 or more and below 1"),
        ("model.dropout=1.0", r"model\.dropout: 1\.0; expected 0 or more and below 1"),
    ],
)
def test_a_setting_that_can_t_work_is_refused(change, words):
    with pytest.raises(PoseDataError, match=words):
        BASELINE.with_changes([change])


def test_one_subject_can_t_be_for_test_and_validation():
    with pytest.raises(PoseDataError, match=r"test_subjects and data\.validation_subjects: both name S4"):
        BASELINE.with_changes(['data.test_subjects=["S3", "S4"]', 'data.validation_subjects=["S4", "S5"]'])


def test_a_detector_may_see_hidden_keypoints_alone():
    assert Detector(sigma=6, hidden_sigma=1).threshold == 5


@pytest.mark.parametrize("table", TABLES)
def test_every_number_has_a_limit_and_must_be_finite(table):
    hints = get_type_hints(table, include_extras=True)
    for field in dataclasses.fields(table):
        kind = get_type_hints(table)[field.name]
        if kind not in (int, float):
            continue
        assert hints[field.name].__origin__ is kind
        assert any(isinstance(part, Limit) for part in hints[field.name].__metadata__), field.name
        for value in (math.nan, math.inf) if kind is float else (-1, 2**63):
            with pytest.raises(PoseDataError, match=field.name):
                table(**{field.name: value})


def test_a_whole_number_may_stand_for_a_float():
    assert Config().with_changes(["train.learning_rate=1"]).train.learning_rate == 1.0


@pytest.mark.parametrize("name", named_configs())
def test_every_named_configuration_is_within_the_limits(name):
    assert Config.load(name).table()


def test_a_file_that_is_not_utf_8_is_refused(tmp_path):
    (tmp_path / "a.toml").write_bytes(b'[model]\nkind = "cgnf" # \xff\n')
    with pytest.raises(PoseFileError, match=r"a\.toml: not valid TOML \('utf-8' codec can't decode byte 0xff"):
        Config.load(str(tmp_path / "a.toml"))


def test_the_command_prints_one_line_and_exits_with_3(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["train", "cgnf-tiny", "--data", "nowhere.npz", "-o", "run", "--set", "data.every=0"]
    monkeypatch.setattr(sys, "argv", ["posecal-models", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 3
    assert capsys.readouterr().err == "posecal-models: config: data.every: 0; expected 1 or more.\n"
    assert not list(tmp_path.iterdir())
