"""Kept datasets: their digests, damage, foreign files, full disks, and several processes."""

import errno
import os
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

from splits.core.progress import warn_once
from splits.io import cache as module
from splits.io.cache import NO_CACHE, Cache, compute_digest


class Pair(NamedTuple):
    one: float
    two: float


class OtherPair(NamedTuple):
    one: float
    two: float


DIFFERENT = [
    (), (None,), ("None",), (1,), (1.0,), ("1",), (b"1",), (True,), ([1],), (1, 2), ("12",),
    ("1", "2"),
    ([1, 2],), ([1], 2), ([[1], 2],), (Pair(1, 2),), (OtherPair(1, 2),), ({"a": 1},), ({"a": 2},),
    ({"b": 1},), ({"a": 1, "b": 2},), ([("a", 1)],), (np.array([1, 2]),), (np.array([[1, 2]]),),
    (np.array([1.0, 2.0]),), (np.array([1, 2], np.float32),), (np.array(["1", "2"]),),
    (float("nan"),),
]  # fmt: skip


def test_different_inputs_have_different_digests():
    digests = [compute_digest(*parts) for parts in DIFFERENT]
    assert len(set(digests)) == len(DIFFERENT)
    assert digests == [compute_digest(*parts) for parts in DIFFERENT]


def test_equal_inputs_have_equal_digests():
    assert compute_digest({"a": 1, "b": 2}) == compute_digest({"b": 2, "a": 1})
    assert compute_digest((1, 2)) == compute_digest([1, 2])
    assert compute_digest(np.float64(0.5)) == compute_digest(0.5)
    view = np.arange(6.0).reshape(2, 3).T
    assert compute_digest(view) == compute_digest(np.ascontiguousarray(view))
    assert compute_digest(np.array(["a", None], object)) == compute_digest(["a", None])


def test_objects_without_a_content_are_rejected():
    with pytest.raises(TypeError, match="a object has no digest"):
        compute_digest([object()])


@pytest.fixture
def made():
    """Return the numbers of the datasets that were made."""
    warn_once.cache_clear()
    return []


def get(cache, made, number=1.0):
    def make():
        made.append(number)
        attrs = {"kinds": ["a", "b"], "number": number}
        return xr.Dataset({"value": ("x", np.array([number, np.pi]))}, attrs=attrs)

    return cache.get([number, "some"], make)


def test_datasets_are_made_once(tmp_path, made):
    folder = tmp_path / "below" / "it"
    first, second = (get(Cache(folder, "some"), made) for _ in range(2))
    xr.testing.assert_identical(first, second)
    get(Cache(folder, "some"), made, 2.0)
    assert made == [1.0, 2.0] and len(list(folder.glob("some_*.nc"))) == 2


def test_nothing_is_kept_without_a_folder(made):
    get(NO_CACHE, made), get(NO_CACHE, made)
    assert made == [1.0, 1.0]


def test_a_folder_in_place_of_a_file_is_left_alone(tmp_path, made, caplog):
    cache = Cache(tmp_path, "some", is_optional=True)
    get(cache, made)
    (path,) = tmp_path.iterdir()
    path.unlink()
    path.mkdir()
    assert get(cache, made).value[0] == 1.0
    assert made == [1.0, 1.0] and any("not kept" in one for one in caplog.messages)


@pytest.mark.parametrize("damage", ["empty", "cut", "bit", "text", "foreign"])
def test_damaged_and_foreign_files_are_made_again(tmp_path, made, caplog, damage):
    cache = Cache(tmp_path, "some")
    expected = get(cache, made)
    (path,) = tmp_path.iterdir()
    content, middle = path.read_bytes(), path.stat().st_size // 2
    changed = bytes([content[middle] ^ 1])
    get(cache, made, 2.0)
    (other,) = set(tmp_path.iterdir()) - {path}
    path.write_bytes({
        "empty": b"", "cut": content[:middle], "text": b"no dataset\n",
        "bit": content[:middle] + changed + content[middle + 1 :], "foreign": other.read_bytes(),
    }[damage])  # fmt: skip
    xr.testing.assert_equal(get(cache, made), expected)
    (line,) = caplog.messages
    assert str(path) in line and "made again" in line and "\n" not in line
    get(cache, made)
    assert made == [1.0, 2.0, 1.0] and len(caplog.messages) == 1


@pytest.mark.parametrize("is_optional", [True, False])
def test_a_full_disk(tmp_path, made, caplog, monkeypatch, is_optional):
    def fail(dataset, path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(module, "save", fail)
    cache = Cache(tmp_path, "some", is_optional=is_optional)
    if not is_optional:
        with pytest.raises(OSError, match="No space left"):
            get(cache, made)
        return
    assert get(cache, made).value[0] == 1.0
    assert "not kept" in caplog.messages[0]


def test_files_that_were_used_are_deleted(tmp_path, made):
    folder = tmp_path / "blocks" / "mine"
    first, second = Cache(folder, "some"), Cache(folder, "some")
    get(first, made), get(second, made, 2.0)
    first.delete()
    assert len(list(folder.iterdir())) == 1
    second.delete()
    assert list(tmp_path.iterdir()) == []


def test_files_unused_for_the_longest_time_are_removed(tmp_path, made):
    get(Cache(tmp_path, "some"), made)
    (path,) = tmp_path.iterdir()
    kernel = tmp_path / "kernel.nbc"
    kernel.write_bytes(b"0")
    cache = Cache(tmp_path, "some", max_bytes=2.5 * path.stat().st_size)
    for number in (2.0, 3.0):
        for age, other in enumerate(
            sorted(tmp_path.glob("some_*"), key=lambda one: one.stat().st_mtime)
        ):
            os.utime(other, (age + 1.0, age + 1.0))
        # The first file is used again.
        get(cache, made)
        get(cache, made, number)
    assert path.exists() and len(list(tmp_path.glob("some_*"))) == 2 and kernel.exists()
    assert made == [1.0, 2.0, 3.0]
