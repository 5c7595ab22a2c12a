"""Words of the messages: what was found, what is possible, and the nearest known name."""

import re
from difflib import get_close_matches

# What moves the cursor of a terminal, reverses the text after it, or cannot be written at all.
UNWRITABLE = re.compile(
    "[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff]"
)
SHORT = 60  # characters of what was found that a message repeats
LONGEST_NAME = 200  # characters
MANY = 12  # names a message lists at most


def printable(text):
    """Return text on one line, with nothing in it that a terminal would act on."""
    return UNWRITABLE.sub("?", str(text))


def wrong_name(text, longest=LONGEST_NAME):
    """Return why text cannot be the name of a thing, or None.

    Names go into messages, logs, tables and files that other programs read.
    """
    if not text.strip():
        return "is not a name"
    if len(text) > longest:
        return f"is a name of {len(text)} characters; at most {longest} are possible"
    if odd := UNWRITABLE.search(text):
        return f"holds the character U+{ord(odd[0]):04X}, which no name may have"
    return None


def quoted(value):
    """Return what was found, in quotes, shortened, and on one line."""
    if isinstance(value, dict):
        return f"a group of entries ({listed(value, 'and')})" if value else "an empty group"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    text = str(value).replace("e+", "e") if isinstance(value, float) else str(value)
    text = text if len(text) <= SHORT else text[: SHORT - 3] + "..."
    return printable(f"'{text}'")


def listed(names, last="or"):
    """Return names in a row: ``a, b or c``."""
    names = [printable(str(name)[:SHORT]) for name in names]
    if len(names) > MANY:
        return f"{', '.join(names[:MANY])} and {len(names) - MANY} more"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def nearest(name, known):
    """Return the known name most like ``name``, or None."""
    known = [str(entry) for entry in known]
    folded = {entry.casefold(): entry for entry in reversed(known)}
    word = str(name)[:SHORT].casefold()
    begun = [entry for entry in folded if len(word) > 1 and entry.startswith(word)]
    near = begun or get_close_matches(word, folded, n=1, cutoff=0.6)
    return folded[near[0]] if near else None


def hint(name, known):
    """Return the end of a message about an unknown name: the nearest one and the possible ones."""
    known = [str(entry) for entry in known]
    if not known:
        return ""
    near = nearest(name, known)
    if near and len(known) == 1:
        return f"; did you mean '{near}'?"
    return (
        f"; did you mean '{near}'? (possible: {listed(known)})"
        if near
        else (f"; possible: {listed(known)}")
    )


def counted(number, noun):
    """Return a number with its noun: ``1 gap``, ``3 gaps``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
