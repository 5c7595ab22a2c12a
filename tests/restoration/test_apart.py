"""Reading by another process: whatever becomes of it, this one gets a file or a line."""

import os
import subprocess

import pytest

from restoration.apart import GB, read_apart
from restoration.errors import CaseError

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
