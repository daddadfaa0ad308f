"""Hypothesis strategies for invalid experiment files: odd values, wrong keys, invalid YAML."""

from typing import Any

from generated import RawText, to_file_text, valid_contents
from hypothesis import strategies as st

NESTING_DEPTH = 300
"""Depth of nesting that a reader may reject."""

NUMBERS = [
    ".nan", ".inf", "-.inf", "1e400", "-1e400", "9223372036854775808", "-1", "0", "-0.0",
    "1" * 400, "-" + "9" * 400, "5e-324", "1e-310", "1e308", "0x10", "0o17", "1_000", "190:20:30",
    "1e5", "+1", "1e-300", "4294967296", "18446744073709551616", "9007199254740993", "0.1e1", ".5",
    "1.", "1e999999",
]  # fmt: skip
SCALARS = [
    "null", "~", "true", "yes", "off", "''", '" "', "2001-01-01", "2001-01-01 10:00:00", "nan",
    "inf", '"\\0"', '"\\n"', '"a\\nb"', '"\\x1b[31mred"', '"\\u2028"', '"\\ud800"', '"\\u202e"',
    '"\\ufeff"', "=", "<<", "日本語", "é", "𝔘", "'" + "x" * 5000 + "'", "a.csv", "../../etc/passwd",
    "/", "diffuse", "default", "'1.5+xj'", "'1+1e400j'", "'nanj'", "'-1j'", "!!binary aGk=",
]  # fmt: skip
COLLECTIONS = [
    "[]", "{}", "[[]]", "[{}]", "[null]", "{null: null}", "[1, [2, [3]]]", "{a: {b: {c: 1}}}",
    "[.nan, .nan]", "[1, a]", "[2, 1]", "[1, 1]", "[0, 0, 0, 0]", "{1: 2}", "{true: 1}",
    "{[1, 2]: 3}", "{? {a: 1} : 2}", "{1.5: x, 1.50: y}", "[1, 2, 3, 4, 5, 6, 7, 8, 9]",
    "{start: 400}", "{start: 400, stop: 500, step: 1e-300}", "{start: 400, stop: 1e300, step: 1}",
    "{start: .nan, stop: 1, step: 1}", "{start: 500, stop: 400, step: -1}",
    "{wavelength_nm: [400], n: [1], k: [0]}", "{wavelength_nm: [400, 300], n: [1, 2], k: [0, 0]}",
    "{wavelength_nm: [], n: [], k: []}", "{dataset: nowhere}", "{cosine: [], density: []}",
    "{cosine: [-1, 1], density: [.nan, 1]}", "{cosine: [-1, 1], density: [0, 0]}",
    "{min: 1, max: 2}", "!!set {a, b}", "!!omap [a: 1]", "!!pairs [a: 1, a: 2]",
    "[" * NESTING_DEPTH + "]" * NESTING_DEPTH, "{a: " * NESTING_DEPTH + "1" + "}" * NESTING_DEPTH,
    "[" * 40 + "1" + "]" * 40,
]  # fmt: skip
YAML_SYNTAX = [
    "!!python/object:os.system {}", "!!python/name:os.system", "!unknown 1", "!!int a",
    "!!float a", "!!timestamp a", "!!bool a", "!!null a", "!!str 1", "!!seq 1", "!!map 1",
    "!!binary ä", "*nowhere", "&a [*a]", "&a {b: *a}", "[&x 1, *x]", "{<<: 1}", "{<<: [1]}",
    "{<<: {a: 1}, a: 2}", "{<<: *nowhere}", "!!int 0b", "!!int ''", "!!float ''",
    "!!timestamp 2001-99-99", "2001-99-99", "@a", "`a", "%a", "- a", "? a", "{a: 1, a: 2}",
    "a: b: c", "|", ">", "\t", "[", "}", '"', "'", "!!merge <<", "#", "---", "...",
]  # fmt: skip
ALIAS_BOMB = "x: &x [1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
for one, many in zip("xabcdefg", "abcdefgh", strict=True):
    ALIAS_BOMB += f"{many}: &{many} [" + ", ".join([f"*{one}"] * 9) + "]\n"
