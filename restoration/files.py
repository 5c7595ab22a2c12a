"""Input files: found, inside their folder, of sane size, and text."""

import hashlib
import os
import re
import stat
from pathlib import Path

from restoration.errors import CaseError, Fault
from restoration.words import nearest

MB = 1_000_000
MOST_NAMES = 1000  # of a folder, among which the one meant is looked for
ADDRESS = re.compile(r"\0|://|^/vsi|^[A-Za-z]:[/\\]")  # of the net, of GDAL, of a Windows drive


def read_text(path, shown, longest=MB):
    """Return the text of a file.

    Args:
        path: where it is.
        shown: its name in messages.
        longest: greatest size, bytes.

    Raises:
        CaseError: missing, a folder, unreadable, too large, empty or not UTF-8 text.
    """
    raw = _bytes(Path(path), shown, longest)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise _fault(shown, "is UTF-16 text; save it as UTF-8")
    if raw[:4] == b"PK\x03\x04":
        raise _fault(shown, "is a zip archive; unpack it and name the file in it")
    if b"\0" in raw:
        raise _fault(shown, "is a binary file, not text")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise CaseError(
            [
                Fault(
                    shown,
                    line,
                    None,
                    "",
                    f"byte 0x{raw[error.start]:02x} is not UTF-8 text; save it as UTF-8",
                )
            ]
        ) from None
    if not text.strip():
        raise _fault(shown, "is empty")
    return text


def inside(folder, name, allow_outside=False, of="case"):
    """Return the path of a file that an input file of ``folder`` names.

    Args:
        folder: of the file that names it.
        name: relative path as written.
        allow_outside: whether it may lie elsewhere.
        of: what the input file is, for messages.

    Raises:
        ValueError: it is an address, not a plain path, or leaves the folder.
    """
    if ADDRESS.search(name):
        raise ValueError(f"'{name}' is not a file name; copy the file beside the {of}")
    if "\\" in name:
        raise ValueError(f"'{name}' has backslashes; write {name.replace(chr(92), '/')}")
    folder = Path(folder)
    if allow_outside:
        return folder / name
    way_out = f"copy it into the folder of the {of}, or allow it with --allow-outside"
    if Path(name).is_absolute():
        raise ValueError(f"'{name}' is an absolute path; {way_out}")
    if ".." in Path(name).parts:
        raise ValueError(f"'{name}' leaves the folder of the {of}; {way_out}")
    try:
        resolved = (folder / name).resolve()
    except (OSError, RuntimeError):
        raise ValueError(f"'{name}' is a link that leads nowhere") from None
    if not resolved.is_relative_to(folder.resolve()):
        raise ValueError(f"'{name}' is a link out of the folder of the {of}; {way_out}")
    return folder / name


def digest(path, shown, longest):
    """Return the sha256 of a file, as bytes; arguments and errors as `read_text`."""
    return _opened(
        Path(path), shown, longest, lambda file: hashlib.file_digest(file, "sha256")
    ).digest()


def _bytes(path, shown, longest):
    """Return the content of a regular file of sane size."""
    raw = _opened(path, shown, longest, lambda file: file.read(longest + 1))
    if len(raw) > longest:
        raise _fault(shown, "grows while it is read")
    return raw


def _opened(path, shown, longest, read):
    """Return what ``read`` makes of a regular file of sane size.

    What was looked at may be another file by the time it is opened, so it is looked at again, and
    opened without waiting: a pipe would wait for ever.
    """
    try:
        _check(os.stat(path), path, shown, longest)
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        try:
            _check(os.fstat(descriptor), path, shown, longest)
            with open(descriptor, "rb", closefd=False) as file:
                return read(file)
        finally:
            os.close(descriptor)
    except FileNotFoundError:
        raise _fault(shown, f"no such file{near_file(path)}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _fault(shown, f"cannot be read: {reason}") from None


def _check(status, path, shown, longest):
    """Refuse what is no regular file, or too large."""
    if stat.S_ISDIR(status.st_mode):
        inner = path / "case.yaml"
        raise _fault(shown, f"is a folder; name the file in it{_such(inner, shown)}")
    if not stat.S_ISREG(status.st_mode):
        raise _fault(shown, "is not a regular file")
    if status.st_size > longest:
        size = f"{status.st_size / MB:.1f} MB"
        raise _fault(shown, f"is {size} large; at most {longest / MB:g} MB are read")


def _such(inner, shown):
    """Return the hint at the case file of a folder."""
    return f", such as {shown.rstrip('/')}/case.yaml" if inner.is_file() else ""


def near_file(path):
    """Return the hint at a file of nearly this name in the same folder, for messages."""
    try:
        names = sorted(os.listdir(path.parent))[:MOST_NAMES]
    except OSError:
        return f"; there is no folder {path.parent.name}"
    near = nearest(path.name, names)
    return f"; did you mean '{near}'?" if near else ""


def _fault(shown, message):
    return CaseError([Fault(shown, None, None, "", message)])
