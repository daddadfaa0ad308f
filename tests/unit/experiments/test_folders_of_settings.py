"""Folders of the main configuration."""

from __future__ import annotations

import pytest

from splits.experiments import ConfigError, load_settings

ACCURACIES = {"accuracies": {"standard": {"max_stderr": 0.1}}}


@pytest.mark.parametrize("given", ["out", "out/", "out//", "./out", "out/.", "else/../out"])
@pytest.mark.parametrize("key", ["results", "measured_folder"])
def test_a_folder_may_be_spelt_in_any_way(key, given):
    assert getattr(load_settings(ACCURACIES | {key: given}), key) == "out"


@pytest.mark.parametrize("given", ["", ".", "./", "a/..", "{name}", "out\n"])
def test_invalid_folders_are_rejected(given):
    with pytest.raises(
        ConfigError, match=r"^config/config.yaml: results = .*: must be (the|a) path"
    ):
        load_settings(ACCURACIES | {"results": given})
