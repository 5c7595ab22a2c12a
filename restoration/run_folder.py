"""The folder of a run: whose it is, what is in it, and who works in it now."""

import errno
import fcntl
import hashlib
import json
import os
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from restoration.errors import CaseError, OutputError
from restoration.writing import write_text

LOCK = ".lock"  # in a run folder, for other machines and users
# What a disk says that knows no locks, or on which nothing can be written.
NO_LOCKS = errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES, errno.EROFS


@dataclass(frozen=True)
class Job:
    """A case and where its run goes.

    Attributes:
        path: the case file.
        case_text: its text as given.
        resolved: text of the resolved case.
        scene: `scene.Scene`.
        out: run folder; None for ``runs/<case>-<hash8>`` in the working folder.
        fresh: whether an earlier run in the folder is thrown away.
        prove: whether the restored section is moved forward again; no part of the case.
        checkpoint: steps between two checkpoints, ``auto``, or None for none.
        walltime: from now on, after which the run is to have ended, s; None for no matter.
    """

    path: Path
    case_text: str
    resolved: str
    scene: object
    out: Path | None = None
    fresh: bool = False
    prove: bool = False
    checkpoint: int | str | None = "auto"
    walltime: float | None = None

    @property
    def sha256(self):
        """Hash of the resolved case: two runs of one hash answer the same question."""
        return hashlib.sha256(self.resolved.encode()).hexdigest()

    @property
    def folder(self):
        """Where the run goes."""
        if self.out is not None:
            return Path(self.out)
        name = self.path.parent.name if self.path.stem == "case" else self.path.stem
        return Path("runs") / f"{name or 'case'}-{self.sha256[:8]}"


def claim(job, locks):
    """Keep other runs out of the run folder, and make it or clear it of what is not gone on with.

    Args:
        job: `Job`.
        locks: contextlib.ExitStack; the folder is kept until it is closed.

    Returns:
        The folder; None where a run of this very case has ended well in it already.

    Raises:
        CaseError: another run is at work in the folder, or it holds something else.
        OutputError: it cannot be made.
    """
    folder = job.folder
    locks.enter_context(locked(folder))
    try:
        begun = folder.exists() and not (folder.is_dir() and _hardly_begun(folder))
        if begun and _earlier(folder) is None:
            raise CaseError(f"{folder}: is not a run folder and not empty; give another --out")
        folder.mkdir(parents=True, exist_ok=True)
        locks.enter_context(claimed(folder))
        if not _hardly_begun(folder):  # looked at anew: now nobody else changes it
            sha256, ended_well = _earlier(folder)
            if not job.fresh and sha256 != job.sha256:
                raise CaseError(
                    f"{folder}: holds the run of another case; give another --out, or --fresh to "
                    "throw it away"
                )
            if not job.fresh and ended_well:
                return None
            if job.fresh or not any(folder.glob("checkpoints/step-*.h5")):
                clear(folder)
        _lay_out(job)
    except OSError as error:
        raise OutputError(f"{folder}: {error.strerror}; give another --out") from error
    return folder


def _lay_out(job):
    """Make the folders in that of a run, and write the case."""
    write_text(job.folder / "resolved.yaml", job.resolved)  # the first one: see `_hardly_begun`
    write_text(job.folder / "case.yaml", job.case_text)
    for name in ("figures", "horizons"):
        (job.folder / name).mkdir(exist_ok=True)


def _hardly_begun(folder):
    """Return whether a folder is empty, or was when a run that was cut short began in it."""
    return {path.name for path in folder.iterdir()} <= {
        LOCK,
        ".resolved.yaml.tmp",
        "resolved.yaml",
        ".case.yaml.tmp",
    }


# What a run leaves in its folder, beside the case. Checkpoints first: if it is killed while these
# files are removed nothing may go on with what is left.
RUN_FILES = (
    "checkpoints/step-*.h5",
    "checkpoints/kept-*.h5",
    "checkpoints/latest.json",
    "run.json",
    "diagnostics.csv",
    "log.txt",
    "fields*.xdmf",
    "fields*.h5",
    "particles*.xdmf",
    "particles*.h5",
    "horizons*.xdmf",
    "horizons*.h5",
    "figures/section-*.png",
    "figures/strip.png",
    "figures/there-and-back.png",
    "figures/certificate.png",
    "certificate.md",
    "figures/flatness.png",
    "failure/facts.json",
    "failure/step-*.h5",
    "failure/latest.json",
    "horizons/[0-9]*-*.geojson",
)


def _earlier(folder):
    """Return hash and good end of the run in a folder; None if it is no run folder."""
    if not (folder / "resolved.yaml").is_file() or not (folder / "case.yaml").is_file():
        return None
    sha = hashlib.sha256((folder / "resolved.yaml").read_bytes()).hexdigest()
    try:
        return sha, bool(json.loads((folder / "run.json").read_text())["ended_well"])
    except (OSError, ValueError, KeyError, TypeError):
        return sha, False


def proved(folder):
    """Return whether the run in a folder has a proof."""
    return bool(json.loads((folder / "run.json").read_text()).get("proof"))


def clear(folder):
    """Remove what a run leaves, and nothing else."""
    for pattern in RUN_FILES:
        for path in folder.glob(pattern):
            path.unlink()


@contextmanager
def locked(folder, what="run", patience=0.0):
    """Keep other runs of this machine out of a run folder as long as this one works in it.

    Args:
        folder: pathlib.Path of it, which need not be there yet.
        what: works in it, for the message.
        patience: seconds to wait for one that is about to end.

    Yields:
        The lock, an open file: a child that inherits it keeps the folder as long as it lives.

    Raises:
        CaseError: another run is at work in it.
    """
    name = hashlib.sha256(os.fsencode(os.path.realpath(folder))).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"restore-{os.getuid()}-{name}.lock"
    limit = time.monotonic() + patience
    with _opened(path) as lock:
        while not _taken(lock):
            if time.monotonic() >= limit:
                raise CaseError(f"{folder}: another {what} is at work in it; give another --out")
            time.sleep(0.05)
        yield lock


@contextmanager
def claimed(folder):
    """Keep runs of other machines and users that share its disk out of a run folder.

    A disk that knows no locks keeps nobody out; nor does a folder in which nothing can be written.

    Raises:
        CaseError: another run is at work in it.
    """
    with ExitStack() as held:
        try:
            free = _taken(held.enter_context(_opened(folder / LOCK, 0o666)))
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            free = True
        if not free:
            raise CaseError(
                f"{folder}: another run is at work in it, of another machine or user; give another "
                "--out"
            )
        yield


def _opened(path, mode=0o600):
    """Return a lock file, open; where all may write, a link could lead to somebody else's file."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.fdopen(os.open(path, flags, mode), "w")


def _taken(lock):
    """Return whether nobody else holds a lock; this process then does, as long as it is open."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
