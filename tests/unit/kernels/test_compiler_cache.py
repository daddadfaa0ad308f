"""Compiled kernels between processes: damage, full disks, foreign folders, several writers."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numba
import pytest
from chi2 import NEEDS_JIT
from numba import njit

from splits.core import atomic
from splits.kernels.compiler import cache, cache_lock
from splits.kernels.compiler import cache_folders as places_of_kernels
from splits.kernels.compiler.cache import KernelCache, enable_caching
from splits.kernels.compiler.cache_folders import CacheFolder, list_cache_folders

SCRIPT = """
import numpy as np
from splits.kernels.math.rng import mix64, start_stream, uniform
state = np.zeros(1, dtype=np.uint64)
start_stream(state, 1, 2, 3)
print(uniform(state), mix64(np.uint64(7)))
kernels = (mix64, start_stream, uniform)
print(sum(sum(k.dispatcher.stats.cache_hits.values()) for k in kernels))
"""
COMMAND = [sys.executable, "-c", SCRIPT]


def add_one(x):
    return x + 1


def compiled():
    """Return a function as another process would have it: not compiled yet."""
    return enable_caching(njit(add_one))


def count_cache_hits(kernel):
    return sum(kernel.stats.cache_hits.values())


@pytest.fixture
def places(monkeypatch, tmp_path):
    """Return two folders for kernels, the user's own and one for when that fails."""
    found = (
        CacheFolder(tmp_path / "own" / "numba", False),
        CacheFolder(tmp_path / "temporary", False),
    )
    monkeypatch.setattr(cache, "list_cache_folders", lambda: found)
    places_of_kernels.warn_once.cache_clear()
    return found


def kernels(folder):
    return sorted(folder.path.rglob("*.nbc"))


@NEEDS_JIT
def test_a_kernel_is_compiled_once(places, caplog):
    first, second = compiled(), compiled()
    assert (first(1), second(1), second(1.5)) == (2, 2, 2.5)
    assert count_cache_hits(first) == 0 and count_cache_hits(second) == 1
    assert len(kernels(places[0])) == 2 and kernels(places[1]) == []
    assert caplog.messages == []


def empty(content):
    return b""


def truncate(content):
    return content[: len(content) // 2]


def replace_content(content):
    return b"\x80\x05garbage."


def flip_bit(place):
    def flip(content):
        at = int(place * (len(content) - 1))
        return content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]

    return flip


DAMAGES = [empty, truncate, replace_content, *(flip_bit(place / 10) for place in range(11))]


@NEEDS_JIT
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_kernel_is_compiled_again(damage, places, caplog):
    compiled()(1)
    (path,) = kernels(places[0])
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    again = compiled()
    assert again(1) == 2 and count_cache_hits(again) == 0
    (said,) = caplog.messages
    assert str(places[0].path) in said and "damaged" in said and "\n" not in said
    later = compiled()
    assert later(1) == 2 and count_cache_hits(later) == 1
    assert len(caplog.messages) == 1 and kernels(places[0]) == [path]


@NEEDS_JIT
def test_damage_is_told_once(places, caplog):
    first = compiled()
    first(1), first(1.5)
    for path in kernels(places[0]):
        path.write_bytes(b"")
    again = compiled()
    assert (again(1), again(1.5)) == (2, 2.5)
    assert len(caplog.messages) == 1


@NEEDS_JIT
def test_whole_files_of_no_use_are_compiled_again(places, caplog, monkeypatch):
    compiled()(1)

    def fail(*parts):
        raise AttributeError("gone in this version")

    monkeypatch.setattr(KernelCache._impl_class, "rebuild", fail)
    assert compiled()(1) == 2
    (said,) = caplog.messages
    assert str(places[0].path) in said and "gone in this version" in said


