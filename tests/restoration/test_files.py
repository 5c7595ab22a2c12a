"""Input files: what is read, what is refused, and with which words."""

import hashlib
import os

import pytest

from restoration import files
from restoration.errors import CaseError
from restoration.files import MB, digest, inside, near_file, read_text


def refused(path, **options):
    with pytest.raises(CaseError) as caught:
        read_text(path, "case.yaml", **options)
    return str(caught.value)


def test_text_is_read(tmp_path):
    path = tmp_path / "case.yaml"
    for content in (b"title: \xc3\xa4\n", b"\xef\xbb\xbftitle: \xc3\xa4\n"):
        path.write_bytes(content)
        assert read_text(path, "case.yaml") == "title: \u00e4\n"
    path.write_bytes(b"a" * 10)
    assert read_text(str(path), "case.yaml", longest=10) == "a" * 10


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfea\0", "is UTF-16 text; save it as UTF-8"),
        (b"\xfe\xff\0a", "is UTF-16 text; save it as UTF-8"),
        (b"PK\x03\x04 and more", "is a zip archive; unpack it and name the file in it"),
        (b"title\0", "is a binary file, not text"),
        (b"", "is empty"),
        (b" \n\t\n", "is empty"),
    ],
)
def test_what_is_no_text_is_told(tmp_path, content, message):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert refused(path) == f"case.yaml: {message}"


def test_a_byte_that_is_no_text_is_told_with_its_line(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a\nb\nc \xe9\n")
    assert refused(path) == "case.yaml:3: byte 0xe9 is not UTF-8 text; save it as UTF-8"
    path.write_bytes(b"\xe9\n")
    assert refused(path).startswith("case.yaml:1: byte 0xe9")


def test_what_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a" * 11)
    assert refused(path, longest=10) == "case.yaml: is 0.0 MB large; at most 1e-05 MB are read"
    path.write_bytes(b"a" * (MB + 1))
    assert refused(path) == "case.yaml: is 1.0 MB large; at most 1 MB are read"
    os.truncate(path, 2_500_000)
    assert refused(path) == "case.yaml: is 2.5 MB large; at most 1 MB are read"


def test_a_file_that_grows_while_it_is_read_is_told(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"a" * 10)
    check = files._check

    def grown(*arguments):
        check(*arguments)
        path.write_bytes(b"a" * 20)
        monkeypatch.setattr(files, "_check", lambda *_: None)

    monkeypatch.setattr(files, "_check", grown)
    assert refused(path, longest=15) == "case.yaml: grows while it is read"


def test_what_becomes_a_pipe_before_it_is_opened_is_told(tmp_path, monkeypatch):
    """Neither waits for ever nor reads from it."""
    path = tmp_path / "file"
    path.write_text("a")
    check = files._check

    def swapped(*arguments):
        check(*arguments)
        monkeypatch.setattr(files, "_check", check)
        path.unlink()
        os.mkfifo(path)

    monkeypatch.setattr(files, "_check", swapped)
    assert refused(path) == "case.yaml: is not a regular file"


def test_folders_and_pipes_are_told(tmp_path):
    assert refused(tmp_path) == "case.yaml: is a folder; name the file in it"
    (tmp_path / "case.yaml").touch()
    with pytest.raises(CaseError) as caught:
        read_text(tmp_path, "runs/")
    assert str(caught.value) == "runs/: is a folder; name the file in it, such as runs/case.yaml"
    os.mkfifo(tmp_path / "pipe")
    assert refused(tmp_path / "pipe") == "case.yaml: is not a regular file"
    assert refused("/dev/zero") == "case.yaml: is not a regular file"


def test_what_is_missing_is_told_with_what_is_near(tmp_path):
    assert refused(tmp_path / "none") == "case.yaml: no such file"
    (tmp_path / "section.geojson").touch()
    assert refused(tmp_path / "sektion.geojson") == (
        "case.yaml: no such file; did you mean 'section.geojson'?"
    )
    assert refused(tmp_path / "sections" / "a") == (
        "case.yaml: no such file; there is no folder sections"
    )


def test_only_so_many_names_are_looked_through(tmp_path, monkeypatch):
    for name in ("a.txt", "section.txt"):
        (tmp_path / name).touch()
    monkeypatch.setattr(files, "MOST_NAMES", 1)
    assert near_file(tmp_path / "sektion.txt") == ""
    monkeypatch.setattr(files, "MOST_NAMES", 2)
    assert "section.txt" in near_file(tmp_path / "sektion.txt")


def test_what_the_system_refuses_is_told(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(link)
    assert refused(link) == "case.yaml: cannot be read: Too many levels of symbolic links"
    assert refused("a\0b") == "case.yaml: cannot be read: embedded null byte"


def test_nothing_stays_open(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a\0")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        refused(path)
        digest(path, "file", 10)
    assert len(os.listdir("/proc/self/fd")) == before


def test_digests(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a\0" * 1000)
    assert digest(str(path), "file", 2000) == hashlib.sha256(b"a\0" * 1000).digest()
    with pytest.raises(CaseError, match=r"file: is 0\.0 MB large"):
        digest(path, "file", 1999)


@pytest.mark.parametrize(
    "name", ["a\0b", "https://a/b", "file://b", "/vsicurl/x", "C:\\a", "c:/a", "S3://x"]
)
def test_addresses_are_no_files(tmp_path, name):
    for allow in (False, True):
        with pytest.raises(ValueError, match="is not a file name; copy the file beside the sweep"):
            inside(tmp_path, name, allow, of="sweep")


def test_backslashes_are_told_with_what_to_write(tmp_path):
    with pytest.raises(ValueError, match=r"'a\\b\\c' has backslashes; write a/b/c$"):
        inside(tmp_path, "a\\b\\c", allow_outside=True)


def test_files_stay_in_their_folder(tmp_path):
    folder = tmp_path / "case"
    (folder / "inner").mkdir(parents=True)
    (folder / "out").symlink_to(tmp_path)
    (folder / "within").symlink_to(folder / "inner")
    (folder / "round").symlink_to(folder / "round")
    allowed = r"; copy it into the folder of the case, or allow it with --allow-outside$"
    for name, what in (
        ("/etc/passwd", "is an absolute path"),
        ("../a", "leaves the folder of the case"),
        ("inner/../../a", "leaves the folder of the case"),
        ("out/a", "is a link out of the folder of the case"),
    ):
        with pytest.raises(ValueError, match=f"^'{name}' {what}{allowed}"):
            inside(folder, name)
        assert inside(str(folder), name, allow_outside=True) == folder / name
    with pytest.raises(ValueError, match="'round' is a link that leads nowhere"):
        inside(folder, "round")
    for name in ("a", "inner/a", "within/a", "..a", "./a"):
        assert inside(folder, name) == folder / name
