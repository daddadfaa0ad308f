"""Cache of compiled kernels: damage, full disks, foreign folders, concurrent processes."""

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
from contextlib import contextmanager
from pathlib import Path

import numba
import pytest
from chi2 import NEEDS_JIT
from numba import njit
from numba.core.caching import IndexDataCacheFile

from splits.core import progress as notices
from splits.kernels.compiler import cache
from splits.kernels.compiler.cache import (
    KernelCache,
    enable_caching,
    find_cache_folder,
    make_private_folder,
)

SCRIPT = """
import numpy as np
from splits.kernels.rng import mix64, start_stream, uniform
state = np.zeros(1, dtype=np.uint64)
start_stream(state, 1, 2, 3)
print(uniform(state), mix64(np.uint64(7)))
kernels = (mix64, start_stream, uniform)
print(sum(sum(k.dispatcher.stats.cache_hits.values()) for k in kernels))
"""
COMMAND = [sys.executable, "-c", SCRIPT]


def add_one(x):
    return x + 1


def make_kernel():
    """Return a new cached function, not yet compiled, as in another process."""
    return enable_caching(njit(add_one))


def count_cache_hits(kernel):
    return sum(kernel.stats.cache_hits.values())


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """Return the cache folder, of two candidates: the user's own and one for temporary files."""
    candidates = (tmp_path / "own" / "numba", tmp_path / "temporary")
    monkeypatch.setattr(cache, "_list_candidates", lambda: candidates)
    monkeypatch.setattr(cache, "find_cache_folder", find_cache_folder.__wrapped__)
    notices.warn_once.cache_clear()
    return candidates[0]


def list_kernel_files(folder):
    return sorted(folder.rglob("*.nbc"))


@NEEDS_JIT
def test_a_kernel_is_compiled_once(folder, caplog):
    first, second = make_kernel(), make_kernel()
    assert (first(1), second(1), second(1.5)) == (2, 2, 2.5)
    assert count_cache_hits(first) == 0 and count_cache_hits(second) == 1
    assert len(list_kernel_files(folder)) == 2
    assert caplog.messages == []


def remove_content(content):
    return b""


