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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.user_warnings import warn_user

# Suffixes of the main output files, which are deleted first and written last.
# Readers thus find no incomplete set of files, even if a run is killed between two renames.
RESULT_FILE = "result.json"
MAIN_SUFFIXES = (".cir", "verify.json", RESULT_FILE)
_WORK_SUFFIX = ".part"
_OTHER_DIRECTORY_HINT = "choose another --out"
# Ends of the names of files that users edit. Before such a file is replaced, an edited file is
# renamed.
_EDITABLE_NAME_ENDS = (
    ".cir", ".lib", ".sp", ".va", ".asy", ".kicad_sch", ".kicad_sym", ".kicad_pro", ".wbk",
    "sym-lib-table",
)  # fmt: skip
# Hidden file with the hashes of exported files, in directories without ``result.json``
HASHES_FILE = ".kc2spice.json"
_SAFE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}")
_MAX_RECORD_BYTES = 10_000_000  # largest ``result.json`` that is read
DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_ABANDONED_AGE = 60.0  # s, age at which an unlocked work directory is deleted


def suggest_file(path: Path, suffixes: Sequence[str] = ()) -> str | None:
    """Suggest an existing file with a name similar to the name of a missing file.

    Files with the same suffix as the missing file have precedence. With ``suffixes``, only files
    with one of these suffixes are suggested. Without ``suffixes``, a TOML file is suggested only in
    place of a missing TOML file.
    """
    names: list[str] = []
    with contextlib.suppress(OSError, ValueError):
        names = sorted(item.name for item in path.parent.iterdir() if item.is_file())
    suffix = path.suffix.lower()
    if suffixes:
        endings = {item.lower() for item in suffixes}
        names = [name for name in names if Path(name).suffix.lower() in endings]
    same_suffix = [name for name in names if name.lower().endswith(suffix)]
    other_formats = [name for name in names if suffixes or not name.endswith(".toml")]
    return _suggest_stem(path, same_suffix) or _suggest_stem(path, other_formats)


def _suggest_stem(path: Path, names: Sequence[str]) -> str | None:
    """Suggest the file name that is most similar to ``path``, both without suffix."""
    name = find_similar_name(path, names)
    return name and f"did you mean {name!r}?"


def find_similar_name(path: Path, names: Sequence[str]) -> str | None:
    """Return the file name that is most similar to ``path``, both without suffix."""
    import difflib  # difflib is imported here, because most runs do not need it

    stems = {Path(name).stem.lower(): name for name in reversed(names)}
    similar = difflib.get_close_matches(path.stem.lower(), stems, n=1, cutoff=0.6)
    return stems[similar[0]] if similar else None


@contextmanager
def stage_directory(out: Path | str, *, with_hashes: bool = False) -> Iterator[Path]:
    """Yield a work directory whose files move to ``out`` if no error is raised.

    If the block raises an error, nothing is written, and earlier results in ``out`` stay
    unchanged. The files are renamed while ``out`` is locked. Two runs with the same output
    directory therefore publish their files one after the other. No program reads an incomplete
    file.

    If a netlist, symbol or schematic in ``out`` has been edited, the edited file is renamed to
    ``NAME.bak``, and a warning is printed. A file counts as edited unless its hash is in a file
    ``result.json``, or in the hidden file that ``with_hashes`` writes into the directory.

    Raises
    ------
    UsageError : the path ``out`` denotes a file, or a directory that cannot be created or written.
    """
    require_path(out)
    if "\0" in str(out):
        raise UsageError(
            "this path contains a zero byte", where=repr(str(out)), hint=_OTHER_DIRECTORY_HINT
        )
    typed = str(out)
    # Symbolic links in the path are resolved, so that files are renamed within one file system.
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
                backups = _publish_files(work, out, with_hashes)
            except OSError as error:
                raise make_write_error(typed, out, error.strerror or str(error)) from None
    finally:
        shutil.rmtree(work, ignore_errors=True)
    for name, backup in backups.items():
        warn_user(
            f"replaced {Path(typed) / name}, which was edited or has an unknown origin; the old "
            f"file is now {Path(typed) / backup}"
        )


def make_write_error(typed: str, directory: Path, reason: str) -> UsageError:
    """Make the error for an output path that cannot be written.

    ``typed`` is the output path as the user typed it.
    """
    return UsageError(
        "this path cannot be written",
        where=typed,
        got=f"{directory}: {reason}",
        expected="a path in a directory that can be written",
        hint=_OTHER_DIRECTORY_HINT,
    )


def require_path(
    path: object, argument: str = "out", kind: str = "directory", example: str = "results"
) -> Path:
    """Return an argument as a path; reject an object that is neither a str nor a Path."""
    if isinstance(path, (str, Path)):
        return Path(path)
    hint = f'for example {argument}="{example}"'
    if argument == "out" and isinstance(path, (Mapping, list, tuple)):
        hint = 'to change keys, write kc.run(SCENE, overrides={"rom.order": 10})'
    raise UsageError(
        f"{argument} is not the path of a {kind}",
        where=argument,
        got=repr(path)[:120],
        expected="a str or a Path",
        hint=hint,
    )


