"""Reading by another process: whatever becomes of it, this one gets a file or a line."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from restoration.apart import GB, REFUSED, answer, read_apart
from restoration.errors import CaseError
from tests.forked import Forked

READER = """
import ctypes, os, signal, sys, time
from restoration.apart import answer
from restoration.errors import CaseError

def echo(filled, *words): filled.write(" ".join(words).encode())
def crash(filled): ctypes.string_at(0)
def loop(filled):
    while True: pass
def swell(filled): filled.write(bytes(3 * 2**30))
def refuse(filled): raise CaseError("is\\x1b[31m no\\nseries")
def launched(filled): filled.write(",".join(n for n in os.environ if n.startswith("OMPI")).encode())
def bug(filled): 1 / 0

sys.exit(answer(lambda filled, what, *words: globals()[what](filled, *words)))
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "reader_of_this_test.py").write_text(READER)

    def reader(*words):
        return read_apart("reader_of_this_test", words, "a.h5", 1, 2 * GB)

    return reader


def test_what_is_read_comes_back(read):
    with read("echo", "one", "two words") as answer:
        assert answer.read() == b"one two words"


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("crash", "a.h5: reading it was ended by signal 11; the file is damaged"),
        ("loop", "a.h5: reading it was ended by signal 9; the file is damaged"),
        ("swell", "a.h5: takes too much memory to be read; the file is damaged"),
        ("refuse", "a.h5: is?[31m no series"),
    ],
)
def test_whatever_goes_wrong_is_told_in_a_line(read, what, message):
    with pytest.raises(CaseError) as caught:
        read(what)
    assert str(caught.value) == message


def test_what_waits_too_long_is_ended(read, monkeypatch):
    """It may wait ten times as long as it may compute."""
    asked = []

    def waits(*_, timeout, **others):
        asked.append((timeout, others["env"]["OMP_NUM_THREADS"]))
        raise subprocess.TimeoutExpired("reader", timeout)

    monkeypatch.setattr("restoration.apart.subprocess.run", waits)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(CaseError, match=r"^a\.h5: reading it took too long; the file is damaged$"):
        read("echo")
    assert asked == [(10, "1")]
    assert len(os.listdir("/proc/self/fd")) == before


def test_what_cannot_happen_is_no_fault_of_the_file(read):
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        read("bug")


def test_a_reader_started_by_a_rank_is_no_rank(read, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    with read("launched") as answer:
        assert answer.read() == b""


def answered(tmp_path, read, *words, seconds=5, more=GB, by_argv=False):
    """Let a fork answer as the other process does; return its exit code, what it said and gave.

    Args:
        tmp_path: folder.
        read: as of `answer`.
        words: for it.
        seconds: of computing.
        more: address space that it may take beside that of this process, bytes.
        by_argv: whether it is told all by its command line.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith("VmSize"))
    memory = int(line.split()[1]) * 1024 + more
    with (tmp_path / "given").open("w+b") as given, (tmp_path / "said").open("w+b") as said:
        told = [str(given.fileno()), str(seconds), str(memory), *words]

        def other():
            os.dup2(said.fileno(), 2)
            sys.stderr = os.fdopen(2, "w", buffering=1)
            sys.argv = ["reader", *told]
            return answer(read) if by_argv else answer(read, told)

        code = Forked(other).wait(60)
        return code, (tmp_path / "said").read_text(), (tmp_path / "given").read_bytes()


@pytest.mark.parametrize("by_argv", [False, True])
def test_what_is_read_is_left_in_the_file(tmp_path, by_argv):
    def read(filled, *words):
        filled.write(" ".join(words).encode())

    assert answered(tmp_path, read, "a", "b", by_argv=by_argv) == (0, "", b"a b")


def test_why_a_file_is_refused_is_said(tmp_path):
    def read(_):
        raise CaseError("is no series")

    assert answered(tmp_path, read) == (REFUSED, "is no series\n", b"")
    assert REFUSED == CaseError.exit_code


def test_more_memory_than_allowed_is_refused(tmp_path):
    assert GB == 1073741824
    code, said, _ = answered(tmp_path, lambda _: bytes(2 * GB))
    assert (code, said) == (2, "takes too much memory to be read; the file is damaged\n")
    assert answered(tmp_path, lambda _: bytes(2 * GB), more=4 * GB)[0] == 0


def test_more_computing_than_allowed_is_ended(tmp_path):
    def read(_):
        while True:
            pass

    assert answered(tmp_path, read, seconds=1)[0] < 0


def test_a_crash_leaves_no_core(tmp_path):
    def read(filled):
        filled.write(repr(resource.getrlimit(resource.RLIMIT_CORE)).encode())

    assert answered(tmp_path, read)[2] == b"(0, 0)"
