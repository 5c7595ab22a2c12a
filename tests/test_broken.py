"""The corpus of broken cases: every fault is told in one line, with its place and what to do.

Each file ends with comments ``# expect: 7: rocks.salt.viscosity: ...``: the line and the beginning
of a message; a comment without a number expects its text anywhere in a message. Section files that
are broken lie in ``broken/sections``.
"""

import os
import random
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration.cli import main
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.words import UNWRITABLE

FOLDER = Path(__file__).parent / "broken"
BROKEN = sorted(FOLDER.glob("*.yaml"))
EXPECTED = re.compile(r"# expect: (?:(\d+): )?(.*)")


SECONDS = 2  # of computing, at most, of a refusal in this process
PEAK_MB = 300  # of a process of its own


def test_the_corpus_is_large():
    assert len(BROKEN) >= 250


def test_all_files_of_the_corpus_are_named_by_a_case():
    named = "\n".join(path.read_text(encoding="utf-8", errors="replace") for path in BROKEN)
    assert [path.name for path in (FOLDER / "sections").iterdir() if path.name not in named] == []


@pytest.mark.parametrize("path", BROKEN, ids=lambda path: path.stem)
def test_every_fault_is_told(path, capsys, monkeypatch):
    """By the command, in this process: exit code 2, a line for each fault, nothing else."""
    monkeypatch.chdir(path.parent)
    expected = EXPECTED.findall(path.read_text(encoding="utf-8", errors="replace"))
    assert expected
    begin = time.process_time()
    assert main(["check", path.name]) == 2
    assert time.process_time() - begin < SECONDS
    said = capsys.readouterr()
    told = [line for line in said.err.splitlines() if not line.startswith("warning: ")]
    assert said.out == ""
    assert not UNWRITABLE.search("".join(told))
    for line, text in expected:
        place = rf"[^:]*:{line}(:\d+)?: " if line else ".*"
        assert any(re.match(place + re.escape(text), row) for row in told), (line, text, told)
    # nothing is told beyond what is wrong: at most two rows for one expectation
    assert len(told) <= 2 * len(expected), told


SOME = [*BROKEN[::45], *(FOLDER / f"file-{name}.yaml" for name in ("overlap", "series-compressed"))]


@pytest.mark.parametrize("path", SOME, ids=lambda path: path.stem)
def test_a_refusal_takes_little(path, tmp_path):
    """Of a process of its own: seconds of computing and the most memory it held."""
    (tmp_path / "limited.py").write_text(LIMITED)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "limited.py"), "check", str(path)],
        env=os.environ | {"PYTHONPATH": str(FOLDER.parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    seconds, peak_mb = map(float, done.stdout.split())
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert seconds < SECONDS
    assert peak_mb < PEAK_MB


LIMITED = """
import resource, sys
from restoration.cli import main

code = main(sys.argv[1:])
used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
# what getrusage tells of this process is at least what its parent held when it forked
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
peak = max(int(status["VmHWM"].split()[0]), used[1].ru_maxrss)
print(sum(u.ru_utime + u.ru_stime for u in used), peak / 1024)
sys.exit(code)
"""


def test_no_mutation_of_a_case_escapes(tmp_path):
    """Whatever is done to a case file, it is read or refused, never crashed on."""
    rng = random.Random(5)
    text = (FOLDER.parents[1] / "cases/diapir-isoviscous/case.yaml").read_text(encoding="utf-8")
    signs = [*"{}[]:,-#'\"!&*|>%@` \t\n0eE.+~", "nan", "null", "1e999", "\N{OHM SIGN}", "\0"]
    outcomes = set()
    for _ in range(400):
        mutant = list(text)
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(mutant))
            if rng.random() < 0.6:
                mutant[at] = rng.choice(signs)
            else:
                del mutant[at : at + rng.randint(1, 30)]
        path = tmp_path / "case.yaml"
        path.write_text("".join(mutant), encoding="utf-8")
        try:
            load(path)
            outcomes.add("read")
        except CaseError as error:
            outcomes.add("refused" if str(error).strip() else "refused without a word")
    assert outcomes == {"read", "refused"}


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.yaml", b"", "is empty"),
        ("blank.yaml", b" \n\n", "is empty"),
        ("binary.yaml", bytes(range(256)), "is a binary file"),
        ("image.png", b"\x89PNG\r\n\x1a\n" + bytes(50), "is a binary file"),
        ("latin.yaml", "title: Z\xfcrich".encode("latin-1"), "is not UTF-8 text"),
        ("utf16.yaml", "title: x".encode("utf-16"), "is UTF-16 text"),
        ("huge.yaml", b"# " + b"x" * 1_100_000, "at most 1 MB are read"),
        ("zip.yaml", b"PK\x03\x04aaaa", "is a zip archive"),
    ],
)
def test_files_that_are_no_case(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CaseError, match=message):
        load(tmp_path / name)


def test_files_that_are_not_there(tmp_path):
    (tmp_path / "case.yaml").write_text("section:")
    with pytest.raises(CaseError, match=r"no such file; did you mean 'case.yaml'"):
        load(tmp_path / "cas.yaml")
    with pytest.raises(CaseError, match=r"is a folder; name the file in it"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("mesh.cells=x", "--set mesh.cells: 'x'"),
        ("mesh.cels=5", "--set mesh.cels: no such entry; did you mean 'cells'"),
        ("mesh", "write --set entry=value"),
        ("section.layers.7.rock=salt", "section.layers is a list of 2"),
        ("title.deep=1", "title is"),
        ("rocks.salt.viscosity=1e21", "has no unit"),
        ("time.marks=[0 Myr", "cannot be read as YAML"),
        ("=5", "write --set entry=value"),
    ],
)
def test_overrides_that_are_wrong(override, message):
    with pytest.raises(CaseError, match=re.escape(message)):
        load(FOLDER.parents[1] / "cases/diapir-isoviscous/case.yaml", [override])
