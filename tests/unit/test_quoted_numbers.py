"""Numbers in README and docs: all come from the record of a run, each from one key."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
from _numbers import values
from _numbers.formatting import (
    QuotedNumber,
    select_cell,
    select_extreme,
    select_max_magnitude,
    select_point,
)
from _numbers.marks import (
    COMMENT_START,
    MARK_PATTERN,
    find_marks,
    list_documents,
    replace_marked_numbers,
    update_documents,
)
from _numbers.values import CODE_SOURCE, QUOTED_NUMBERS, collect_quoted_numbers

import splits

ROOT = Path(__file__).parents[2]
DOCUMENTS = list_documents(ROOT)
RECORD_FILE = ROOT / "docs" / "numbers.json"

# Rows of tables in which every number except those of the paper comes from a run: the beginning
# of their lines, and the number of cells, from the last, that the run provides.
REPRODUCED_KEYS = {
    "docs/reference/named-media.md": [("| `", 3)],
    "docs/theory/agreement.md": [
        ("| mean grain distance at 450", 1),
        ("| reflectance at 842 / 1074 / 1238 nm", 2),
        ("| measured there by AVIRIS-NG", 2),
        ("| largest transmittance of 12 cm", 1),
        ("| RMSE of reflectance, 300 against 450", 1),
        ("| MSI of reflectance:", 1),
        ("| MSI of transmittance, same order", 1),
    ],
    "docs/theory/accuracy.md": [
        ("| grain size", 2),
        ("| saturation", 2),
        ("| facetness", 2),
        ("| density", 2),
    ],
    "docs/theory/sand.md": [("| goethite k ", 3), ("| `wrong_side_ray: mirror`", 5)],
}


def read_record():
    return json.loads(RECORD_FILE.read_text(encoding="utf-8"))


def list_marks():
    """Return document, key and text of all marks."""
    return [
        (str(path), *mark)
        for path in DOCUMENTS
        for mark in find_marks(path.read_text(encoding="utf-8"))
    ]


# --- documents in the repository --------------------------------------------------------------


def test_marked_numbers_equal_the_record():
    record = read_record()
    assert [m for m in list_marks() if record.get(m[1]) != m[2]] == []


def test_no_key_has_two_texts():
    texts = {}
    for name, key, text in list_marks():
        assert texts.setdefault(key, text) == text, (name, key)


def test_keys_are_known_used_and_recorded():
    used = {key for _, key, _ in list_marks()}
    assert used == set(QUOTED_NUMBERS)
    assert used == set(read_record())


def test_recorded_constants_equal_the_code():
    record = read_record()
    constants = {
        key: n.format_text(None) for key, n in QUOTED_NUMBERS.items() if n.source == CODE_SOURCE
    }
    assert constants["draws"] == "10⁷"
    assert {key: record[key] for key in constants} == constants


@pytest.mark.parametrize("name", REPRODUCED_KEYS)
def test_reproduced_table_cells_are_marked(name):
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    for prefix, n_cells in REPRODUCED_KEYS[name]:
        rows = [line for line in lines if line.startswith(prefix)]
        assert rows, prefix
        for row in rows:
            reproduced = "|".join(row.rstrip(" |").split("|")[-n_cells:])
            assert COMMENT_START in reproduced, row
            assert not re.search(r"\d", MARK_PATTERN.sub("", reproduced)), row


# --- from a run into a document ---------------------------------------------------------------


@pytest.fixture
def results(tmp_path):
    """Return a folder with one small table and one small dataset."""
    (tmp_path / "tables").mkdir()
    table = pd.DataFrame(
        {
            "quantity": ["rise (at 5°)", "fall", "level"],
            "interpretation": ["default", "facets_any", "default"],
            "low": ["0.0", "0.05", "0.0"],
            "ours": [0.0312, -0.5, -0.0002],
            "stderr": [0.0041, 0.0499, 0.0002],
        }
    )
    table.to_csv(tmp_path / "tables" / "made.csv", index=False)
    dataset = xr.Dataset(
        {
            "reflectance": (("texture", "wavelength"), [[0.125, 0.5]]),
            "reflectance_stderr": (("texture", "wavelength"), [[0.002, 0.01]]),
        },
        {"texture": ["no clay"], "wavelength": [400.0, 500.0]},
        {"splits_version": "0", "realizations": 300},
    )
    splits.save(dataset, tmp_path / "data" / "made.nc")
    return tmp_path


TABLE, DATA = "tables/made.csv", "data/made.nc"
VALUE_AND_ERROR = ("ours", "stderr")
WRITTEN_TEXT = {
    "0.031 ± 0.004": QuotedNumber(TABLE, select_cell(*VALUE_AND_ERROR, quantity="rise")),
    "+3.1": QuotedNumber(TABLE, select_cell("ours", scale=100.0, quantity="rise"), "+.1f"),
    "3.12e-2": QuotedNumber(TABLE, select_cell("ours", quantity="rise"), ".2e"),
    "−0.50 ± 0.05 (facets any)": QuotedNumber(
        TABLE, select_extreme(*VALUE_AND_ERROR, largest=False, name="interpretation"), ".2f"
    ),
    "0.000 ± 0.0002": QuotedNumber(TABLE, select_cell(*VALUE_AND_ERROR, quantity="level"), "+.3f"),
    "−0.5": QuotedNumber(TABLE, select_cell("ours", low="0.05"), ".1f"),
    "0.5": QuotedNumber(TABLE, select_max_magnitude("ours"), ".1f"),
    "0.12 ± 0.002": QuotedNumber(
        DATA, select_point("reflectance", texture="no clay", wavelength=400.0), ".2f"
    ),
    "300": QuotedNumber(DATA, select_point("realizations", attribute=True), "g"),
    "0": QuotedNumber(CODE_SOURCE, lambda _: (0.0, None, ""), "+.3f"),
    "0.2": QuotedNumber(CODE_SOURCE, lambda _: (0.2, None, ""), "#.2g"),
    "32": QuotedNumber(CODE_SOURCE, lambda _: (32.2, None, ""), "#.2g"),
    "10⁷": QuotedNumber(CODE_SOURCE, lambda _: (10_000_000, None, ""), "power"),
}


def test_numbers_are_selected_and_formatted(results, monkeypatch):
    expected = {f"key.{i}": text for i, text in enumerate(WRITTEN_TEXT)}
    numbers = dict(zip(expected, WRITTEN_TEXT.values(), strict=True))
    numbers["time"] = QuotedNumber("benchmarks/kernels.csv", select_cell("seconds"))
    monkeypatch.setattr(values, "QUOTED_NUMBERS", numbers)
    actual = collect_quoted_numbers(results)
    # With two significant digits 0.2 keeps its trailing zero.
    expected = {key: "0.20" if text == "0.2" else text for key, text in expected.items()}
    assert actual == expected
    for key, text in actual.items():
        assert find_marks(f"| about {text}<!--{key}--> |") == [(key, text)]


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (
            QuotedNumber("tables/none.csv", select_cell("ours")),
            r"none\.csv'.*must be an existing file .run snakemake",
        ),
        (
            QuotedNumber(TABLE, select_cell("ours", interpretation="default")),
            "key: rows = 2: must be 1 of",
        ),
        (QuotedNumber(TABLE, select_cell("theirs", low="0.05")), r"made\.csv: key: 'theirs'"),
        (QuotedNumber(DATA, select_point("reflectance", texture="clay")), r"made\.nc: key:"),
    ],
)  # fmt: skip
def test_missing_sources_are_reported_in_one_line(results, monkeypatch, number, message):
    monkeypatch.setattr(values, "QUOTED_NUMBERS", {"key": number})
    with pytest.raises(ValueError, match=message) as error:
        collect_quoted_numbers(results)
    assert "\n" not in str(error.value)


def test_a_mark_applies_to_the_number_before_it():
    line = (
        "| 0.8 / 0.9 ± 0.1<!--a--> (± 0.002<!--b-->) | 0.02-0.051<!--c--> | **+3 (x y)<!--d-->** |"
    )
    assert find_marks(line) == [
        ("a", "0.9 ± 0.1"),
        ("b", "0.002"),
        ("c", "0.051"),
        ("d", "+3 (x y)"),
    ]
    new = replace_marked_numbers(line, {"a": "−0.5 ± 0.01", "b": "0", "c": "4.3e-4", "d": "10⁷"})
    assert new == (
        "| 0.8 / −0.5 ± 0.01<!--a--> (± 0<!--b-->) | 0.02-4.3e-4<!--c--> | **10⁷<!--d-->** |"
    )


@pytest.mark.parametrize("line", ["about <!--a-->", "0.5 <!--a-->", "0.5<!--A-->", "0.5<!-- a -->"])
def test_comments_without_a_number_are_rejected(line):
    with pytest.raises(ValueError, match=r"mark = .*must be a number before each comment"):
        find_marks(line)


def test_documents_are_updated_together_or_not_at_all(tmp_path):
    first, second, record = (tmp_path / name for name in ("a.md", "b.md", "numbers.json"))
    first.write_text("0.1<!--a--> and 0.2<!--b-->\n", encoding="utf-8")
    second.write_text("0.2<!--b-->\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"b\.md: mark = 'b': must be a key"):
        update_documents({"a": "0.3"}, [second, first], record)
    assert first.read_text(encoding="utf-8").startswith("0.1") and not record.exists()
    assert update_documents({"a": "0.3", "b": "0.2"}, [first, second], record) == [first, record]
    assert first.read_text(encoding="utf-8") == "0.3<!--a--> and 0.2<!--b-->\n"
    assert json.loads(record.read_text(encoding="utf-8")) == {"a": "0.3", "b": "0.2"}
    # Numbers that a run does not provide stay; keys that no document marks are dropped.
    assert update_documents({"b": "0.4", "c": "9"}, [first, second], record) == [
        first,
        second,
        record,
    ]
    assert json.loads(record.read_text(encoding="utf-8")) == {"a": "0.3", "b": "0.4"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.md", "b.md", "numbers.json"]