ALIAS_BOMB += "medium: *h\n"
FILES = [
    "", " ", "\n\n", "#", "---\n---\n", "a: 1\n---\nb: 2\n", "- 1\n- 2\n", "1", "null", "text",
    "\t", "\x00", "\x07a: 1", "\ufeffmedium: {}\n", "medium: {}\x85grid: {}\n",
    "medium: {}\rgrid: {}\r", "%YAML 9.9\n---\na: 1\n", "%TAG ! x\n", "medium: &m {base: *m}\n",
    "&a [*a, *a]", "&a {medium: *a}", "? [a]\n: 1\n", "!!python/object/apply:os.getcwd []",
    "[" * 2000, "{a: " * 2000, "- " * 2000, "a:\n" + " a:\n" * 3,
    "medium: {kind: snow}\nmedium: {kind: sand}\n", "medium: !!set {kind}\n",
    "<<: {medium: {kind: sand}}\n", ALIAS_BOMB, "name: [a]\n", "name: null\n", "name: 1\n",
    "title: [a]\n", "title: null\n", "experiments: all\n", "medium: snow\n", "medium: []\n",
    "medium: null\n", "grid: []\n", "grid: null\n", "instrument: null\n", "figure: null\n",
    "retrieve: null\n", "retrieve: {}\n", "retrieve: {measured: ..}\n",
    "retrieve: {measured: ''}\n",
    "figure: {measured: README.md}\n",
    "retrieve: {measured: README.md, free: [iron_oxide]}\nmedium: {kind: sand}\n",
    "retrieve: {measured: aviris_ng_varsa2021.csv, free: [iron_oxide]}\nmedium: {kind: sand}\n",
]  # fmt: skip

ODD_VALUES = st.sampled_from([*NUMBERS, *SCALARS, *COLLECTIONS, *YAML_SYNTAX]).map(
    RawText
) | st.text(max_size=12)
ODD_KEYS = [
    "densty_kg_m3", "Medium", "wavelength", "wavelength_nm ", "kinds", "", " ", "ä", "__class__",
    "self", "base", "kind", "medium", "at", "seed", "x" * 3000, "a\nb", "\x1b[0m", "model_config",
    "name",
]  # fmt: skip
UNKNOWN_KEYS = st.sampled_from(ODD_KEYS) | ODD_VALUES


def list_paths(content: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all items of nested mappings and lists."""
    if isinstance(content, RawText):
        return []
    inner = content.items() if isinstance(content, dict) else enumerate(content)
    found = []
    for key, value in inner:
        found.append((*path, key))
        if isinstance(value, (dict, list, tuple)):
            found += list_paths(value, (*path, key))
    return found


def change_at(content: Any, path: tuple[Any, ...], change: Any) -> Any:
    """Return contents with `change(container, key)` applied at the end of a path."""
    copied = dict(content) if isinstance(content, dict) else list(content)
    key, *rest = path
    if not rest:
        return change(copied, key)
    copied[key] = change_at(copied[key], tuple(rest), change)
    return copied


@st.composite
def invalid_contents(draw) -> Any:
    """Return contents with one to three changed items."""
    content = draw(valid_contents())
    for _ in range(draw(st.integers(1, 3))):
        known = list_paths(content)
        path = draw(st.sampled_from(known)) if known else ()
        value, name = draw(ODD_VALUES), draw(UNKNOWN_KEYS)
        how = draw(st.sampled_from(["value", "value", "value", "add", "rename", "drop", "nest"]))

        def change(holder, key, how=how, value=value, name=name):
            if how == "nest":
                holder[key] = [holder[key]]
            elif how == "value" or isinstance(holder, list):
                holder[key] = value
            elif how == "add":
                holder[name] = value
            else:
                old = holder.pop(key)
                if how == "rename":
                    holder[name] = old
            return holder

        content = change_at(content, path, change) if path else value
    return content


@st.composite
def damaged_texts(draw) -> str:
    """Return the text of a file with a piece removed, inserted or replaced."""
    text = to_file_text(draw(valid_contents()))
    start, length = draw(st.integers(0, len(text))), draw(st.integers(0, 20))
    pieces = ["", "\t", "\x00", "\n", ": ", "{", "&a ", "*a", "\ufeff", "é", text[:50]]
    piece = draw(st.sampled_from(pieces))
    return text[:start] + piece + text[start + length :]


def file_texts() -> st.SearchStrategy:
    """Return valid and invalid texts of files."""
    return (
        invalid_contents().map(to_file_text)
        | invalid_contents().map(to_file_text)
        | valid_contents().map(to_file_text)
        | damaged_texts()
        | st.sampled_from(FILES)
        | st.text(max_size=60)
    )
