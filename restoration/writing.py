"""Output files that are whole or not there: written beside their place, then renamed.

A reader, or a run that is killed, meets the old file or the new one and never a part of one. Every
fault of the disk becomes an OutputError with the path and what to do.
"""

import errno
import os
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path

from restoration.errors import OutputError

ELSEWHERE = "write to another folder (--out)"
FOLDER = f"a file stands where a folder is needed: move it, or {ELSEWHERE}"
ADVICE = {
    errno.ENOSPC: f"the disk is full: free some space, or {ELSEWHERE}",
    errno.EDQUOT: f"the disk quota is used up: free some space, or {ELSEWHERE}",
    errno.EFBIG: f"the system allows no file of this size: {ELSEWHERE}",
    errno.EIO: f"the disk fails: {ELSEWHERE}",
    errno.EACCES: f"you may not write here: {ELSEWHERE}",
    errno.EPERM: f"you may not write here: {ELSEWHERE}",
    errno.EROFS: f"the disk is read-only: {ELSEWHERE}",
    errno.ENOTDIR: FOLDER,
    errno.EEXIST: FOLDER,
    errno.EISDIR: f"a folder stands where the file goes: move it, or {ELSEWHERE}",
}


@contextmanager
def disk_faults(path):
    """Turn what goes wrong on the disk into an OutputError that names ``path``."""
    try:
        yield
    except OSError as error:
        advice = ADVICE.get(error.errno, f"{error}: {ELSEWHERE}")
        raise OutputError(f"{path}: not written: {advice}") from error


@contextmanager
def replacing(path, durable=False):
    """Yield the path of a temporary sibling that takes the place of ``path`` at the end.

    Missing folders are made. The sibling is removed when anything goes wrong; its name is always
    the same, so that what a killed run left is overwritten.

    Args:
        path: pathlib.Path of the file.
        durable: whether the file must also outlive a loss of power.

    Raises:
        OutputError: the file could not be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with disk_faults(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            if durable:
                _sync(temporary)
            os.replace(temporary, path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        if durable:
            _sync(path.parent)


def write_text(path, text, durable=False):
    """Write a UTF-8 text file as a whole.

    Args:
        path: path of the file.
        text: its content.
        durable: whether the file must also outlive a loss of power.

    Raises:
        OutputError: the file could not be written.
    """
    with replacing(Path(path), durable) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_room(path, size):
    """Raise OutputError unless the disk of ``path`` has ``size`` bytes to spare."""
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise OutputError(
            f"{path}: not written: it needs {size / 1e6:.1f} MB of free disk and there are "
            f"{free / 1e6:.1f} MB: free some space, or {ELSEWHERE}"
        )


def _sync(path):
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