@contextmanager
def create_parent_folders(path: object) -> Iterator[Path]:
    """Create missing parent folders of a file to be written; yield the file's path.

    Raises
    ------
    UsageError : ``path`` is neither a string nor a path, or the file cannot be written.
    """
    file = require_path(path, "path", "file", "results/NAME")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        yield file
    except (OSError, ValueError) as error:  # a ValueError for a path with a zero byte
        raise UsageError(
            "this file cannot be written",
            where=str(path).replace("\0", "\\0"),
            got=getattr(error, "strerror", None) or str(error),
            expected="the path of a file in a folder that can be written",
            hint="choose another path",
        ) from None


def _publish_files(work: Path, out: Path, with_hashes: bool) -> dict[str, str]:
    """Move the files of the work directory to the output directory.

    With ``with_hashes``, also write the hashes of the files. Return the names of edited files that
    were renamed, each with its new name.
    """
    out.mkdir(parents=True, exist_ok=True)
    with lock_path(out):
        files = [path.relative_to(work) for path in sorted(work.rglob("*")) if path.is_file()]
        if with_hashes:
            _write_hashes_file(work, out, files)
        if Path(RESULT_FILE) in files:
            _record_hashes(work, files)
        stale = list_earlier_files(out) - set(map(str, files))
        known = [_read_hashes(out / record) for record in (RESULT_FILE, HASHES_FILE)]
        edited = [name for name in files if _is_edited(work, out, name, known)]
        backups = {}
        for name in sorted(files, key=_rank_main_file, reverse=True):
            if name in edited:
                backups[str(name)] = str(name.with_name(_rename_to_backup(out / name)))
            elif _rank_main_file(name) >= 0:
                (out / name).unlink(missing_ok=True)
        for stale_name in stale:
            with contextlib.suppress(OSError):
                (out / stale_name).unlink()
        for name in sorted(files, key=lambda path: (_rank_main_file(path), path)):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(work / name, out / name)
        if with_hashes:
            os.replace(work / HASHES_FILE, out / HASHES_FILE)
    return backups


def _write_hashes_file(work: Path, out: Path, files: list[Path]) -> None:
    """Write the hashes of exported files and of earlier files in the same directory."""
    hashes = {str(name): _hash_file(work / name) for name in files}
    record = {"sha256": _read_hashes(out / HASHES_FILE) | hashes}
    (work / HASHES_FILE).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def _is_edited(work: Path, out: Path, name: Path, known: Sequence[dict[str, str]]) -> bool:
    """Return whether a new file would replace a file that users have edited or made.

    ``known`` contains the hashes of earlier files, as :func:`_read_hashes` returns them.
    """
    if not name.name.endswith(_EDITABLE_NAME_ENDS) or not (out / name).is_file():
        return False
    earlier = [hashes.get(str(name)) for hashes in known]
    return _hash_file(out / name) not in (*earlier, _hash_file(work / name))


def _rename_to_backup(path: Path) -> str:
    """Rename a file to ``NAME.bak``, ``NAME.bak2`` and so on; return its new name."""
    numbers = chain([""], map(str, count(2)))
    backups = (path.with_name(f"{path.name}.bak{number}") for number in numbers)
    backup = next(item for item in backups if not os.path.lexists(item))
    os.replace(path, backup)
    return backup.name


def _record_hashes(work: Path, files: list[Path]) -> None:
    """Add the SHA-256 hashes of all other files of the run to ``result.json``.

    A later run with the same directory deletes a file only if its hash is unchanged.
    """
    path = work / RESULT_FILE
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return  # no hashes are stored if the file result.json is not valid JSON
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
    hashes = _read_hashes(out / RESULT_FILE)
    if not hashes:
        return set()
    safe_names = filter(_SAFE_NAME.fullmatch, hashes)
    present = (
        name for name in safe_names if (out / name).is_file() and not (out / name).is_symlink()
    )
    return {RESULT_FILE, *(name for name in present if hashes[name] == _hash_file(out / name))}


def _read_hashes(path: Path) -> dict[str, str]:
    """Read the hashes in a ``result.json`` or :data:`HASHES_FILE`, keyed by file name.

    The result is empty if the file is missing, damaged or from another program.
    """
    try:
        if path.stat().st_size > _MAX_RECORD_BYTES:
            return {}
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    known = isinstance(record, dict) and (path.name == HASHES_FILE or "scene" in record)
    hashes = record.get("sha256") if known else None
    return hashes if isinstance(hashes, dict) else {}


def _rank_main_file(path: Path) -> int:
    """Return the rank of a file: the index of its suffix in ``MAIN_SUFFIXES``, or -1."""
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
