"""The command `restore trade`: finds what is meant, searches, tells and keeps."""

import json
import shlex
import sys
from pathlib import Path

from restoration.errors import CaseError, RestorationError
from restoration.resolve import load
from restoration.trade.picture import draw_trade
from restoration.trade.questions import QUESTIONS
from restoration.trade.report import json_text, line, plain, words
from restoration.trade.search import BenchmarkSubject, CaseSubject, Worker, search
from restoration.trade.trials import done
from restoration.words import hint
from restoration.writing import disk_faults, write_text

STOPPED = 75  # exit code, see docs/design.md
SHIPPED = Path(__file__).parents[2] / "cases"
SUFFIXES = (".yaml", ".yml")


def subject_of(name, sets=(), outside=False):
    """Return what a name means: a case file, its folder, a benchmark, or a case that is shipped.

    Args:
        name: as given.
        sets: overrides, texts ``a.b=value``.
        outside: whether a case may name files outside its folder.

    Raises:
        CaseError: there is no such case or benchmark, or an override is wrong.
    """
    if name in QUESTIONS:
        return BenchmarkSubject(name, QUESTIONS[name], _settings(QUESTIONS[name], sets))
    path, shipped = Path(name), {case.parent.name: case for case in SHIPPED.glob("*/case.yaml")}
    if (path / "case.yaml").is_file():
        path = path / "case.yaml"
    elif name in shipped and not path.exists():
        path = shipped[name]
    if path.is_file() or path.suffix in SUFFIXES:
        return CaseSubject(path, load(path, tuple(sets), outside).scene, sets, outside)
    what = f"'{name}' is no case file, and no benchmark whose cost can be traded"
    raise CaseError(what + hint(name, [*QUESTIONS, *sorted(shipped)]))


def _settings(question, sets):
    """Return overrides of a benchmark as settings."""
    found = {}
    for text in sets:
        name, sign, value = text.partition("=")
        if name not in question.base or not sign:
            raise CaseError(f"--set {text}: no such setting{hint(name, question.base)}")
        kind = type(question.base[name])
        try:
            found[name] = kind(value)
        except ValueError:
            raise CaseError(f"--set {text}: '{value}' is no {kind.__name__}") from None
    return found


def trade(name, sets=(), outside=False, quick=False, out=None, as_json=False):
    """Search, print what was found, keep it in a folder if there is one; return the exit code.

    A Ctrl-C ends the search, and what was measured so far is printed and kept.

    Args:
        name, sets, outside: see `subject_of`.
        quick: few settings.
        out: folder for ``NAME.json`` and ``NAME.png``, or None.
        as_json: print JSON and nothing else.

    Raises:
        CaseError: see `subject_of`.
        SolveError: there is nothing to compare with.
        OutputError: a file could not be written.
    """
    subject = subject_of(name, sets, outside)
    if out is not None:
        with disk_faults(out):
            Path(out).mkdir(parents=True, exist_ok=True)

    def tell(text):
        print(text, file=sys.stderr, flush=True)

    tell(f"{subject.name}: {subject.title}")
    trials, ended = [], None
    with Worker() as worker:
        try:
            for trial in search(subject, worker, quick, tell):
                trials.append(trial)
                tell(line(trial, subject))
        except (KeyboardInterrupt, RestorationError) as error:
            ended = error
    flags = [part for text in sets for part in ("--set", text)] + ["--quick"] * quick
    found = plain(trials, subject, shlex.join(["restore", "trade", name, *flags, "--json"]))
    if as_json:
        print(json.dumps(found, indent=1, allow_nan=False))
    else:
        print(words(trials, subject))
    if out is not None and done(trials):
        write_text(Path(out) / f"{subject.name}.json", json_text(found))
        draw_trade(Path(out) / f"{subject.name}.png", trials, subject)
    if isinstance(ended, RestorationError):
        raise ended
    return STOPPED if ended else 0
