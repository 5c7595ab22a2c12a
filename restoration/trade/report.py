"""What a search has to say: a table, words, JSON."""

import json
import platform

from restoration.trade.trials import done, effects, front, recommended
from restoration.units import number

MARK = "*"
MOST_EFFECTS = 12


def cost_text(seconds):
    """Return CPU seconds in words."""
    return f"{number(seconds, 2)} s" if seconds < 600 else f"{number(seconds / 60, 2)} min"


def error_text(error, unit):
    """Return an error in words: metres, or per cent of a relative one."""
    if error is None:
        return ""
    return f"{number(error, 2)} m" if unit == "m" else f"{number(100 * error, 2)} %"


def line(trial, subject):
    """Return a trial as a line of text, told as it comes."""
    if trial.failed:
        return f"  {trial.label}: {trial.failed}"
    errors = " / ".join(error_text(e, subject.unit) for e in (trial.error, trial.most))
    note = f" ({trial.note})" if trial.note else ""
    return f"  {trial.label}: {errors}, {cost_text(trial.cpu_s)}{note}"


def compared(trials):
    """Return the trials that are not of the reference."""
    return [trial for trial in trials if trial.axes != ("reference",)]


def table_of(trials, unit, columns):
    """Return the rows of the table, the head first, the cheapest trial next and failures last.

    Args:
        trials: list of `trials.Trial`.
        unit, columns: of the errors, see `search.Subject`.
    """
    trials = compared(trials)
    ahead = front(trials)
    rows = [("", "settings", *columns, "CPU", "memory", "unknowns", "steps", "solves")]
    for trial in sorted(done(trials), key=lambda t: t.cpu_s):
        rows.append(
            (
                MARK if trial in ahead else "",
                trial.label + (f" ({trial.note})" if trial.note else ""),
                error_text(trial.error, unit),
                error_text(trial.most, unit),
                cost_text(trial.cpu_s),
                f"{trial.memory_mb} MB",
                *("" if n is None else str(n) for n in (trial.unknowns, trial.steps, trial.solves)),
            )
        )
    return rows + [("", t.label, t.failed, *[""] * 6) for t in trials if t.failed]


def table_text(rows):
    """Return the rows of a table in columns; what failed runs over them."""
    sound = [row for row in rows if any(row[3:])]
    widths = [max(len(row[i]) for row in sound) for i in range(len(rows[0]))]
    widths[1] = max(len(row[1]) for row in rows)
    lines = []
    for row in rows:
        cells = [
            text.ljust(width) if i < 2 else text.rjust(width)
            for i, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        cells = cells if any(row[3:]) else [*cells[:2], row[2]]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def table_markdown(rows):
    """Return the rows of a table in Markdown."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]).replace(
        "| * |", "| **\N{BULLET}** |"
    )


def truth_text(subject):
    """Return in words what errors are errors against, and how good that is."""
    text = f"errors ({' / '.join(subject.columns)}) against {subject.truth}"
    if subject.good_to:
        text += f", itself good to about {error_text(subject.good_to, subject.unit)}"
    return text


def advice(trials, subject):
    """Return the recommendation, a sentence for every error that is worth its cost."""
    found = []
    for asked, trial in recommended(compared(trials)):
        label = trial.label if trial.axes else "the settings given"
        found.append(
            f"for {error_text(asked, subject.unit)} take {label}: costs "
            f"{cost_text(trial.cpu_s)} ({error_text(trial.error, subject.unit)}, "
            f"{subject.columns[1]} {error_text(trial.most, subject.unit)}, {trial.memory_mb} MB)"
        )
    return found


def given_of(trials):
    """Return the trial of what was given, or None."""
    return next((trial for trial in trials if not trial.axes), None)


def words(trials, subject):
    """Return all that a search has to say, as text."""
    given, parts = given_of(trials), [table_text(table_of(trials, subject.unit, subject.columns))]
    if not done(compared(trials)):
        return "nothing was measured"
    parts += [f"{MARK} none other is both cheaper and better; {truth_text(subject)}"]
    parts += ["\n".join(advice(trials, subject))]
    if given and not given.failed:
        changes = effects(compared(trials), given)[:MOST_EFFECTS]
        parts += ["\n".join(["one change of what was given, the most worth first:", *changes])]
    return "\n\n".join(parts)


def plain(trials, subject, command):
    """Return what a search has found as plain values for JSON.

    Args:
        trials: list of `trials.Trial`.
        subject: `search.Subject`.
        command: the command that measured it.
    """
    ahead = front(compared(trials))
    return {
        "command": command,
        "name": subject.name,
        "title": subject.title,
        "unit": subject.unit or "relative",
        "columns": list(subject.columns),
        "truth": subject.truth,
        "truth_good_to": subject.good_to,
        "machine": f"{platform.machine()}, {platform.python_implementation()} on one thread",
        "about": subject.about,
        "trials": [trial.plain() | {"front": trial in ahead} for trial in trials],
        "recommendation": advice(trials, subject),
    }


def json_text(found):
    """Return `plain` as JSON with a trial on each line."""
    trials = found["trials"]
    head = json.dumps({k: v for k, v in found.items() if k != "trials"}, indent=1, allow_nan=False)
    body = ",\n".join("  " + json.dumps(trial, allow_nan=False) for trial in trials)
    return f'{head[:-2]},\n "trials": [\n{body}\n ]\n}}'
