"""Archives from untrusted sources: rejected in one line, or unpacked completely."""

import json
import os
import random
import signal
import stat
import subprocess
import sys
import warnings
import zipfile
from hashlib import sha256

import pytest

import splits.io.unarchive
from splits.experiments.archive import pack_archive
from splits.io.ro_crate import METADATA_FILE
from splits.io.unarchive import ArchiveError, unpack_archive, verify_archive

DATA = "data/a.nc"


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    """Return the path of an archive packed as in the workflow."""
    root = tmp_path_factory.mktemp("packed")
    for name in (DATA, "figures/a.png", "tables/deep/with a space.csv"):
        path = root / "out" / name
        path.parent.mkdir(parents=True)
        path.write_bytes(name.encode() * 100)
    results = [path for path in (root / "out").rglob("*") if path.is_file()]
    pack_archive(
        results, {"config/config.yaml": b"seed: 1\n"}, root / "out" / "archive" / "made.zip"
    )
    return root / "out" / "archive" / "made.zip"


@pytest.fixture
def members(packed):
    with zipfile.ZipFile(packed) as file:
        return {name: file.read(name) for name in file.namelist()}


@pytest.fixture
def assert_rejected(tmp_path):
    """Return a function that asserts that a zip file is rejected and leaves no files."""

    def check(path, match):
        before = sorted(tmp_path.rglob("*"))
        for attempt in (
            verify_archive,
            lambda archive: unpack_archive(archive, tmp_path / "target"),
        ):
            with pytest.raises(ArchiveError, match=match) as error:
                attempt(path)
            assert "\n" not in str(error.value)
            assert str(error.value).startswith(f"{path}: rejected, ")
        assert sorted(tmp_path.rglob("*")) == before

    return check


def list_members(members, add=(), change=None):
    """Return members with further files listed in the metadata, and with changed metadata."""
    crate = json.loads(members[METADATA_FILE])
    graph = {entity["@id"]: entity for entity in crate["@graph"]}
    for name, content in dict(add).items():
        graph[name] = {
            "@id": name, "@type": "File", "contentSize": str(len(content)),
            "sha256": sha256(content).hexdigest(),
        }  # fmt: skip
        graph["./"]["hasPart"].append({"@id": name})
    crate["@graph"] = list(graph.values())
    if change:
        change(crate, graph)
    return members | dict(add) | {METADATA_FILE: json.dumps(crate).encode()}


