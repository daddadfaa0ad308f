"""Folders in the main configuration: normalization and validation."""

import pytest

from splits.core.validation import ConfigError
from splits.experiments import load_settings

ACCURACIES = {"accuracies": {"standard": {"max_stderr": 0.1}}}


@pytest.mark.parametrize("folder", ["out", "out/", "out//", "./out", "out/.", "else/../out"])
@pytest.mark.parametrize("key", ["results", "measured_folder"])
def test_folder_names_are_normalized(key, folder):
    assert getattr(load_settings(ACCURACIES | {key: folder}), key) == "out"


@pytest.mark.parametrize("folder", ["", ".", "./", "a/..", "{name}", "out\n"])
def test_invalid_folders_are_rejected(folder):
    with pytest.raises(
        ConfigError, match=r"^config/config.yaml: results = .*: must be (the|a) path"
    ):
        load_settings(ACCURACIES | {"results": folder})