def truncate(content):
    return content[: len(content) // 2]


def replace_content(content):
    return b"\x80\x05garbage."


def flip_bit(fraction):
    def flip(content):
        index = int(fraction * (len(content) - 1))
        return content[:index] + bytes([content[index] ^ 0x10]) + content[index + 1 :]

    return flip


DAMAGES = [
    remove_content,
    truncate,
    replace_content,
    *(flip_bit(tenth / 10) for tenth in range(11)),
]


@NEEDS_JIT
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_kernel_is_compiled_again(damage, folder, caplog):
    make_kernel()(1)
    (path,) = list_kernel_files(folder)
    content = path.read_bytes()
    path.write_bytes(damage(content))
    recompiled = make_kernel()
    assert recompiled(1) == 2 and count_cache_hits(recompiled) == 0
    (message,) = caplog.messages
    assert str(folder) in message and "damaged" in message and "\n" not in message
    reloaded = make_kernel()
    assert reloaded(1) == 2 and count_cache_hits(reloaded) == 1
    assert len(caplog.messages) == 1 and list_kernel_files(folder) == [path]


@NEEDS_JIT
def test_damage_is_reported_once(folder, caplog):
    first = make_kernel()
    first(1), first(1.5)
    for path in list_kernel_files(folder):
        path.write_bytes(b"")
    recompiled = make_kernel()
    assert (recompiled(1), recompiled(1.5)) == (2, 2.5)
    assert len(caplog.messages) == 1


@NEEDS_JIT
def test_kernels_that_fail_to_load_are_compiled_again(folder, caplog, monkeypatch):
    make_kernel()(1)

    def fail(*parts):
        raise AttributeError("gone in this version")

    monkeypatch.setattr(KernelCache._impl_class, "rebuild", fail)
    assert make_kernel()(1) == 2
    (message,) = caplog.messages
    assert str(folder) in message and "gone in this version" in message


@contextmanager
def fill_disk(files, path):
    """Fail as a file on a full disk."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    yield


@NEEDS_JIT
def test_a_full_disk_does_not_stop_compilation(folder, caplog, monkeypatch):
    monkeypatch.setattr(IndexDataCacheFile, "_open_for_write", fill_disk)
    assert make_kernel()(1) == 2
    (message,) = caplog.messages
    assert str(folder) in message and "No space left" in message
    assert {path.suffix for path in folder.iterdir()} <= {".lock"}


@NEEDS_JIT
def test_second_folder_is_used_if_first_is_unwritable(folder, caplog):
    # A file where a folder should be: not even root can write below it.
    folder.parent.write_text("")
    assert make_kernel()(1) == 2
    assert len(list_kernel_files(folder.parents[1] / "temporary")) == 1
    reloaded = make_kernel()
    assert reloaded(1) == 2 and count_cache_hits(reloaded) == 1
    assert caplog.messages == []


@NEEDS_JIT
def test_folders_are_accessible_to_the_user_only(folder):
    make_kernel()(1)
    status = folder.stat()
    assert status.st_mode & 0o777 == 0o700 and status.st_uid == os.getuid()


class _ForeignCode:
    """An object that runs foreign code when it is unpickled."""

    def __reduce__(self):
        return exec, ("raise SystemExit('foreign code runs')",)


def test_kernels_of_old_versions_are_removed(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "compute_kernels_digest", lambda: "new")
    for name, age in (("numba-old", 2.0), ("numba-recent", 0.5), ("notes", 2.0)):
        (tmp_path / name).mkdir()
        timestamp = time.time() - age * cache.MAX_UNUSED_AGE_S
        os.utime(tmp_path / name, (timestamp, timestamp))
    make_private_folder(tmp_path / "numba-new")
    remaining = {folder.name for folder in tmp_path.iterdir()}
    assert remaining == {"numba-recent", "numba-new", "notes"}


def plant_foreign_kernel(folder):
    """Replace the kernel by a foreign file with a matching checksum."""
    make_kernel()(1)
    (path,) = list_kernel_files(folder)
    content = pickle.dumps(_ForeignCode())
    path.write_bytes(hashlib.sha256(content).digest() + content)


def test_the_planted_file_runs_foreign_code(folder):
    with pytest.raises(SystemExit):
        pickle.loads(pickle.dumps(_ForeignCode()))


@NEEDS_JIT
@pytest.mark.parametrize("violation", ["open to others", "a link", "of another user"])
def test_folders_writable_by_others_are_not_read(violation, folder, caplog, monkeypatch):
    plant_foreign_kernel(folder)
    if violation == "open to others":
        folder.chmod(0o777)
    elif violation == "a link":
        folder.rename(folder.with_name("elsewhere"))
        folder.symlink_to(folder.with_name("elsewhere"))
    else:
        monkeypatch.setattr(cache, "_get_user_id", lambda: os.getuid() + 1)
    assert make_kernel()(1) == 2
    assert str(folder) in caplog.messages[0] and "own" in caplog.messages[0]
    if violation != "of another user":
        assert len(list_kernel_files(folder.parents[1] / "temporary")) == 1


def test_each_user_has_a_folder_in_a_shared_one(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    first, last = cache._list_candidates()
    name = f"splits-{os.getuid()}-numba-{cache.compute_kernels_digest()}"
    assert (first, last) == (tmp_path / name, Path(tempfile.gettempdir()) / name)


def test_users_without_a_home_use_the_temporary_folder(monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    (only,) = cache._list_candidates()
    assert only.parent == Path(tempfile.gettempdir())


@NEEDS_JIT
def test_without_a_folder_kernels_serve_one_process(folder, caplog, monkeypatch):
    monkeypatch.setattr(cache, "_list_candidates", lambda: ())
    assert make_kernel()(1) == 2
    assert "not kept" in caplog.messages[0]


def test_a_warning_is_printed_once_and_unchanged(capsys, monkeypatch):
    notices.warn_once.cache_clear()
    logger = logging.getLogger(notices.__name__)
    monkeypatch.setattr(logger, "handlers", [logging._StderrHandler(logging.WARNING)])
    monkeypatch.setattr(logger, "propagate", False)
    notices.warn_once("one line")
    notices.warn_once("one line")
    assert capsys.readouterr().err == "one line\n"


def run_processes(folder, count=1):
    """Return the outputs of concurrent processes that cache their kernels in a folder."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(folder)
    processes = [
        subprocess.Popen(
            COMMAND, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(count)
    ]
    return [(*process.communicate(timeout=300), process.returncode) for process in processes]


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_processes_share_kernels_and_recover_from_damage(tmp_path):
    outputs = run_processes(tmp_path, 3)
    assert {(stderr, code) for _, stderr, code in outputs} == {("", 0)}
    (numbers,) = {stdout.splitlines()[0] for stdout, *_ in outputs}
    ((stdout, stderr, code),) = run_processes(tmp_path)
    assert (stdout, stderr, code) == (f"{numbers}\n3\n", "", 0)
    for path in tmp_path.rglob("*.nb*"):
        content = path.read_bytes()
        path.write_bytes(flip_bit(0.5)(content))
    ((stdout, stderr, code),) = run_processes(tmp_path)
    assert (stdout.splitlines()[0], code) == (numbers, 0)
    # A damaged index is that of no kernel, which is not reported.
    assert all(str(tmp_path) in line for line in stderr.splitlines())
    ((stdout, stderr, code),) = run_processes(tmp_path)
    assert (stdout, stderr, code) == (f"{numbers}\n3\n", "", 0)


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
def test_one_of_several_concurrent_processes_compiles(tmp_path):
    script = tmp_path / "slow.py"
    script.write_text(CONCURRENT_PROGRAM)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    processes = [subprocess.Popen([sys.executable, script], **pipes) for _ in range(3)]
    for process in processes:  # start all of them before waiting for any
        process.stdin.write("go\n")
        process.stdin.flush()
    outputs = sorted(process.communicate(timeout=300)[0] for process in processes)
    assert outputs == ["go 2 0\n"] + 2 * ["go 2 1\n"]


LOCKED = f"""{KERNEL}
from splits.kernels.compiler.cache import KernelCache
with KernelCache(slow).hold_lock():
    print(1, flush=True)
    input()
"""


@NEEDS_JIT
def test_lock_is_released_when_its_process_is_killed(tmp_path):
    script = tmp_path / "locked.py"
    script.write_text(LOCKED)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": environment}
    first = subprocess.Popen([sys.executable, script], **pipes)
    assert first.stdout.readline() == b"1\n"
    second = subprocess.Popen([sys.executable, script], **pipes)
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
def test_lock_is_released_after_a_failed_compilation(tmp_path):
    script = tmp_path / "fails.py"
    script.write_text(FAILURES)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    failed = subprocess.Popen([sys.executable, script, "fail"], **pipes)
    assert failed.stdout.readline() == "interrupted\n"
    other = subprocess.run(
        [sys.executable, script],
        input="\n",
        capture_output=True,
        text=True,
        env=environment,
        timeout=60,
    )
    assert other.stdout == "2\n"
    failed.communicate("\n")


@NEEDS_JIT
def test_a_file_system_without_locks_does_not_stop_compilation(folder, monkeypatch):
    def fail(*given, **settings):
        raise NotImplementedError

    monkeypatch.setattr(cache.FileLock, "acquire", fail)
    assert make_kernel()(1) == 2


@NEEDS_JIT
def test_a_change_of_the_file_of_a_kernel_is_noticed(folder, monkeypatch):
    """Kernels may be outside of the sources whose digest names the folder."""
    make_kernel()(1)
    monkeypatch.setattr(cache, "_hash_file", lambda path: "changed")
    changed = make_kernel()
    assert changed(1) == 2 and count_cache_hits(changed) == 0
