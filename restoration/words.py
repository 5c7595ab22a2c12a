"""Words of the messages: what was found, what is possible, and the nearest known name."""

from difflib import get_close_matches

SHORT = 60  # characters of what was found that a message repeats
MANY = 12  # names a message lists at most


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
    return "".join(sign if sign.isprintable() else "?" for sign in f"'{text}'")


def listed(names, last="or"):
    """Return names in a row: ``a, b or c``."""
    names = [str(name)[:SHORT] for name in names]
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