class _FullDisk:
    """A file on a full disk."""

    def __init__(self, path, mode):
        if "r" in mode:
            raise FileNotFoundError

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def write(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@NEEDS_JIT
def test_a_full_disk_stops_nothing(places, caplog, monkeypatch):
    monkeypatch.setattr(places_of_kernels, "open", _FullDisk, raising=False)
    assert compiled()(1) == 2
    (said,) = caplog.messages
    assert str(places[0].path) in said and "No space left" in said
    assert {path.name for place in places for path in place.path.iterdir()} <= {
        cache_lock.LOCK_FILE
    }


@NEEDS_JIT
def test_where_nothing_can_be_written_another_folder_serves(places, caplog):
    # A file where a folder should be: nobody, root neither, can write below it.
    places[0].path.parent.write_text("")
    assert compiled()(1) == 2
    assert len(kernels(places[1])) == 1
    later = compiled()
    assert later(1) == 2 and count_cache_hits(later) == 1
    assert caplog.messages == []


@NEEDS_JIT
def test_folders_are_made_for_the_user_alone(places):
    compiled()(1)
    about = places[0].path.stat()
    assert about.st_mode & 0o777 == 0o700 and about.st_uid == os.getuid()


class _ForeignCode:
    """What runs foreign code once it is loaded."""

    def __reduce__(self):
        return exec, ("raise SystemExit('foreign code runs')",)


def test_kernels_of_old_versions_are_removed(monkeypatch, tmp_path):
    monkeypatch.setattr(places_of_kernels, "compute_kernels_digest", lambda: "new")
    for name, age in (("numba-old", 2.0), ("numba-recent", 0.5), ("notes", 2.0)):
        (tmp_path / name).mkdir()
        then = time.time() - age * places_of_kernels.MAX_UNUSED_AGE_S
        os.utime(tmp_path / name, (then, then))
    CacheFolder(tmp_path / "numba-new", False).write("kernel", b"content")
    left = {folder.name for folder in tmp_path.iterdir()}
    assert left == {"numba-recent", "numba-new", "notes"}


KILLED_PROGRAM = """
import os, pathlib, signal, sys
from splits.kernels.compiler.cache_folders import CacheFolder

os.replace = lambda *paths: os.kill(os.getpid(), signal.SIGKILL)
CacheFolder(pathlib.Path(sys.argv[1]), True).write("killed", b"content")
"""


def test_what_killed_writers_left_is_removed(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED_PROGRAM, str(tmp_path)])
    assert len(list(tmp_path.iterdir())) == 2
    with atomic.atomic_write(tmp_path / "living") as living:
        living.write_text("whole")
        CacheFolder(tmp_path, True).write("kernel", b"content")
        assert living.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"kernel", "living"}


def plant_foreign_kernel(places):
    """Put a file with a fitting checksum in place of the kernel."""
    compiled()(1)
    (path,) = kernels(places[0])
    whole = pickle.dumps(_ForeignCode())
    path.write_bytes(hashlib.sha256(whole).digest() + whole)


def test_the_planted_file_would_run(places):
    with pytest.raises(SystemExit):
        pickle.loads(pickle.dumps(_ForeignCode()))


@NEEDS_JIT
@pytest.mark.parametrize("way", ["open to others", "a link", "of another user"])
def test_a_folder_that_others_may_write_to_is_not_read(way, places, caplog, monkeypatch):
    plant_foreign_kernel(places)
    folder = places[0].path
    if way == "open to others":
        folder.chmod(0o777)
    elif way == "a link":
        folder.rename(folder.with_name("elsewhere"))
        folder.symlink_to(folder.with_name("elsewhere"))
    else:
        monkeypatch.setattr(places_of_kernels, "_get_user_id", lambda: os.getuid() + 1)
    assert compiled()(1) == 2
    assert str(folder) in caplog.messages[0] and "own" in caplog.messages[0]
    if way != "of another user":
        assert len(kernels(places[1])) == 1


@NEEDS_JIT
@pytest.mark.skipif(os.name == "nt", reason="owners of POSIX")
@pytest.mark.parametrize("way", ["of another user", "open to the group", "open to all"])
def test_files_of_others_in_a_named_folder_are_not_loaded(way, places, caplog, monkeypatch):
    shared = CacheFolder(places[0].path, True)
    monkeypatch.setattr(cache, "list_cache_folders", lambda: (shared, places[1]))
    plant_foreign_kernel((shared,))
    shared.path.chmod(0o777)
    (path,) = kernels(shared)
    planted = path.read_bytes()
    if way == "of another user" and os.getuid() == 0:
        os.chown(path, 12_345, -1)
    elif way == "of another user":
        # Only root can give files away: another number stands for another user.
        monkeypatch.setattr(places_of_kernels, "_get_user_id", lambda: os.getuid() + 1)
    else:
        path.chmod(0o664 if "group" in way else 0o666)
    assert compiled()(1) == 2
    assert "other users" in caplog.messages[0] and str(shared.path) in caplog.messages[0]
    # Nor are they replaced, which their owners would do in turn: the next folder serves.
    assert path.read_bytes() == planted
    if places_of_kernels._get_user_id() == os.getuid():
        assert len(kernels(places[1])) == 1


@NEEDS_JIT
def test_files_of_root_in_a_named_folder_are_loaded(places, monkeypatch):
    shared = CacheFolder(places[0].path, True)
    monkeypatch.setattr(cache, "list_cache_folders", lambda: (shared,))
    compiled()(1)
    if kernels(shared)[0].stat().st_uid != 0:
        pytest.skip("needs a file of root's")
    monkeypatch.setattr(places_of_kernels, "_get_user_id", lambda: 12_345)
    again = compiled()
    assert again(1) == 2 and count_cache_hits(again) == 1


def test_the_shared_folder_is_checked_even_if_another_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    first, last = list_cache_folders.__wrapped__()
    assert first.path.is_relative_to(tmp_path) and first.user_defined
    assert first.path.name == f"numba-{places_of_kernels.compute_kernels_digest()}"
    assert last.path.parent == Path(tempfile.gettempdir()) and not last.user_defined
    assert (
        last.path.name == f"splits-{os.getuid()}-numba-{places_of_kernels.compute_kernels_digest()}"
    )


