"""Errors of the application; the command line turns each into its exit code."""

import errno
import sys

# Advice for an OSError of the disk, for any operation.
DISK_TROUBLE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})
_REMEDIES = {
    errno.EFBIG: "files of this size are not allowed (ulimit -f), or the file system cannot hold them",
    errno.EROFS: "mount it to be written, or choose another --out",
    errno.EACCES: "change the folder's permissions, or choose another --out",
    errno.EPERM: "change the folder's permissions, or choose another --out",
    errno.EIO: "the disk, or the connection to it, has failed: choose another --out",
}
# Neither has a type or a number of its own: of CPython's `_thread`, and of the loader of the C library.
_NO_THREAD, _NOT_MAPPED = "can't start new thread", "failed to map segment from shared object"
_FULL = "make room there, or choose another --out"


class InputError(Exception):
    """A wrong argument, configuration or input file. The message says what was expected, what was found, and what to
    do.
    """


class FramesError(InputError):
    """Frames that do not show what their capture says. `problem`: what they show instead; the message adds what may be
    the cause, and the frames.
    """

    def __init__(self, problem: str, cause: str) -> None:
        super().__init__(f"{problem}; {cause}")
        self.problem = problem


class GradeError(Exception):
    """A result, which is kept, has a lower grade than the operator requires."""


class StorageError(Exception):
    """A disk that is full, may not be written, or fails. The message names the path and says what to do."""


def is_of_the_disk(error: BaseException) -> bool:
    """Whether an error concerns the disk itself, not the content that was read from it."""
    return isinstance(error, StorageError) or (isinstance(error, OSError) and error.errno in DISK_TROUBLE)


def cannot_write(where: object, error: OSError, what: str = "written") -> StorageError | InputError:
    """Return the error for a failed write: StorageError if the disk refused it, InputError if `where` cannot be
    `what`.
    """
    message = f"{where}: cannot be {what}: {error.strerror or error}"
    if error.errno in DISK_TROUBLE or error.errno in _REMEDIES:
        return StorageError(f"{message}; {_REMEDIES.get(error.errno or 0, _FULL)}")
    return InputError(message)


def is_of_memory(error: BaseException) -> bool:
    """Whether there was not enough memory, for which OpenCV and the loader of libraries have errors of their own."""
    cv2 = sys.modules.get("cv2")  # it is loaded if it has failed
    return (
        isinstance(error, MemoryError)
        or (isinstance(error, ImportError) and _NOT_MAPPED in str(error))
        or (cv2 is not None and isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem)
    )


def is_of_threads(error: BaseException) -> bool:
    """Whether the system refused a thread."""
    return isinstance(error, RuntimeError) and str(error) == _NO_THREAD