def write_zip(path, members, edit=None, method=zipfile.ZIP_DEFLATED):
    """Write a zip file of plain files; `edit` changes it before its directory is written."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of duplicate names
        with zipfile.ZipFile(path, "w") as file:
            for name, content in members.items() if isinstance(members, dict) else members:
                info = zipfile.ZipInfo(name)
                info.compress_type = method
                info.external_attr = (stat.S_IFREG | 0o644) << 16
                file.writestr(info, content)
            if edit:
                edit(file)
    return path


def test_unpacked_files_equal_the_packed_files(packed, members, tmp_path):
    report = unpack_archive(packed, tmp_path / "target")
    unpacked = {
        path.relative_to(tmp_path / "target").as_posix(): path.read_bytes()
        for path in (tmp_path / "target").rglob("*")
        if path.is_file()
    }
    assert unpacked == members
    assert report == verify_archive(packed)
    assert report.sha256 == sha256(packed.read_bytes()).hexdigest()
    assert report.n_files == len(members)
    assert report.n_bytes == sum(map(len, members.values()))
    assert report.license == "https://spdx.org/licenses/MIT"
    assert f"{len(members)} files" in str(report) and report.sha256 in str(report)
    assert [path.name for path in tmp_path.iterdir()] == ["target"]
    assert not any(path.stat().st_mode & 0o111 for path in tmp_path.rglob("*") if path.is_file())


def test_target_must_be_a_new_or_empty_folder(packed, tmp_path):
    (tmp_path / "empty").mkdir()
    unpack_archive(packed, tmp_path / "empty")
    assert (tmp_path / "empty" / DATA).is_file()
    (tmp_path / "link").symlink_to(tmp_path / "empty")
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    for name in ("empty", "link", "file"):
        with pytest.raises(ValueError, match=r"^folder = .*: must be a new or an empty folder$"):
            unpack_archive(packed, tmp_path / name)
    with pytest.raises(ValueError, match=r"^folder = .*: must be in a folder that exists$"):
        unpack_archive(packed, tmp_path / "none" / "target")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_missing_library_is_named(packed, monkeypatch):
    monkeypatch.setitem(sys.modules, "rocrate", None)
    with pytest.raises(ModuleNotFoundError, match="need the package rocrate: pip install"):
        verify_archive(packed)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("/etc/passwd", "a path out of the folder"),
        ("C:/x.nc", "a name with characters that not all systems have"),
        ("c:x.nc", "a name with characters that not all systems have"),
        ("../x.nc", "a path out of the folder"),
        ("data/../../x.nc", "a path out of the folder"),
        ("data/..", "a path out of the folder"),
        ("data\\x.nc", "a name with characters that not all systems have"),
        ("..\\x.nc", "a name with characters that not all systems have"),
        ("\\\\server\\x.nc", "a name with characters that not all systems have"),
        ("data/folder/", "a hidden name, or one that not all systems have"),
        ("data//x.nc", "a hidden name, or one that not all systems have"),
        ("./README.md", "a hidden name, or one that not all systems have"),
        ("data/x.nc.", "a hidden name, or one that not all systems have"),
        ("data/x.nc ", "a hidden name, or one that not all systems have"),
        ("data/nul.nc", "a hidden name, or one that not all systems have"),
        ("data/x.nc:stream", "a name with characters that not all systems have"),
        ("data/\x1b[2J.nc", "a name with characters that not all systems have"),
        ("data/\u202ecn.exe", "a name with characters that not all systems have"),
        ("data/" + "x" * 256, "too long a name"),
        ("data/" + "x/" * 600 + "x", "too long a name"),
        ("profiles/default/config.yaml", "not a file of an archive"),
        (".snakemake/x", "a hidden name, or one that not all systems have"),
        ("yaml.py", "not a file of an archive"),
        ("data", "not a file of an archive"),
        ("autorun.inf", "not a file of an archive"),
        (".bashrc", "a hidden name, or one that not all systems have"),
        ("config/__init__.py", "not a file type of config/ in an archive"),
        ("data/x.SO", "not a file type of data/ in an archive"),
        ("data/autorun.inf", "not a file type of data/ in an archive"),
        ("data/Desktop.INI", "not a file type of data/ in an archive"),
        ("data/x.ps1", "not a file type of data/ in an archive"),
        ("data/x.nc.js", "not a file type of data/ in an archive"),
        ("data/x.lnk", "not a file type of data/ in an archive"),
        ("data/x", "not a file type of data/ in an archive"),
        ("figures/x.desktop", "not a file type of figures/ in an archive"),
        ("figures/x.html", "not a file type of figures/ in an archive"),
        ("figures/x.nc", "not a file type of figures/ in an archive"),
        ("tables/x.xlsm", "not a file type of tables/ in an archive"),
        ("config/x.envrc", "not a file type of config/ in an archive"),
        ("data/.x.nc", "a hidden name, or one that not all systems have"),
        ("config/.git/config.yaml", "a hidden name, or one that not all systems have"),
        ("config/.csv", "a hidden name, or one that not all systems have"),
    ],
)
def test_unsafe_names_are_rejected(name, reason, members, tmp_path, assert_rejected):
    path = write_zip(tmp_path / "bad.zip", list_members(members, {name: b"x"}))
    assert_rejected(path, reason)


def test_a_name_with_a_null_character_is_rejected(members, tmp_path, assert_rejected):
    path = write_zip(tmp_path / "bad.zip", list_members(members, {"data/xy.nc": b"x"}))
    path.write_bytes(path.read_bytes().replace(b"data/xy.nc", b"data/x\0.nc"))
    assert_rejected(path, "a name with characters")


@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ((stat.S_IFLNK | 0o777) << 16, "a symbolic link"),
        ((stat.S_IFIFO | 0o644) << 16, "no plain file"),
        ((stat.S_IFCHR | 0o644) << 16, "no plain file"),
        ((stat.S_IFBLK | 0o644) << 16, "no plain file"),
        ((stat.S_IFSOCK | 0o644) << 16, "no plain file"),
        ((stat.S_IFDIR | 0o755) << 16, "no plain file"),
        (0x10, "no plain file"),
        ((stat.S_IFREG | 0o744) << 16, "an executable file"),
        (0o611 << 16, "an executable file"),
        ((stat.S_IFREG | 0o4644) << 16, "an executable file"),
    ],
)
def test_members_other_than_regular_files_are_rejected(
    attributes, reason, members, tmp_path, assert_rejected
):
    def edit(file):
        file.NameToInfo[DATA].external_attr = attributes

    assert_rejected(write_zip(tmp_path / "bad.zip", members, edit), f"'{DATA}' is {reason}")


@pytest.mark.parametrize(
    "extra", [DATA, "data/A.nc", "data/a.nc/b.nc", "data/ａ.nc", "Config/config.yaml"]
)
def test_colliding_names_are_rejected(extra, members, tmp_path, assert_rejected):
    entries = [*list_members(members, {extra: b"x"}).items()]
    entries += [(DATA, b"x")] if extra == DATA else []
    reason = (
        "not a file of an archive"
        if extra.startswith("C")
        else "occurs twice, or its name differs in case only"
    )
    assert_rejected(write_zip(tmp_path / "bad.zip", entries), reason)


def test_folders_that_differ_in_case_are_rejected(members, tmp_path, assert_rejected):
    extra = {"tables/Deep/other.csv": b"x"}
    assert_rejected(
        write_zip(tmp_path / "bad.zip", list_members(members, extra)), "differs in case only"
    )


def test_zip_bombs_are_rejected(members, tmp_path, assert_rejected, monkeypatch):
    bomb = list_members(members, {"data/bomb.nc": bytes(2**25)})
    assert_rejected(
        write_zip(tmp_path / "bomb.zip", bomb), "it would unpack to too many times its size"
    )
    path = write_zip(tmp_path / "large.zip", members)
    with monkeypatch.context() as patch:
        patch.setattr(splits.io.unarchive, "MAX_UNPACKED_BYTES", 1000)
        assert_rejected(path, "it would unpack to more than")
    with monkeypatch.context() as patch:
        patch.setattr(splits.io.unarchive, "MAX_METADATA_BYTES", 1000)
        assert_rejected(path, "has more than")
    with monkeypatch.context() as patch:
        patch.setattr(splits.io.unarchive, "MAX_MEMBERS", 3)
        assert_rejected(path, "more than 3 members")
    assert verify_archive(path).n_files == len(members)


@pytest.mark.parametrize("declared", [10, 10**6])
def test_wrong_declared_sizes_are_rejected(declared, members, tmp_path, assert_rejected):
    def edit(file):
        file.NameToInfo[DATA].file_size = declared

    assert_rejected(
        write_zip(tmp_path / "bad.zip", members, edit), r"data/a\.nc|not a valid zip file"
    )


def test_members_that_share_bytes_are_rejected(members, tmp_path, assert_rejected):
    def edit(file):
        duplicate = zipfile.ZipInfo("data/again.nc")
        first = file.NameToInfo[DATA]
        for key in ("header_offset", "file_size", "compress_size", "CRC", "compress_type"):
            setattr(duplicate, key, getattr(first, key))
        file.filelist.append(duplicate)

    listed = list_members(members, {"data/again.nc": members[DATA]})
    listed.pop("data/again.nc")
    assert_rejected(write_zip(tmp_path / "bad.zip", listed, edit), "not a valid zip file")


def test_encrypted_and_unusual_members_are_rejected(members, tmp_path, assert_rejected):
    def encrypt(file):
        file.NameToInfo[DATA].flag_bits |= 1

    assert_rejected(write_zip(tmp_path / "secret.zip", members, encrypt), "is encrypted")
    unusual = write_zip(tmp_path / "odd.zip", members, method=zipfile.ZIP_LZMA)
    assert_rejected(unusual, "is compressed in an unusual way")


def test_members_missing_unlisted_or_changed_are_rejected(members, tmp_path, assert_rejected):
    path = tmp_path / "bad.zip"
    remaining = {name: content for name, content in members.items() if name != DATA}
    assert_rejected(write_zip(path, remaining), r"'data/a\.nc' is listed, but missing \(1 files\)")
    assert_rejected(
        write_zip(path, members | {"data/b.nc": b"x"}), r"'data/b\.nc' is not listed \(1 files\)"
    )
    changed = members | {DATA: members[DATA][:-1] + b"!"}
    assert_rejected(
        write_zip(path, changed), r"data/a\.nc is not the file that ro-crate-metadata\.json lists"
    )
    longer = members | {DATA: members[DATA] + b"!"}
    assert_rejected(write_zip(path, longer), r"data/a\.nc is not the file that")
    remaining = {name: content for name, content in members.items() if name != METADATA_FILE}
    assert_rejected(write_zip(path, remaining), "no RO-Crate, ro-crate-metadata.json is missing")


def _make_drop_edit(identifier, key):
    return lambda crate, graph: graph[identifier].pop(key)


def _make_set_edit(identifier, key, value):
    return lambda crate, graph: graph[identifier].__setitem__(key, value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda crate, graph: crate.pop("@graph"), "no RO-Crate"),
        (lambda crate, graph: crate["@graph"].append("x"), "no RO-Crate"),
        (lambda crate, graph: crate.pop("@context"), "no RO-Crate"),
        (lambda crate, graph: crate["@graph"].append({"@id": DATA}), "no RO-Crate"),
        (lambda crate, graph: crate["@graph"].append({"@type": "File"}), "no RO-Crate"),
        (_make_set_edit(METADATA_FILE, "about", {"@id": "data/"}), "no RO-Crate"),
        (_make_set_edit("./", "@type", "File"), "no RO-Crate"),
        (_make_drop_edit("./", "name"), r"no RO-Crate.*\('name'\)"),
        (_make_drop_edit("./", "license"), r"no RO-Crate.*\('license'\)"),
        (_make_set_edit("./", "hasPart", {"@id": DATA}), "no RO-Crate"),
        (_make_drop_edit(DATA, "sha256"), "is not the file that"),
        (_make_set_edit(DATA, "sha256", "a" * 63), "is not the file that"),
        (_make_set_edit(DATA, "sha256", ["a"]), "is not the file that"),
        (_make_set_edit(DATA, "@type", "Thing"), "is not listed"),
        (_make_set_edit(DATA, "@id", "data/%61.nc"), "no RO-Crate"),
    ],
)
def test_invalid_crate_metadata_are_rejected(change, reason, members, tmp_path, assert_rejected):
    assert_rejected(write_zip(tmp_path / "bad.zip", list_members(members, change=change)), reason)


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\xff", b"{", b"[" * 100_000, b'{"a": 1, "a": 2}', b"[]", b"{}", b"9" * 5000, b"null",
        b'"https://example.org/crate"', b'"/etc"',
    ],
)  # fmt: skip
def test_invalid_json_metadata_are_rejected(content, members, tmp_path, assert_rejected):
    assert_rejected(
        write_zip(tmp_path / "bad.zip", members | {METADATA_FILE: content}),
        "no RO-Crate",
    )


def test_files_other_than_zip_are_rejected(packed, tmp_path, assert_rejected):
    path = tmp_path / "bad.zip"
    content = packed.read_bytes()
    for damaged in (b"", b"x" * 100, content[:-1], content[: len(content) // 2], content[1:]):
        path.write_bytes(damaged)
        assert_rejected(path, "not a valid zip file")
    path.write_bytes(b"#!/bin/sh\n" + content)
    assert_rejected(path, "not a valid zip file")
    with pytest.raises(ValueError, match=r"^archive = .*must be a zip file$"):
        verify_archive(tmp_path)
    with pytest.raises(FileNotFoundError):
        verify_archive(tmp_path / "none.zip")


def test_damaged_bytes_are_detected(packed, members, tmp_path):
    """After a change of one byte the archive is rejected or unpacks to the same files."""
    content = packed.read_bytes()
    path = tmp_path / "damaged.zip"
    rng = random.Random(20)
    n_rejected = 0
    for attempt in range(300):
        # Half of the changes are in the central directory, which controls how the file is read.
        first = 0 if attempt % 2 else content.index(b"PK\1\2")
        position = rng.randrange(first, len(content))
        damaged = bytearray(content)
        damaged[position] ^= rng.randrange(1, 256)
        path.write_bytes(damaged)
        try:
            report = verify_archive(path)
        except ArchiveError as error:
            assert "\n" not in str(error)
            n_rejected += 1
        else:
            assert (report.n_files, report.n_bytes) == (
                len(members),
                sum(map(len, members.values())),
            )
    assert n_rejected > 150


def test_control_characters_of_metadata_are_not_printed(members, tmp_path):
    named = list_members(members, change=_make_set_edit("./", "name", "\x1b[2J\nall is well"))
    report = verify_archive(write_zip(tmp_path / "odd.zip", named))
    assert "\x1b" not in str(report) and len(str(report).splitlines()) == 3


KILLED_PROGRAM = """
import os, signal, sys
import splits.io.unarchive

def die(file, info, target):
    (target / "half").write_bytes(b"half a fi")
    os.kill(os.getpid(), signal.SIGKILL)

splits.io.unarchive._copy_member = die
splits.io.unarchive.unpack_archive(*sys.argv[1:])
"""


def test_leftovers_of_a_killed_unpack_are_removed(packed, tmp_path):
    command = [sys.executable, "-c", KILLED_PROGRAM, str(packed), str(tmp_path / "target")]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    (leftover,) = tmp_path.iterdir()
    assert leftover.name.startswith(".aside.") and (leftover / "half").exists()
    os.utime(leftover, (0, 0))
    unpack_archive(packed, tmp_path / "other")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
