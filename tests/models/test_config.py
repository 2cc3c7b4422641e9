"""Configurations: those that are named, and errors for invalid ones."""

from __future__ import annotations

import pytest

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.config import Config, named_configs
from posecal_models.estimators.registry import build_from_config
from posecal_models.estimators.simple_baseline import SimpleBaseline


@pytest.mark.parametrize("name", named_configs())
def test_every_named_configuration_builds_its_estimator(name):
    config = Config.load(name)
    if config.model.kind == "gaussian-noise":
        assert build_from_config(config.model, mean=SimpleBaseline(width=4)).joints
    elif config.model.size != "xlarge":
        assert build_from_config(config.model).joints


def test_the_released_configuration_sets_every_difference_that_is_a_setting():
    config = Config.load("cgnf-small-released")
    assert (config.model.scale, config.model.backward_weights) == ("sigmoid", False)
    assert (config.train.loss_per, config.train.sample_loss, config.train.augmentation) == ("node", "pairs", "released")


def test_all_problems_of_a_configuration_are_in_one_message():
    table = {"model": {"size": "medium", "sizes": 3}, "train": {"epochs": "ten", "batch": True}, "data": {"views": 2.5}}
    with pytest.raises(PoseDataError) as caught:
        Config.from_table(table)
    words = str(caught.value)
    assert words.startswith("5 problems:")
    for part in (
        "model.size is 'medium'; expected one of tiny, mini, small, large, xlarge",
        "model.sizes is not known. Did you mean size?",
        "train.epochs is 'ten'; expected int",
        "train.batch is True; expected int",
        "data.views is 2.5; expected int",
    ):
        assert part in words


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("model.kind=cvae model.width=3", r"model\.width: 3 of a cvae; expected 4 or more"),
        ("model.kind=cvae model.units=released", r"model\.units: released of a cvae; expected fitted"),
        ("train.epochs=0", r"train\.epochs: 0; expected 1 or more"),
        ("epochs=3", "expected table.name=value"),
        ("train.epoch=3", "train.epoch is not known. Did you mean epochs"),
        ("model.scale=tanh", "model.scale is 'tanh'; expected one of sigmoid, exp"),
        ("data.detector.sigma=-1", r"detector\.sigma: -1.*expected 0 pixels or more"),
    ],
)
def test_a_change_that_does_not_fit_is_refused(change, words):
    with pytest.raises(PoseDataError, match=words):
        Config().with_changes(change.split())


def test_a_change_may_be_text_a_number_or_a_list():
    config = Config().with_changes(["model.scale=sigmoid", "train.epochs=3", 'data.test_subjects=["S1", "S2"]'])
    assert (config.model.scale, config.train.epochs, config.data.test_subjects) == ("sigmoid", 3, ("S1", "S2"))


def test_a_file_that_is_not_toml_is_refused(tmp_path):
    (tmp_path / "a.toml").write_text("[model\nkind=")
    with pytest.raises(PoseFileError, match=r"a\.toml: not valid TOML"):
        Config.load(str(tmp_path / "a.toml"))


def test_a_baseline_can_t_be_trained_by_likelihood():
    from posecal_models.objectives import build_objective

    with pytest.raises(PoseDataError, match=r"train\.objective: likelihood of a SimpleBaseline"):
        build_objective(SimpleBaseline(width=4), Config().train)


def test_a_number_of_thousands_of_digits_is_no_setting(tmp_path):
    (tmp_path / "a.toml").write_text("[train]\nepochs = 0x" + "f" * 4000)
    with pytest.raises(PoseFileError, match=r"a\.toml: not valid TOML \(Exceeds the limit"):
        Config.load(str(tmp_path / "a.toml"))
