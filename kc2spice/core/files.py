"""Output directories in which either all files of a run appear, or none."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kc2spice.core.errors import UsageError

# Suffixes of the main output files, which are deleted first and written last.
# Readers thus find no incomplete set of files, even if a run is killed between two renames.
RESULT_FILE = "result.json"
MAIN_SUFFIXES = (".cir", "verify.json", RESULT_FILE)
_WORK_SUFFIX = ".part"
_OTHER_DIRECTORY_HINT = "choose another --out"
_SAFE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}")
_MAX_RECORD_BYTES = 10_000_000  # largest ``result.json`` that is read
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_ABANDONED_AGE = 60.0  # s, age at which an unlocked work directory is deleted


def suggest_file(path: Path) -> str | None:
    """Suggest an existing file with a name similar to the name of a missing file.

    Files with the same suffix as the missing file have precedence. A TOML file is suggested only
    for a TOML file.
    """
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):
        names = sorted(item.name for item in path.parent.iterdir() if item.is_file())
    suffix = path.suffix.lower()
    same_suffix = [name for name in names if name.lower().endswith(suffix)]
    other_formats = [name for name in names if not name.endswith(".toml")]
    return _suggest_stem(path, same_suffix) or _suggest_stem(path, other_formats)


def _suggest_stem(path: Path, names: Sequence[str]) -> str | None:
    """Suggest the file name that is most similar to ``path``, both without suffix."""
    import difflib  # difflib is imported here, because most runs do not need it

    stems = {Path(name).stem.lower(): name for name in reversed(names)}
    similar = difflib.get_close_matches(path.stem.lower(), stems, n=1, cutoff=0.7)
    return f"did you mean {stems[similar[0]]!r}?" if similar else None


@contextmanager
def stage_directory(out: Path | str) -> Iterator[Path]:
    """Yield a work directory whose files move to ``out`` if no error is raised.

    If the block raises an error, nothing is written, and earlier results in ``out`` stay
    unchanged. The files are renamed while ``out`` is locked. Two runs with the same output
    directory therefore publish their files one after the other. No program reads an incomplete
    file.

    Raises
    ------
    UsageError : ``out`` is a file, or cannot be created or written.
    """
    if "\0" in str(out):
        raise UsageError(
            "this path contains a zero byte", where=repr(str(out)), hint=_OTHER_DIRECTORY_HINT
        )
    typed = str(out)
    # A link is replaced by its target, so that the files are renamed within one file system.
    out = Path(os.path.realpath(out))
    # os.path returns False for a path in a directory without permission; pathlib raises an error.
    nearest = next(filter(os.path.exists, (out, *out.parents)))
    if not os.path.isdir(nearest):
        raise make_write_error(typed, nearest, "a file, not a directory")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise make_write_error(typed, nearest, "no permission to write")
    # The work directory is created next to the output directory ``out`` if possible.
    # The work directory is inside ``out`` if only ``out`` is writable, or if ``out`` is a mount
    # point.
    if nearest == out and not os.path.ismount(out) and os.access(out.parent, os.W_OK):
        nearest = out.parent
    prefix = f".kc2spice.{out.name}."
    try:
        work = Path(tempfile.mkdtemp(prefix=prefix, suffix=_WORK_SUFFIX, dir=nearest))
    except OSError as error:
        raise make_write_error(typed, nearest, error.strerror or str(error)) from None
    try:
        with lock_path(work):
            _delete_abandoned_directories(work, prefix)
            try:
                yield work
            except OSError as error:
                if error.errno not in DISK_FULL_ERRORS:
                    raise
                raise make_write_error(typed, nearest, error.strerror or str(error)) from None
            try:
                _publish_files(work, out)
            except OSError as error:
                raise make_write_error(typed, out, error.strerror or str(error)) from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def make_write_error(typed: str, directory: Path, reason: str) -> UsageError:
    """Make the error for an output path that cannot be written.

    ``typed`` is the user's text.
    """
    return UsageError(
        "this path cannot be written",
        where=typed,
        got=f"{directory}: {reason}",
        expected="a path in a directory that can be written",
        hint=_OTHER_DIRECTORY_HINT,
    )


def _publish_files(work: Path, out: Path) -> None:
    """Move the files of the work directory to the output directory."""
    out.mkdir(parents=True, exist_ok=True)
    with lock_path(out):
        files = [path.relative_to(work) for path in sorted(work.rglob("*")) if path.is_file()]
        if Path(RESULT_FILE) in files:
            _record_hashes(work, files)
        stale = list_earlier_files(out) - set(map(str, files))
        for name in files:
            if _rank_main_file(name) >= 0:
                (out / name).unlink(missing_ok=True)
        for stale_name in stale:
            with contextlib.suppress(OSError):
                (out / stale_name).unlink()
        for name in sorted(files, key=lambda path: (_rank_main_file(path), path)):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(work / name, out / name)


def _record_hashes(work: Path, files: list[Path]) -> None:
    """Add the SHA-256 hashes of all other files of the run to ``result.json``.

    A later run with the same directory deletes a file only if its hash is unchanged.
    """
    path = work / RESULT_FILE
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return  # an invalid result.json cannot store the hashes
    if not isinstance(record, dict):
        return
    record["sha256"] = {
        str(name): _hash_file(work / name) for name in files if name != Path(RESULT_FILE)
    }
    path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def _hash_file(path: Path) -> str:
    """Compute the SHA-256 hash of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def list_earlier_files(out: Path) -> set[str]:
    """List the files of an earlier run in ``out`` that are still unchanged.

    The file ``result.json`` of the earlier run contains the hashes of its files. The returned list
    does not contain

    * files whose hash has changed,
    * files in sub-directories,
    * hidden files,
    * links.
    """
    try:
        if (out / RESULT_FILE).stat().st_size > _MAX_RECORD_BYTES:
            return set()
        record = json.loads((out / RESULT_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return set()
    hashes = record.get("sha256") if isinstance(record, dict) and "scene" in record else None
    if not isinstance(hashes, dict):
        return set()
    safe_names = filter(_SAFE_NAME.fullmatch, hashes)
    present = (
        name for name in safe_names if (out / name).is_file() and not (out / name).is_symlink()
    )
    return {RESULT_FILE, *(name for name in present if hashes[name] == _hash_file(out / name))}


def _rank_main_file(path: Path) -> int:
    """Return the rank of a file's suffix among main result files; -1 for other files.

    The position of other suffixes is -1.
    """
    return next((rank for rank, end in enumerate(MAIN_SUFFIXES) if path.name.endswith(end)), -1)


def _delete_abandoned_directories(directory: Path, prefix: str) -> None:
    """Delete the unlocked work directories of killed runs."""
    for other in directory.parent.iterdir():
        if other == directory or not (
            other.name.startswith(prefix) and other.name.endswith(_WORK_SUFFIX)
        ):
            continue
        with contextlib.suppress(OSError):
            if time.time() - other.stat().st_mtime > _ABANDONED_AGE:
                with lock_path(other, wait=False):
                    shutil.rmtree(other, ignore_errors=True)


@contextmanager
def lock_path(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Lock a file or directory exclusively, without an additional lock file.

    Raises
    ------
    BlockingIOError : ``wait`` is false and another process has the lock.
    """
    try:
        import fcntl
    except ImportError:  # without POSIX there are no locks, but each rename is atomic
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        fcntl.flock(handle, fcntl.LOCK_UN)  # a forked process may have inherited the file handle
        os.close(handle)
