"""Messages on settings of several files and on own media: file and line."""

import re
from pathlib import Path

import pytest
from shipped import CONFIG

from splits.core.validation import ConfigError
from splits.core.yaml import read_yaml
from splits.experiments import load_experiments, load_settings
from splits.experiments.config.load import select_experiments

ROOT = Path(__file__).parents[3]


def test_settings_of_several_files_are_located(tmp_path):
    first, second = tmp_path / "config.yaml", tmp_path / "mine.yaml"
    first.write_text((CONFIG / "config.yaml").read_text("utf-8"), "utf-8")
    second.write_text(
        "seed: 2\nstudies:\n  mine:\n    function: workflow.papers.layer.make_layer_trend_table\n"
        "    inputs: {lense: layer_fig02_lens}\n    option: {n: 2}\n",
        "utf-8",
    )
    content = read_yaml(first)
    content["studies"] |= read_yaml(second)["studies"]
    files = str(first), str(second)
    with pytest.raises(ConfigError, match=f"^{re.escape(str(second))}, line 6: studies.mine.opt"):
        load_settings(content, *files)
    del content["studies"]["mine"]["option"]
    second.write_text(second.read_text("utf-8").replace("    option: {n: 2}\n", ""), "utf-8")
    available = load_experiments(CONFIG / "experiments")

    def read_message_of_selection(**changes):
        changed = content | changes
        settings = load_settings(changed, *files)
        with pytest.raises(ConfigError) as error:
            select_experiments(settings, available, changed, *files)
        return str(error.value)

    message = read_message_of_selection()
    assert message.startswith(f"{second}, line 5: studies.mine.inputs.lense: unknown key")
    content["studies"]["mine"]["inputs"] = {"lens": "layer_fig02_lens"}
    line = first.read_text("utf-8").splitlines().index("experiments: [papers, own]") + 1
    first.write_text(first.read_text("utf-8").replace("[papers, own]", "[paper, own]"), "utf-8")
    message = read_message_of_selection(experiments=["paper", "own"])
    assert message.startswith(f"{first}, line {line}: experiments = 'paper': no such")
    message = read_message_of_selection(experiments=["pape"])
    assert message.startswith(f"{first}: experiments = 'pape': no such")


def test_errors_of_own_media_name_their_file(tmp_path):
    media, experiments = tmp_path / "media", tmp_path / "experiments"
    for folder in (media, experiments):
        folder.mkdir()
    (media / "used.yaml").write_text("kind: snow\ndepth_m: 1\nsaturation: 2\n", "utf-8")
    (media / "unused.yaml").write_text("kind: snow\nsaturaton: 0.1\n", "utf-8")
    (media / "twice.yaml").write_text("kind: snow\n", "utf-8")
    (media / "twice.yml").write_text("kind: sand\n", "utf-8")
    (experiments / "a.yaml").write_text("medium: {base: used}\n", "utf-8")
    with pytest.raises(ConfigError) as error:
        load_experiments(experiments, media)
    lines = str(error.value).splitlines()
    assert len(lines) == 4, lines
    assert lines[0].startswith(f"{media / 'twice.yaml'}: base = 'twice': must be the name of one")
    assert lines[2].startswith(f"{media / 'unused.yaml'}, line 2: saturaton: unknown key")
    assert lines[3] == f"{media / 'used.yaml'}, line 3: saturation = 2: must be in [0, 1]"