def test_a_user_without_a_home_has_the_shared_folder_only(monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    (only,) = list_cache_folders.__wrapped__()
    assert only.path.parent == Path(tempfile.gettempdir())


def test_a_line_is_told_as_it_is(capsys, monkeypatch):
    places_of_kernels.warn_once.cache_clear()
    logger = logging.getLogger(places_of_kernels.__name__)
    monkeypatch.setattr(logger, "handlers", [logging._StderrHandler(logging.WARNING)])
    monkeypatch.setattr(logger, "propagate", False)
    places_of_kernels.warn_once("one line")
    places_of_kernels.warn_once("one line")
    assert capsys.readouterr().err == "one line\n"


def run_processes(folder, count=1):
    """Return what processes say that run the script at once, with kernels kept in a folder."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(folder)
    started = [
        subprocess.Popen(
            COMMAND, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(count)
    ]
    return [(*process.communicate(timeout=300), process.returncode) for process in started]


@NEEDS_JIT
@pytest.mark.slow
def test_processes_share_what_they_compile_and_survive_damage(tmp_path):
    told = run_processes(tmp_path, 3)
    assert {(err, code) for _, err, code in told} == {("", 0)}
    (numbers,) = {out.splitlines()[0] for out, *_ in told}
    ((out, err, code),) = run_processes(tmp_path)
    assert (out, err, code) == (f"{numbers}\n3\n", "", 0)
    for path in tmp_path.rglob("*.nb*"):
        content = path.read_bytes()
        path.write_bytes(flip_bit(0.5)(content))
    ((out, err, code),) = run_processes(tmp_path)
    assert (out.splitlines()[0], code) == (numbers, 0)
    (line,) = err.splitlines()
    assert str(tmp_path) in line
    ((out, err, code),) = run_processes(tmp_path)
    assert (out, err, code) == (f"{numbers}\n3\n", "", 0)


KERNEL = """
import sys, time
from numba import njit
from splits.kernels.compiler.cache import enable_caching

def slow(x):
    return x + 1

kernel = enable_caching(njit(slow))
"""
CONCURRENT_PROGRAM = f"""{KERNEL}
compile = kernel._compiler.compile
def slowly(*parts):
    time.sleep(1.0)
    return compile(*parts)
kernel._compiler.compile = slowly
print(input(), kernel(1), sum(kernel.stats.cache_hits.values()))
"""


@NEEDS_JIT
def test_of_processes_that_start_together_one_compiles(tmp_path):
    script = tmp_path / "slow.py"
    script.write_text(CONCURRENT_PROGRAM)
    kept = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": kept}
    four = [subprocess.Popen([sys.executable, script], **pipes) for _ in range(4)]
    for one in four:  # all of them, before any is waited for
        one.stdin.write("go\n")
        one.stdin.flush()
    said = sorted(one.communicate(timeout=300)[0] for one in four)
    assert said == ["go 2 0\n"] + 3 * ["go 2 1\n"]


@NEEDS_JIT
def test_nobody_waits_for_a_process_that_is_gone(tmp_path):
    holds = "import sys, pathlib; from splits.kernels.compiler import cache_lock\n"
    holds += "cache_lock.acquire_lock(pathlib.Path(sys.argv[1]), 'kernel')\n"
    holds += "print(1, flush=True); input()"
    command = [sys.executable, "-c", holds, tmp_path]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    first = subprocess.Popen(command, **pipes)
    assert first.stdout.readline() == b"1\n"
    second = subprocess.Popen(command, **pipes)
    with pytest.raises(subprocess.TimeoutExpired):
        second.wait(2.0)
    first.kill()
    assert second.stdout.readline() == b"1\n"
    first.communicate()
    second.communicate(b"\n")
    assert (first.returncode, second.returncode) == (-signal.SIGKILL, 0)


FAILURES = f"""{KERNEL}
if sys.argv[1:]:
    compile = kernel._compiler._compile_core
    def fail(*parts):
        raise KeyboardInterrupt
    kernel._compiler._compile_core = fail
try:
    print(kernel(1), flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
input()
"""


@NEEDS_JIT
def test_nobody_waits_for_a_compilation_that_failed(tmp_path):
    script = tmp_path / "fails.py"
    script.write_text(FAILURES)
    kept = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": kept}
    lives_on = subprocess.Popen([sys.executable, script, "fail"], **pipes)
    assert lives_on.stdout.readline() == "interrupted\n"
    other = subprocess.run(
        [sys.executable, script], input="\n", capture_output=True, text=True, env=kept, timeout=60
    )
    assert other.stdout == "2\n"
    lives_on.communicate("\n")


def test_a_folder_that_cannot_be_written_to_holds_nobody_up(tmp_path, monkeypatch):
    cache_lock._open_lock_file.cache_clear()
    gone = tmp_path / "gone"
    assert not cache_lock.acquire_lock(gone, "kernel")
    assert cache_lock.acquire_lock(tmp_path, "kernel")
    cache_lock.release_lock(tmp_path, "kernel")
